"""What a shard of the corpus holds: one table of columns, and the check that a shard obeys it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand

Tensors = dict[str, NDArray[Any]]

FORMAT = "3"
SNAPSHOT_INTERVAL = 8
"""Control steps from one kept simulator state to the next."""

OPERATED, ACQUIRED, TURNED = range(3)
KINDS = ("operator", "acquisition and release", "strokes on a hinge")
"""Meaning of the column `kind`."""


class Column(NamedTuple):
    """One tensor of a shard; None in `shape` is any size."""

    shape: tuple[int | None, ...]
    """Shape after the leading axis."""
    dtype: str
    unit: str
    meaning: str


def columns(hand: Hand) -> dict[str, Column]:
    """Return the tensors over the N control steps of a shard, episodes one after the other."""
    joints, fingers = (hand.n_joints,), (hand.n_fingers,)
    points, ahead = (*fingers, 3), (DRAFT_HORIZON, *fingers, 3)
    touch = f"taxels before the step, {' x '.join(map(str, (*fingers, *hand.taxels)))}"
    return {
        "joints": Column(joints, "float32", "rad", "measured joints before the step"),
        "fingertips": Column(points, "float32", "m", "measured tips before the step, palm frame"),
        "gravity": Column((3,), "float32", "1", "unit direction of gravity, palm frame"),
        "tactile": Column((math.prod((*fingers, *hand.taxels)),), "float16", "N", touch),
        "draft": Column(ahead, "float16", "m", "where tips should be ahead, minus `fingertips`; spoilt"),
        "plan": Column(ahead, "float16", "m", "the same as the operator wants it in this state"),
        "forces": Column(points, "float32", "N", "forces on the object that the operator wants, palm frame"),
        "wanted": Column(points, "float32", "m", "where the executed command wants the tips, palm frame"),
        "joint_targets": Column(joints, "float32", "rad", "executed joint command"),
        "loads": Column(
            fingers, "float32", "N", "true normal force of each tip on the object before the step"
        ),
        "object": Column(
            (7,), "float32", "m, 1", "true pose of the object before the step (w x y z), palm frame"
        ),
        "expert": Column((), "bool", "", "whether the operator's own command is executed"),
        "lost": Column(
            (), "bool", "", "whether after the step fewer than 2 tips are loaded or the object left"
        ),
        "step": Column((), "int16", "1", "control step within the episode, 0 first"),
        "episode": Column((), "int32", "1", "index into the shard's list of episodes"),
        "kind": Column((), "uint8", "1", "index into KINDS"),
    }


def snapshot_columns(hand: Hand) -> dict[str, Column]:
    """Return the tensors over the K kept simulator states of a shard."""
    return {
        "snapshot_step": Column((), "int32", "1", "row before whose step the simulator was kept"),
        "snapshot_physics": Column((None,), "float64", "", "MuJoCo's integration state"),
        "snapshot_command": Column((hand.n_joints,), "float64", "rad", "joint command before the step"),
    }


def check_rows(
    hand: Hand, tensors: Mapping[str, NDArray[Any]], episodes: Sequence[Mapping[str, Any]]
) -> None:
    """Refuse tensors that are no shard of control steps of a hand.

    Raises:
        DexFlexError: If a column is missing, unknown, of another shape or type or not finite, or if the
            episodes do not lie one after the other.
    """
    of_rows, of_snapshots = columns(hand), snapshot_columns(hand)
    _check_keys(tensors, of_rows | of_snapshots)
    rows = _check_columns(tensors, of_rows)
    kept = _check_columns(tensors, of_snapshots)
    episode, step = tensors["episode"].astype(int), tensors["step"].astype(int)
    starts = np.flatnonzero(np.diff(episode, prepend=-1))
    if not np.array_equal(episode[starts], np.arange(len(episodes))):
        raise DexFlexError(
            f"`episode` must count 0 to {len(episodes) - 1} without gaps, one per entry of the metadata. "
            f"Got starts {episode[starts].tolist()}."
        )
    expected = np.arange(rows) - np.repeat(starts, np.diff(np.append(starts, rows)))
    if not np.array_equal(step, expected):
        raise DexFlexError("`step` must count 0, 1, 2, ... within every episode.")
    at = tensors["snapshot_step"]
    if kept and (np.any(np.diff(at) <= 0) or at[0] < 0 or at[-1] >= rows):
        raise DexFlexError(f"`snapshot_step` must increase within [0, {rows}). Got {at.tolist()}.")
    if rows and tensors["kind"].max() >= len(KINDS):
        raise DexFlexError(f"`kind` must be below {len(KINDS)}. Got {tensors['kind'].max()}.")


def _check_keys(tensors: Mapping[str, Any], wanted: Mapping[str, Column]) -> None:
    missing, unknown = sorted(wanted.keys() - tensors.keys()), sorted(tensors.keys() - wanted.keys())
    if missing or unknown:
        raise DexFlexError(
            f"A shard must hold exactly the columns {list(wanted)}. Missing: {missing}; unknown: {unknown}."
        )


def _check_columns(tensors: Mapping[str, NDArray[Any]], wanted: Mapping[str, Column]) -> int:
    """Check shapes, types and values of columns that share their leading axis; return its length."""
    rows = len(tensors[next(iter(wanted))])
    for key, column in wanted.items():
        found = tensors[key]
        fits = len(found.shape) == 1 + len(column.shape) and found.shape[0] == rows
        fits = fits and all(
            want in (None, have) for want, have in zip(column.shape, found.shape[1:], strict=True)
        )
        if not fits or found.dtype != column.dtype:
            shape = ", ".join(str(size or "any") for size in (rows, *column.shape))
            raise DexFlexError(
                f"`{key}` must be {column.dtype} of shape ({shape}). Got {found.dtype} of {found.shape}."
            )
        if found.dtype.kind == "f" and not np.isfinite(found).all():
            bad = np.flatnonzero(~np.isfinite(found.reshape(rows, -1)).all(1))
            raise DexFlexError(f"`{key}` holds NaN or infinity in rows {bad[:5].tolist()}.")
    return rows
