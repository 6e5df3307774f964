"""Proposals of the frozen prior, drawn once and reused by the score and decoder stages."""

from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor
from tqdm import tqdm

from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.encoder import State
from lerobot_dexflex.controller.settings import SelectionSettings
from lerobot_dexflex.corpus.schema import INTERFACED, OPERATED
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.provenance import digest_text
from lerobot_dexflex.training.augmentation import AugmentationConfig, augment
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.metrics import draw
from lerobot_dexflex.training.proxy_drafts import constant_velocity, proxy_drafts

_ROWS_AT_ONCE = 128


@dataclass
class BankConfig:
    """Which states get proposals, and how many."""

    rows: int = 40_000
    """States in the bank."""
    held_out_rows: int = 1024
    """States of the tuning split."""
    n_pure: int = 8
    """Proposals from the prior alone."""
    n_seeded: int = 8
    """Proposals that start at the draft."""
    nfe: int = 4
    """Integration steps from noise."""
    loop_share: float = 0.6
    """Share of states from episodes under corrupted commands, with the drafts given there."""
    proxy_share: float = 0.25
    """Share of these whose draft is imagined instead; elsewhere all are."""


class ProposalBank:
    """States with drafts and candidates; candidate 0 is the draft itself.

    Args:
        tensors: By name: `row`, `proxy`, `body`, `contact`, `fingers`, `slow`, `draft`, `past`, `clean`,
            `chunks`.
    """

    def __init__(self, tensors: dict[str, Tensor]) -> None:
        self.tensors = tensors

    def __len__(self) -> int:
        return len(self.tensors["row"])

    def get(self, name: str, index: Tensor) -> Tensor:
        """Return some rows of a tensor in full precision."""
        values = self.tensors[name][index]
        return values.float() if values.is_floating_point() else values

    def state(self, index: Tensor) -> State:
        """Return some encoded states."""
        return State(*[self.get(name, index) for name in State._fields])

    @classmethod
    def load_or_draw(
        cls,
        path: Path,
        controller: DexFlexController,
        data: CorpusData,
        config: BankConfig,
        rows: int,
        seed: int,
        origin: str = "",
    ) -> "ProposalBank":
        """Read the bank from a file, or draw and write it.

        Args:
            path: The file; one that is damaged or of another origin is replaced.
            controller: Proposes.
            data: States.
            config: How many of what.
            rows: Number of states.
            seed: Of the draws.
            origin: Tells whatever else decides the bank: other weights, another corpus.
        """
        origin = digest_text(f"{asdict(config)} {rows} {seed} {origin}")
        if path.is_file() and _origin(path) == origin:
            return cls(load_file(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        with torch.random.fork_rng(), torch.no_grad():
            torch.manual_seed(seed)
            bank = cls(_draw_bank(controller, data, config, rows))
        temporary = path.with_suffix(".tmp")
        save_file(bank.tensors, temporary, metadata={"origin": origin})
        temporary.replace(path)
        return bank


def _origin(path: Path) -> str | None:
    try:
        with safe_open(path, "pt") as file:
            return (file.metadata() or {}).get("origin")
    except (SafetensorError, OSError):
        return None


def _draw_bank(
    controller: DexFlexController, data: CorpusData, config: BankConfig, rows: int
) -> dict[str, Tensor]:
    usable = torch.cat([data.chunk_rows(expert=True), data.chunk_rows(expert=False)])
    usable = usable[data.columns["step"][usable] > 0]  # The first step has no earlier joint command.
    if not len(usable):
        raise DexFlexError("The corpus has no 8 labelled steps in a row to propose at.")
    kind = data.columns["kind"][usable]
    closed = (kind == OPERATED) | (kind == INTERFACED)
    groups = [usable[closed], usable[~closed]]
    n_closed = 0 if not len(groups[0]) else rows if not len(groups[1]) else round(config.loop_share * rows)
    chosen = torch.cat([draw(g, n) for g, n in zip(groups, (n_closed, rows - n_closed), strict=True) if n])
    parts: dict[str, list[Tensor]] = {}
    for some in tqdm(chosen[torch.randperm(rows)].split(_ROWS_AT_ONCE), desc="proposals"):
        for name, value in _propose(controller, data, config, some).items():
            parts.setdefault(name, []).append(value)
    return {name: torch.cat(values) for name, values in parts.items()}


def _propose(
    controller: DexFlexController, data: CorpusData, config: BankConfig, rows: Tensor
) -> dict[str, Tensor]:
    state = controller.encode(augment(data.history(rows), AugmentationConfig(joint_noise=0, tip_noise=0)))
    clean = data.clean_chunk(rows)
    draft, past = constant_velocity(data.columns["draft"][rows]), data.before("draft", rows)
    kind = data.columns["kind"][rows]
    given = ((kind == OPERATED) | (kind == INTERFACED)) & (torch.rand(len(rows)) >= config.proxy_share)
    proxy, proxy_past = proxy_drafts(data.before("label", rows), clean)
    keep = given[:, None, None, None]
    draft, past = torch.where(keep, draft, proxy), torch.where(keep, past, proxy_past)
    settings = SelectionSettings(n_pure=config.n_pure, n_seeded=config.n_seeded, nfe=config.nfe)
    noise = torch.randn(len(rows), config.n_pure + config.n_seeded, controller.config.chunk_width)
    chunks = controller.propose(state, draft, past, settings, noise).chunks
    floats = {**state._asdict(), "draft": draft, "past": past, "clean": clean, "chunks": chunks}
    for name in (*State._fields, "chunks"):
        floats[name] = floats[name].half()
    return {"row": rows, "proxy": ~given, **floats}
