"""Proposals of the frozen prior, drawn once and reused by the score's stage."""

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
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.provenance import digest_text
from lerobot_dexflex.training.augmentation import AugmentationConfig, augment
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.metrics import draw

_ROWS_AT_ONCE = 128
_SPOILT = 5e-4
"""A draft is spoilt if it differs by more from the plan [m]."""


@dataclass
class BankConfig:
    """Which states get proposals, and how many."""

    rows: int = 40_000
    """States in the bank."""
    held_out_rows: int = 1024
    """States of the tuning split."""
    n_pure: int = 4
    """Proposals from the prior alone."""
    n_seeded: int = 8
    """Proposals that start at the noisy draft."""
    n_finger: int = 8
    """Proposals that start there but for one finger, which is drawn anew."""
    levels: tuple[float, ...] = (0.5, 0.75)
    """Flow times at which those at the draft start."""
    finger_levels: tuple[float, ...] = (0.0, 0.5)
    """The same for the finger that is drawn anew."""
    others_level: float = 0.5
    """The same for the other fingers of these; at 1 they do what the draft says."""
    spoilt_share: float = 0.7
    """Share of states whose draft is spoilt."""


class ProposalBank:
    """States with drafts and candidates; candidate 0 is the draft itself.

    Args:
        tensors: By name: `row`, `body`, `contact`, `fingers`, `slow`, `draft`, `past`, `clean`, `chunks`.
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

    @property
    def spoilt(self) -> Tensor:
        """Whether the draft differs from the plan. Shape (rows,)."""
        return differs(self.tensors["draft"].float(), self.tensors["clean"].float())

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


def differs(draft: Tensor, plan: Tensor) -> Tensor:
    """Return whether drafts differ from plans in a first step, (rows,), of (rows, 8, fingers, 3) [m]."""
    return (draft - plan)[:, :2].flatten(1).abs().amax(1) > _SPOILT


def _origin(path: Path) -> str | None:
    try:
        with safe_open(path, "pt") as file:
            return (file.metadata() or {}).get("origin")
    except (SafetensorError, OSError):
        return None


def _draw_bank(
    controller: DexFlexController, data: CorpusData, config: BankConfig, rows: int
) -> dict[str, Tensor]:
    usable = data.rows()
    if not len(usable):
        raise DexFlexError("The corpus has no states with a held object to propose at.")
    bad = torch.cat([differs(data.draft(part), data.plan(part)) for part in usable.split(20_000)])
    groups = [usable[bad], usable[~bad]]
    n_spoilt = 0 if not len(groups[0]) else rows if not len(groups[1]) else round(config.spoilt_share * rows)
    chosen = torch.cat([draw(g, n) for g, n in zip(groups, (n_spoilt, rows - n_spoilt), strict=True) if n])
    parts: dict[str, list[Tensor]] = {}
    for some in tqdm(chosen[torch.randperm(rows)].split(_ROWS_AT_ONCE), desc="proposals"):
        for name, value in _propose(controller, data, config, some).items():
            parts.setdefault(name, []).append(value)
    return {name: torch.cat(values) for name, values in parts.items()}


def _propose(
    controller: DexFlexController, data: CorpusData, config: BankConfig, rows: Tensor
) -> dict[str, Tensor]:
    state = controller.encode(augment(data.history(rows), AugmentationConfig(joint_noise=0, tip_noise=0)))
    draft, past = data.draft(rows), data.drafts_before(rows)
    settings = SelectionSettings(
        config.n_pure,
        config.n_seeded,
        config.n_finger,
        include_draft=True,
        levels=config.levels,
        finger_levels=config.finger_levels,
        others_level=config.others_level,
    )
    drawn = settings.n_candidates - 1
    noise = torch.randn(len(rows), drawn, data.layout.n_fingers, controller.config.finger_chunk_width)
    chunks = controller.propose(state, draft, settings, noise).chunks
    floats = {**state._asdict(), "draft": draft, "past": past, "clean": data.plan(rows), "chunks": chunks}
    for name in (*State._fields, "chunks"):
        floats[name] = floats[name].half()
    return {"row": rows, **floats}
