"""Chunks to replay from kept states: the expert's own, spoilt ones, and a trained controller's proposals."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands import effects
from lerobot_dexflex.controller import DexFlexController, History, SelectionSettings
from lerobot_dexflex.controller.config import DRAFT_HISTORY, FRAMES
from lerobot_dexflex.controller.history import SLOW_OFFSETS, past_rows
from lerobot_dexflex.corpus.schema import HORIZON, Tensors

Array = NDArray[np.float64]

_FINGERS = 4
_NOISE, _REMOVAL, _BIAS, _SCALE = (0.0005, 0.003), (0.001, 0.004), (0.0003, 0.002), (0.0, 2.0)
_BATCH = 256


def perturbed(chunk: Array, outward: Array, rng: np.random.Generator) -> Array:
    """Spoil a chunk in one of five ways: noise, fingers that stand still or leave, scale, bias.

    Args:
        chunk: Displacements of the commanded tips [m]. Shape (8, 4, 3).
        outward: Unit directions in which the tips leave the object. Shape (4, 3).
        rng: Source of randomness.
    """
    spoil = _SPOILERS[int(rng.integers(len(_SPOILERS)))]
    return spoil(torch.from_numpy(chunk)[None], torch.from_numpy(outward), rng)[0].numpy()


def _noisy(chunk: Tensor, outward: Tensor, rng: np.random.Generator) -> Tensor:
    del outward
    return effects.shaken(chunk, _uniform(rng, _NOISE, chunk.shape))


def _still(chunk: Tensor, outward: Tensor, rng: np.random.Generator) -> Tensor:
    del outward
    fingers = rng.permutation(_FINGERS)[: rng.integers(1, _FINGERS + 1)]
    return effects.stopped(chunk, torch.from_numpy(np.isin(np.arange(_FINGERS), fingers))[:, None])


def _removed(chunk: Tensor, outward: Tensor, rng: np.random.Generator) -> Tensor:
    finger, begin = int(rng.integers(_FINGERS)), int(rng.integers(HORIZON // 2))
    gone = (torch.arange(HORIZON) >= begin)[:, None] & (torch.arange(_FINGERS) == finger)  # (steps, fingers)
    return effects.leaving(chunk, gone[..., None], rng.uniform(*_REMOVAL) * outward)


def _scaled(chunk: Tensor, outward: Tensor, rng: np.random.Generator) -> Tensor:
    del outward
    return effects.scaled(chunk, torch.tensor(rng.uniform(*_SCALE), dtype=chunk.dtype))


def _biased(chunk: Tensor, outward: Tensor, rng: np.random.Generator) -> Tensor:
    del outward
    return effects.shaken(chunk, _uniform(rng, _BIAS, chunk.shape[2:]))


def _uniform(rng: np.random.Generator, strengths: tuple[float, float], shape: Sequence[int]) -> Tensor:
    strength = rng.uniform(*strengths)
    return torch.from_numpy(rng.uniform(-strength, strength, shape))


_SPOILERS: tuple[Callable[[Tensor, Tensor, np.random.Generator], Tensor], ...] = (
    _noisy,
    _still,
    _removed,
    _scaled,
    _biased,
)


def shard_history(tensors: Tensors, rows: NDArray[np.int64]) -> tuple[History, torch.Tensor]:
    """Return what a controller sees at rows of a shard: the past, and the drafts before.

    Args:
        tensors: The shard.
        rows: Rows to look at. Shape (batch,).
    """
    at, step = torch.from_numpy(rows), torch.from_numpy(tensors["step"][rows].astype(np.int64))
    frames, slow = past_rows(at, step, FRAMES).numpy(), past_rows(at, step, SLOW_OFFSETS).numpy()
    before = past_rows(at, step, tuple(range(DRAFT_HISTORY, 0, -1))).numpy()
    begun = tensors["step"][rows][:, None] >= np.arange(DRAFT_HISTORY, 0, -1)
    drafts = tensors["draft"][before] * begun[..., None, None]
    touch = tensors["tactile"].reshape(-1, _FINGERS, 10, 6)
    history = History(
        joints=torch.from_numpy(tensors["joints"][frames]),
        fingertips=torch.from_numpy(tensors["fingertips"][frames]),
        gravity=torch.from_numpy(tensors["gravity"][rows]),
        tactile=torch.from_numpy(touch[frames].astype(np.float32)),
        tactile_missing=torch.zeros(len(rows), _FINGERS, dtype=torch.bool),
        slow_loads=torch.from_numpy(touch[slow].astype(np.float32).sum((-1, -2))),
        slow_fingertips=torch.from_numpy(tensors["fingertips"][slow]),
        slow_missing=torch.zeros(len(rows), dtype=torch.bool),
    )
    return history, torch.from_numpy(drafts.astype(np.float32))


@torch.no_grad()
def proposed(
    controller: DexFlexController,
    tensors: Tensors,
    rows: NDArray[np.int64],
    seeded: NDArray[np.bool_],
    rng: np.random.Generator,
) -> Array:
    """Draw one chunk of the prior per row: from noise, or from the row's draft held over the horizon.

    Args:
        controller: A trained controller.
        tensors: The shard.
        rows: Where to propose. Shape (batch,).
        seeded: Which rows start from the draft. Shape (batch,).
        rng: Source of randomness.

    Returns:
        Chunks [m]. Shape (batch, 8, 4, 3).
    """
    pure = SelectionSettings(n_pure=1, n_seeded=0, include_draft=False, project=False)
    n_levels = len(pure.levels)
    levels = SelectionSettings(n_pure=0, n_seeded=n_levels, include_draft=False, project=False)
    found = np.zeros((len(rows), HORIZON, _FINGERS, 3))
    for wanted, settings in ((~seeded, pure), (seeded, levels)):
        chosen = np.flatnonzero(wanted)
        for part in np.array_split(chosen, -(-len(chosen) // _BATCH) or 1):
            if not len(part):
                continue
            history, drafts_history = shard_history(tensors, rows[part])
            draft = torch.from_numpy(tensors["draft"][rows[part]])[:, None].expand(-1, HORIZON, -1, -1)
            count = settings.n_candidates
            noise = rng.standard_normal((len(part), count, controller.config.chunk_width), dtype=np.float32)
            state = controller.encode(history)
            chunks = controller.propose(
                state, draft, drafts_history, settings, torch.from_numpy(noise)
            ).chunks
            found[part] = chunks.numpy()[np.arange(len(part)), rng.integers(count, size=len(part))]
    return found
