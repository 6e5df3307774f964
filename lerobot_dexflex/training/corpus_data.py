"""A split of the reach corpus in memory, and batches gathered from it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from lerobot_dexflex.controller.config import DRAFT_HISTORY, FRAMES, TAXELS
from lerobot_dexflex.controller.history import SLOW_OFFSETS, History, past_rows
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.corpus.schema import COLUMNS, FAILED
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts.reach.operator import CORRECTION
from lerobot_dexflex.runs.provenance import digest_text

SPLITS = ("train", "tune")
"""Splits that training may read; test objects are kept for the benchmark."""
_KEYS = tuple(COLUMNS)
_REPLAY_KEYS = ("shard", "row", "source", "chunk", "joints", "fingertips", "tactile", "loads", "lost")
_REPLAY_STEPS = [DRAFT_HORIZON - 1 - back for back in FRAMES]
"""Replayed steps that are the frames of the state a horizon later."""


class CorpusData:
    """All rows of a split as tensors; touch stays in half precision (a million rows take about 1.1 GB).

    Args:
        folder: The corpus.
        split: `train` or `tune`.
        operator_gain: Share of the commanded fingertips' error that the labelling operator takes back per
            step; used to imagine its clean chunk.

    Raises:
        DexFlexError: If the split may not be read, is empty or damaged.
    """

    def __init__(self, folder: Path, split: str, operator_gain: float = CORRECTION) -> None:
        paths = _shards(folder, split)
        parts: dict[str, list[Tensor]] = {key: [] for key in _KEYS}
        self.shard_offsets: dict[int, int] = {}
        rows = episodes = 0
        for path in paths:
            shard = _read(path, _KEYS)
            shard["episode"] = shard["episode"].long() + episodes
            self.shard_offsets[int(path.stem)] = rows
            rows += len(shard["step"])
            episodes = int(shard["episode"][-1]) + 1
            for key in _KEYS:
                parts[key].append(shard[key])
        self.columns: dict[str, Tensor] = {}
        for key in _KEYS:
            self.columns[key] = torch.cat(parts.pop(key))
        self.operator_gain = operator_gain
        touch = self.columns["tactile"].view(rows, 4, -1)
        self._touch_loads = torch.cat([part.float().sum(-1) for part in touch.split(50_000)])

    def __len__(self) -> int:
        return len(self.columns["step"])

    def history(self, rows: Tensor) -> History:
        """Return the states at some rows with their past."""
        columns, step = self.columns, self.columns["step"][rows]
        fast, slow = past_rows(rows, step, FRAMES), past_rows(rows, step, SLOW_OFFSETS)
        return History(
            joints=columns["joints"][fast],
            fingertips=columns["fingertips"][fast],
            gravity=columns["gravity"][rows],
            tactile=columns["tactile"][fast].float().unflatten(-1, (4, *TAXELS)),
            tactile_missing=torch.zeros(len(rows), 4, dtype=torch.bool),
            slow_loads=self._touch_loads[slow],
            slow_fingertips=columns["fingertips"][slow],
            slow_missing=torch.zeros(len(rows), dtype=torch.bool),
        )

    def ahead(self, key: str, rows: Tensor, steps: int = DRAFT_HORIZON) -> Tensor:
        """Return a column from each row on. Shape (batch, steps, ...)."""
        return self.columns[key][rows[:, None] + torch.arange(steps)]

    def before(self, key: str, rows: Tensor, steps: int = DRAFT_HISTORY) -> Tensor:
        """Return a column before each row, oldest first, zeros before its start.

        Shape (batch, steps, ...).
        """
        back = torch.arange(steps, 0, -1)
        known = back <= self.columns["step"][rows].long()[:, None]
        values = self.columns[key][(rows[:, None] - back).clamp(min=0)]
        return values * known.view(*known.shape, *[1] * (values.ndim - 2))

    def clean_chunk(self, rows: Tensor) -> Tensor:
        """Return what the operator would have done on from each row, had it been obeyed.

        At an expert's own steps these are its displacements. Elsewhere each later label also takes back a
        share of what the executed commands did wrong since; that share is undone. Shape (batch, 8, 4, 3) [m].
        """
        label, executed = self.ahead("label", rows), self.ahead("executed", rows)
        clean, wrong = [], torch.zeros_like(label[:, 0])
        for k in range(DRAFT_HORIZON):
            clean.append(label[:, k] + self.operator_gain * wrong)
            wrong = wrong + executed[:, k] - clean[-1]
        return torch.stack(clean, 1)

    def continuing(self, steps: int) -> Tensor:
        """Return which rows have so many further rows in their episode. Shape (rows,), bool."""
        episode = self.columns["episode"]
        mask = torch.zeros(len(self), dtype=torch.bool)
        if len(self) > steps:
            mask[: len(self) - steps] = episode[steps:] == episode[: len(self) - steps]
        return mask

    def all_ahead(self, mask: Tensor, steps: int = DRAFT_HORIZON) -> Tensor:
        """Return which rows fulfil a mask (rows,) for so many steps of one episode, their own first."""
        total = torch.cat([torch.zeros(1, dtype=torch.long), (~mask).long().cumsum(0)])
        clear = torch.zeros_like(mask)
        if len(mask) >= steps:
            clear[: len(mask) - steps + 1] = total[steps:] == total[:-steps]
        return clear & self.continuing(steps - 1)

    def chunk_rows(self, expert: bool) -> Tensor:
        """Return rows with a chunk of the expert's own, or else with labels only; no failed branches."""
        kind, whole = self.columns["kind"], self.continuing(DRAFT_HORIZON - 1)
        own = self.all_ahead(self.columns["expert"])
        return ((own if expert else whole & ~own) & (kind != FAILED)).nonzero().flatten()

    def transition_rows(self) -> Tensor:
        """Return rows whose episode still runs a horizon later."""
        return self.continuing(DRAFT_HORIZON).nonzero().flatten()


class ReplayBatch(NamedTuple):
    """Chunks replayed from stored states."""

    now: History
    chunk: Tensor  # (batch, 8, 4, 3) [m]
    later: History
    loads: Tensor  # true loads after each replayed step (batch, 8, 4) [N]
    lost: Tensor  # (batch,) bool
    rows: Tensor  # rows in the corpus (batch,)


class ReplayData:
    """Replayed chunks of a split; of their touch only the frames of the final state are kept.

    Args:
        folder: The corpus.
        split: As that of `corpus`.
        corpus: The split the replays begin in.
    """

    def __init__(self, folder: Path, split: str, corpus: CorpusData) -> None:
        self._corpus = corpus
        parts: dict[str, list[Tensor]] = {key: [] for key in _REPLAY_KEYS}
        for path in _shards(folder / "replays", split, required=False):
            shard = _read(path, _REPLAY_KEYS)
            for key in ("joints", "fingertips", "tactile"):
                shard[key] = shard[key][:, _REPLAY_STEPS]
            unknown = set(shard["shard"].tolist()) - set(corpus.shard_offsets)
            if unknown:
                raise DexFlexError(f"{path} replays shards {sorted(unknown)} that the {split} split lacks.")
            for key in _REPLAY_KEYS:
                parts[key].append(shard[key])
        self.columns = {key: torch.cat(values) for key, values in parts.items() if values}
        if self.columns:
            offsets = [corpus.shard_offsets[s] for s in self.columns["shard"].tolist()]
            self.rows = torch.tensor(offsets) + self.columns["row"].long()

    def __len__(self) -> int:
        return len(self.columns["row"]) if self.columns else 0

    def batch(self, index: Tensor) -> ReplayBatch:
        """Return some replays."""
        columns, rows = self.columns, self.rows[index]
        now = self._corpus.history(rows)
        later = now._replace(
            joints=columns["joints"][index],
            fingertips=columns["fingertips"][index],
            tactile=columns["tactile"][index].float().unflatten(-1, (4, *TAXELS)),
        )
        return ReplayBatch(
            now, columns["chunk"][index], later, columns["loads"][index], columns["lost"][index], rows
        )


def corpus_digest(folder: Path) -> str:
    """Return a digest of the splits that training reads, by their files' names, sizes and headers."""
    words = []
    for path in sorted(path for split in SPLITS for path in (folder / split).glob("*.safetensors")):
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            header = file.read(length).decode(errors="replace")
        words.append(f"{path.relative_to(folder).as_posix()} {path.stat().st_size} {header}")
    return digest_text("\n".join(words))


def _shards(folder: Path, split: str, required: bool = True) -> list[Path]:
    if split not in SPLITS:
        raise DexFlexError(f"Training reads the splits {', '.join(SPLITS)}, not {split!r}.")
    paths = sorted((folder / split).glob("*.safetensors"))
    if required and not paths:
        raise DexFlexError(
            f"There are no shards in {folder / split}. Make a corpus first, or name one with `--corpus`."
        )
    return paths


def _read(path: Path, keys: Sequence[str]) -> dict[str, Tensor]:
    try:
        with safe_open(path, "pt") as shard:
            missing = sorted(set(keys) - set(shard.keys()))
            if missing:
                raise DexFlexError(f"{path} is not a shard of the corpus: it lacks {missing}. Make it again.")
            tensors = {key: shard.get_tensor(key) for key in keys}
    except (SafetensorError, OSError) as error:
        raise DexFlexError(f"{path} cannot be read ({error}). Make it again.") from error
    if not len(tensors[keys[0]]):
        raise DexFlexError(f"{path} is empty. Delete it or make it again.")
    return tensors
