"""Stage `replays`: execute chunks of several sources from kept simulator states, record what comes of it."""

import time
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.corpus.config import FIRST_SEED, CorpusConfig
from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import is_lost, stored
from lerobot_dexflex.corpus.manifest import stage_folder
from lerobot_dexflex.corpus.proposals import perturbed, proposed
from lerobot_dexflex.corpus.schema import HORIZON, REPLAY_COLUMNS, SOURCES, Tensors
from lerobot_dexflex.corpus.shard import Shard, read_shard, shard_path, write_replays
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.envs.reach import ReachEpisode
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts.reach.sensing import Senses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.poses import pose_error

Array = NDArray[np.float64]

EXPERT, PRIOR, PERTURBED, DRAFT_SEEDED = range(len(SOURCES))


def run_replays(config: CorpusConfig, commit: str, split: str, number: int) -> None:
    """Replay chunks from the kept states of one shard and write what happened.

    Args:
        config: The recipe.
        commit: Unused: the recipe of the stage names it.
        split: `train`, `tune` or `test`.
        number: Number of the shard within the split.

    Raises:
        DexFlexError: If the corpus lacks the shard.
    """
    del commit
    begun = time.process_time()
    source_path = shard_path(config.output / split, number)
    if not source_path.is_file():
        raise DexFlexError(f"There is no {source_path}. Finish the corpus first: --stage=corpus.")
    shard = read_shard(source_path)
    rng = np.random.default_rng((config.seed, FIRST_SEED[split], number))
    kept, source = _draw(shard.tensors, config, rng)
    chunks = _chunks(shard.tensors, kept, source, config.controller, rng)
    tensors = replay(shard, kept, chunks)
    rows = shard.tensors["snapshot_step"][kept]
    tensors |= {"shard": np.full(len(kept), number), "row": rows, "source": source}
    tensors = {key: tensors[key].astype(column.dtype) for key, column in REPLAY_COLUMNS.items()}
    totals: dict[str, Any] = {"steps": HORIZON * len(kept), "replays": len(kept)}
    totals |= {f"replays_{name}": int((source == k).sum()) for k, name in enumerate(SOURCES)}
    totals |= {"lost": int(tensors["lost"].sum()), "cpu_seconds": time.process_time() - begun}
    write_replays(shard_path(stage_folder(config) / split, number), tensors, totals)


def replay(shard: Shard, kept: NDArray[np.int64], chunks: Array) -> dict[str, NDArray[Any]]:
    """Execute chunks raw from kept states.

    Pushes, slips and fixtures of the episode happen as they did.

    Args:
        shard: The recorded episodes.
        kept: Which snapshots to begin from; one may be named several times. Shape (replays,).
        chunks: Displacements of the commanded tips [m]. Shape (replays, 8, 4, 3).

    Returns:
        The columns of `schema.REPLAY_COLUMNS` that say what happened, and `chunk`.
    """
    env, senses, running = CorpusEnv(), None, -1
    tensors = shard.tensors
    found: list[dict[str, Any]] = [{} for _ in kept]
    for k in np.argsort(kept, kind="stable"):
        row = tensors["snapshot_step"][kept[k]]
        number = int(tensors["episode"][row])
        values = shard.episodes[number]
        if senses is None or number != running:
            env.start(ReachEpisode.from_dict(values["episode"]), World.from_dict(values["world"]))
            senses, running = Senses(env), number
        env.rewind(
            values["clock"] + int(tensors["step"][row]),
            tensors["snapshot_physics"][kept[k]],
            tensors["snapshot_command"][kept[k]],
        )
        found[k] = _play(env, senses, tensors["command"][row].astype(float), stored(chunks[k]))
    return {key: np.array([one[key] for one in found]) for key in found[0]} | {"chunk": chunks}


def _play(env: CorpusEnv, senses: Senses, command: Array, chunk: Array) -> dict[str, Any]:
    before = now = senses.read()
    joints, seen, loads, lost = env.command, [], [], []
    for displacement in chunk:
        command = stored(command + displacement)
        joints = kernels.solve_fingertips(command, joints)
        supported = env.supported
        env.advance(joints)
        now = senses.read()
        seen.append(env.observe())
        loads.append(now.loads)
        lost.append(not supported and is_lost(now, env.episode))
    ends = np.array(lost)
    return {
        "joints": [one["agent_pos"] for one in seen],
        "fingertips": [one["fingertips"].reshape(4, 3) for one in seen],
        "tactile": [one["tactile"] for one in seen],
        "loads": loads,
        "lost": ends[-1] or (ends[1:] & ends[:-1]).any(),
        "object_motion": pose_error(before.position, before.quaternion, now.position, now.quaternion),
    }


def _draw(
    tensors: Tensors, config: CorpusConfig, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Choose snapshots and a source for each; the expert's chunks need eight expert steps ahead.

    Where the hand has lost the object already, nothing can be learnt: such states are left out.
    """
    rows = tensors["snapshot_step"]
    ahead = rows[:, None] + np.arange(HORIZON)
    inside = ahead[:, -1] < len(tensors["step"])
    ahead = np.minimum(ahead, len(tensors["step"]) - 1)
    inside &= tensors["episode"][ahead[:, -1]] == tensors["episode"][rows]
    held = inside & ~(tensors["lost"][np.maximum(rows - 1, 0)] & (tensors["step"][rows] > 0))
    expert = held & tensors["expert"][ahead].all(1)
    counts = rng.multinomial(config.replays.per_shard, config.replays.shares)
    pools = [np.flatnonzero(expert if k == EXPERT else held) for k in range(len(SOURCES))]
    kept = [rng.choice(pool, n) if len(pool) else pool for pool, n in zip(pools, counts, strict=True)]
    return np.concatenate(kept), np.repeat(np.arange(len(SOURCES)), [len(part) for part in kept])


def _chunks(
    tensors: Tensors,
    kept: NDArray[np.int64],
    source: NDArray[np.int64],
    controller: str,
    rng: np.random.Generator,
) -> Array:
    rows = tensors["snapshot_step"][kept].astype(np.int64)
    chunks = tensors["executed"][rows[:, None] + np.arange(HORIZON)].astype(float)
    for k in np.flatnonzero(source == PERTURBED):
        squeeze = tensors["command"][rows[k]] - tensors["fingertips"][rows[k]]
        outward = -squeeze / np.maximum(np.linalg.norm(squeeze, axis=1, keepdims=True), 1e-6)
        chunks[k] = perturbed(chunks[k], outward, rng)
    learned = np.flatnonzero((source == PRIOR) | (source == DRAFT_SEEDED))
    if len(learned):
        seeded = source[learned] == DRAFT_SEEDED
        chunks[learned] = proposed(_load(controller), tensors, rows[learned], seeded, rng)
    return chunks


@lru_cache(maxsize=1)
def _load(controller: str) -> DexFlexController:
    """Return the controller, loaded once per worker process."""
    if not controller:
        raise DexFlexError(
            "Replays of the sources `prior` and `draft-seeded` need `controller`, the folder of a trained "
            "one; or set their shares to 0."
        )
    return DexFlexController.from_pretrained(controller).eval()
