"""A split of the reach corpus in memory, and batches gathered from it."""

from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from lerobot_dexflex.controller.config import DRAFT_HISTORY, FRAMES
from lerobot_dexflex.controller.history import SLOW_OFFSETS, History, past_rows
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.corpus.schema import columns
from lerobot_dexflex.corpus.shard import read_header
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import finger_frames
from lerobot_dexflex.hands import Hand, get_hand
from lerobot_dexflex.runs.provenance import digest_text

SPLITS = ("train", "tune")
"""Splits that training may read; test objects are kept for the benchmark."""


class CorpusData:
    """All rows of a split as tensors; touch and drafts stay in half precision (0.7 GB for 500 000 rows).

    Args:
        folder: The corpus.
        split: `train` or `tune`.

    Raises:
        DexFlexError: If the split may not be read, is empty or damaged, or if the corpus mixes hands.
    """

    def __init__(self, folder: Path, split: str) -> None:
        paths = _shards(folder, split)
        self.hand = _hand_of(folder)
        keys = tuple(columns(self.hand))
        parts: dict[str, list[Tensor]] = {key: [] for key in keys}
        rows = episodes = 0
        for path in paths:
            shard = _read(path, keys)
            shard["episode"] = shard["episode"].long() + episodes
            rows += len(shard["step"])
            episodes = int(shard["episode"][-1]) + 1
            for key in keys:
                parts[key].append(shard[key])
        self.columns: dict[str, Tensor] = {}
        for key in keys:
            self.columns[key] = torch.cat(parts.pop(key))
        touch = self.columns["tactile"].view(rows, self.hand.n_fingers, -1)
        self._touch_loads = torch.cat([part.float().sum(-1) for part in touch.split(50_000)])

    def __len__(self) -> int:
        return len(self.columns["step"])

    def history(self, rows: Tensor) -> History:
        """Return the states at some rows with their past."""
        hand, columns, step = self.hand, self.columns, self.columns["step"][rows]
        fast, slow = past_rows(rows, step, FRAMES), past_rows(rows, step, SLOW_OFFSETS)
        return History(
            joints=columns["joints"][fast],
            fingertips=columns["fingertips"][fast],
            gravity=columns["gravity"][rows],
            tactile=columns["tactile"][fast].float().unflatten(-1, (hand.n_fingers, *hand.taxels)),
            tactile_missing=torch.zeros(len(rows), hand.n_fingers, dtype=torch.bool),
            slow_loads=self._touch_loads[slow],
            slow_fingertips=columns["fingertips"][slow],
            slow_missing=torch.zeros(len(rows), dtype=torch.bool),
        )

    def plan(self, rows: Tensor) -> Tensor:
        """Return where the operator wants the tips, minus where they are [m] (batch, 8, fingers, 3)."""
        return self.columns["plan"][rows].float()

    def draft(self, rows: Tensor) -> Tensor:
        """Return what was left of the operator's plan [m]. Shape (batch, 8, fingers, 3)."""
        return self.columns["draft"][rows].float()

    def executed(self, rows: Tensor) -> Tensor:
        """Return where commands wanted the tips over the next steps, minus where they are [m].

        Rows as in `transition_rows`. Shape (batch, 8, fingers, 3).
        """
        ahead = self.columns["wanted"][rows[:, None] + torch.arange(DRAFT_HORIZON)]
        return ahead - self.columns["fingertips"][rows][:, None]

    def drafts_before(self, rows: Tensor) -> Tensor:
        """Return first steps of the drafts before each row, oldest first, zeros before the start.

        Shape (batch, 8, fingers, 3) [m].
        """
        back = torch.arange(DRAFT_HISTORY, 0, -1)
        known = back <= self.columns["step"][rows].long()[:, None]
        values = self.columns["draft"][(rows[:, None] - back).clamp(min=0), 0].float()
        return values * known[..., None, None]

    def local_forces(self, rows: Tensor) -> Tensor:
        """Return the wanted forces in the distal links' frames [N]. Shape (batch, fingers, 3)."""
        rotation = finger_frames(self.hand, self.columns["joints"][rows]).distal_rotation
        return (rotation.mT @ self.columns["forces"][rows][..., None]).squeeze(-1)

    def continuing(self, steps: int) -> Tensor:
        """Return which rows have so many further rows in their episode. Shape (rows,), bool."""
        episode = self.columns["episode"]
        mask = torch.zeros(len(self), dtype=torch.bool)
        if len(self) > steps:
            mask[: len(self) - steps] = episode[steps:] == episode[: len(self) - steps]
        return mask

    def rows(self) -> Tensor:
        """Return rows whose object was not lost before them: elsewhere there is nothing to learn."""
        lost, step = self.columns["lost"], self.columns["step"]
        return (~(lost.roll(1) & (step > 0))).nonzero().flatten()

    def transition_rows(self) -> Tensor:
        """Return `rows` whose episode still runs a horizon later."""
        rows = self.rows()
        return rows[self.continuing(DRAFT_HORIZON)[rows]]


def _all_shards(folder: Path) -> list[Path]:
    """Return the shards of all splits that training reads."""
    return sorted(path for split in SPLITS for path in (folder / split).glob("*.safetensors"))


def _hand_of(folder: Path) -> Hand:
    """Return the hand of all shards that training reads."""
    first: dict[str, Path] = {}
    for path in _all_shards(folder):
        first.setdefault(read_header(path)["hand"], path)
    if len(first) > 1:
        found = ", ".join(f"{path} is of '{hand}'" for hand, path in first.items())
        raise DexFlexError(
            f"The corpus mixes hands: {found}. A controller serves one hand: give every hand its own corpus."
        )
    return get_hand(*first)


def corpus_digest(folder: Path) -> str:
    """Return a digest of the splits that training reads, by their files' names, sizes and headers."""
    words = []
    for path in _all_shards(folder):
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            header = file.read(length).decode(errors="replace")
        words.append(f"{path.relative_to(folder).as_posix()} {path.stat().st_size} {header}")
    return digest_text("\n".join(words))


def _shards(folder: Path, split: str) -> list[Path]:
    if split not in SPLITS:
        raise DexFlexError(f"Training reads the splits {', '.join(SPLITS)}, not {split!r}.")
    paths = sorted((folder / split).glob("*.safetensors"))
    if not paths:
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
