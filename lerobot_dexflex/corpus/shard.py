"""Write and read shards: safetensors files that are either whole or absent."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save_file

from lerobot_dexflex.corpus.schema import FORMAT, Tensors, check_rows, columns, snapshot_columns
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand, get_hand


class Shard(NamedTuple):
    """Control steps of several episodes, or of one while it is recorded."""

    hand: Hand
    """Whose steps."""
    tensors: Tensors
    """What `schema.columns` and `schema.snapshot_columns` say."""
    episodes: list[dict[str, Any]]
    """Per episode: kind, seed, object, gravity and everything else that rebuilds its simulator."""
    totals: dict[str, float]
    """What it cost: CPU seconds, goals, ..."""


def shard_path(folder: Path, number: int) -> Path:
    """Return the file of a numbered shard."""
    return folder / f"{number:05d}.safetensors"


def write_shard(path: Path, shard: Shard) -> None:
    """Check a shard and write it; a crash leaves no half-written file under its name."""
    check_rows(*shard[:3])
    header = {
        "hand": shard.hand.name,
        "episodes": json.dumps(shard.episodes),
        "totals": json.dumps(shard.totals),
    }
    _write(path, shard.tensors, header)


def read_shard(path: Path) -> Shard:
    """Read and check a shard.

    Raises:
        DexFlexError: If the file is damaged or of another format.
    """
    header = read_header(path)
    shard = Shard(get_hand(header["hand"]), load_file(path), header["episodes"], header["totals"])
    check_rows(*shard[:3])
    return shard


def read_header(path: Path) -> dict[str, Any]:
    """Return `hand`, `episodes` and `totals` of a shard without reading its tensors."""
    try:
        with safe_open(path, "numpy") as file:
            header = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise DexFlexError(
            f"{path} is no readable shard ({error}). Delete it and run dexflex-corpus again to make it anew."
        ) from error
    if header.get("format") != FORMAT:
        raise DexFlexError(f"{path} has format {header.get('format')!r}; this version reads {FORMAT!r}.")
    try:
        return {"hand": header["hand"]} | {key: json.loads(header[key]) for key in ("episodes", "totals")}
    except (KeyError, ValueError) as error:
        raise DexFlexError(f"{path} has a damaged header. Delete it and make it anew.") from error


def concatenate(parts: Sequence[Shard]) -> Shard:
    """Join shards in order: rows, episodes and snapshots are renumbered, totals added.

    Raises:
        DexFlexError: If there is nothing to join, or their hands or the sizes of their simulator states
            differ.
    """
    if not parts:
        raise DexFlexError("There is no shard to join; every episode of the job failed.")
    hand = parts[0].hand
    hands = {part.hand.name for part in parts}
    if len(hands) > 1:
        raise DexFlexError(f"Shards of different hands cannot be joined. Got {sorted(hands)}.")
    sizes = {part.tensors["snapshot_physics"].shape[1] for part in parts}
    if len(sizes) > 1:
        raise DexFlexError(f"Simulator states of different sizes cannot be joined. Got {sorted(sizes)}.")
    joined = {
        key: np.concatenate([part.tensors[key] for part in parts])
        for key in (*columns(hand), *snapshot_columns(hand))
    }
    rows = [len(part.tensors["step"]) for part in parts]
    kept = [len(part.tensors["snapshot_step"]) for part in parts]
    episodes = [len(part.episodes) for part in parts]
    joined["snapshot_step"] += np.repeat(_offsets(rows), kept)
    joined["episode"] += np.repeat(_offsets(episodes), rows)
    totals: dict[str, float] = {}
    for part in parts:
        for key, value in part.totals.items():
            totals[key] = totals.get(key, 0.0) + value
    return Shard(hand, joined, [episode for part in parts for episode in part.episodes], totals)


def _offsets(counts: list[int]) -> np.ndarray:
    return np.cumsum([0, *counts[:-1]]).astype(np.int32)


def _write(path: Path, tensors: Tensors, header: dict[str, str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    save_file(
        {key: np.ascontiguousarray(value) for key, value in tensors.items()},
        temporary,
        header | {"format": FORMAT},
    )
    temporary.replace(path)
