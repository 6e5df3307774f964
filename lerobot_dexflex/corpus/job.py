"""One job: a few objects, episodes of every kind until each has its share of control steps, one shard."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from lerobot_dexflex.corpus.acquisition import Acquisition, find_opening, open_episode
from lerobot_dexflex.corpus.config import CorpusConfig
from lerobot_dexflex.corpus.distortion import Distortion, UnsteadyGrip, sample_errors
from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.goal_follower import GoalFollower
from lerobot_dexflex.corpus.manifest import kind_key
from lerobot_dexflex.corpus.schema import ACQUIRED, OPERATED, TURNED
from lerobot_dexflex.corpus.shard import Shard, concatenate, shard_path, write_shard
from lerobot_dexflex.corpus.turning import Turning, find_turn
from lerobot_dexflex.corpus.world import World, vary_object
from lerobot_dexflex.envs.reach import ReachEpisode
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hands import get_hand

Episodes = dict[int, ReachEpisode]
"""Start of every object, by its seed."""

_EPISODE_STEPS = (60, 180)
_MAX_ROUNDS = 12
"""After so many rounds through its objects a job is content with fewer steps."""
_DISTORTED = 0.3
"""How often the drafts of an acquisition are spoilt."""
_DISTURBED = 0.7
_ACQUISITION_STEPS = 150
"""About how long an acquisition takes."""
_LEAST_TURNED = 0.5
"""Share of the wanted turn below which strokes have failed."""
_STRENGTH = (0.6, 1.8)
"""Factor of the squeeze that is executed: the right grip has to be felt."""


def run_job(config: CorpusConfig, commit: str, split: str, number: int) -> None:
    """Make one shard and write it.

    Args:
        config: The recipe.
        commit: Commit of the code, for the metadata.
        split: `train`, `tune` or `test`.
        number: Number of the job within the split.
    """
    begun = time.process_time()
    env = CorpusEnv(get_hand(config.hand))
    episodes = {seed: env.draw(seed) for seed in config.object_seeds(split, number)}
    total = config.steps_per_object * config.objects_per_job
    budgets = {kind: share * total for kind, share in config.shares.by_kind.items()}
    parts: list[Shard] = []
    for kind, source in _SOURCES.items():
        if budgets[kind]:
            parts += _fill(source(config, env, episodes), budgets[kind], kind)
    for part in parts:
        part.episodes[0]["commit"] = commit
    shard = concatenate(parts)
    totals = shard.totals | _contact_patterns(shard)
    totals |= {"objects": len(episodes), "cpu_seconds": time.process_time() - begun}
    write_shard(shard_path(config.output / split, number), shard._replace(totals=totals))


def _fill(source: Iterator[Shard], budget: float, kind: int) -> Iterator[Shard]:
    """Yield episodes until the budget of control steps is spent."""
    for episode in source:
        rows = len(episode.tensors["step"])
        budget -= rows
        yield episode._replace(totals=episode.totals | {"steps": rows, "episodes": 1, kind_key(kind): rows})
        if budget <= 0:
            return


def _rounds(
    config: CorpusConfig, episodes: Episodes, kind: int
) -> Iterator[tuple[int, ReachEpisode, np.random.Generator]]:
    """Go round the objects; everything about an episode follows from the generator it gets."""
    for attempt in range(_MAX_ROUNDS):
        for seed, episode in episodes.items():
            yield seed, episode, np.random.default_rng((config.seed, seed, kind, attempt))


def _operated(config: CorpusConfig, env: CorpusEnv, episodes: Episodes) -> Iterator[Shard]:
    """Lead objects to goals under spoilt drafts, in most episodes with wrenches and slips, too."""
    for seed, episode, rng in _rounds(config, episodes, OPERATED):
        world, steps = World.sample(env.hand, rng), int(rng.integers(*_EPISODE_STEPS))
        varied = _varied(episode, rng)
        if rng.random() < _DISTURBED:
            world.disturb(rng, steps, varied.object_spec.mass)
        errors, strength = sample_errors(rng), float(rng.uniform(*_STRENGTH))
        facts = {"seed": seed, "errors": errors.name, "strength": strength}
        run = RunningEpisode(env, varied, world, OPERATED, facts)
        leader = GoalFollower(run, rng, steps, strength)
        run.run(leader, Distortion(env.hand, errors, rng), UnsteadyGrip(env.hand, rng))
        goals = {"goals_attempted": leader.attempted, "goals_solved": leader.solved}
        facts.update(goals)
        yield run.finish()._replace(totals=goals)


def _acquired(config: CorpusConfig, env: CorpusEnv, episodes: Episodes) -> Iterator[Shard]:
    for seed, episode, rng in _rounds(config, episodes, ACQUIRED):
        opening = find_opening(env, episode, rng)
        if opening is None:
            continue
        world = World.sample(env.hand, rng)
        errors = sample_errors(rng, clean_share=1.0 - _DISTORTED)
        strength = float(rng.uniform(*_STRENGTH))
        facts = {"seed": seed, "errors": errors.name, "strength": strength}
        varied = _varied(episode, rng)
        if rng.random() < _DISTURBED:
            world.disturb(rng, _ACQUISITION_STEPS, varied.object_spec.mass)
        opened = open_episode(varied, world, opening, rng)
        run = RunningEpisode(env, opened, world, ACQUIRED, facts)
        leader = Acquisition(opening, rng, strength)
        run.run(leader, Distortion(env.hand, errors, rng), UnsteadyGrip(env.hand, rng))
        facts["released"] = not run.lost_steps
        yield run.finish()._replace(totals={"acquisitions": 1, "released": int(facts["released"])})


def _turned(config: CorpusConfig, env: CorpusEnv, episodes: Episodes) -> Iterator[Shard]:
    for seed, episode, rng in _rounds(config, episodes, TURNED):
        opening = find_opening(env, episode, rng)
        turn = None if opening is None else find_turn(env.hand, opening, episode, rng)
        if opening is None or turn is None:
            continue
        world, errors = World.sample(env.hand, rng), sample_errors(rng)
        strength = float(rng.uniform(*_STRENGTH))
        world.hinge = turn.hinge
        varied = _varied(episode, rng)
        if rng.random() < _DISTURBED:
            world.disturb(rng, _ACQUISITION_STEPS, varied.object_spec.mass)
        joints = tuple(opening.joints.tolist())
        opened = replace(varied, hand_joints=joints, joint_targets=joints)
        facts = {"seed": seed, "errors": errors.name, "strength": strength}
        run = RunningEpisode(env, opened, world, TURNED, facts)
        leader = Turning(opening, rng, strength, turn)
        run.run(leader, Distortion(env.hand, errors, rng), UnsteadyGrip(env.hand, rng))
        if leader.done < _LEAST_TURNED * leader.wanted:
            continue  # Links were in the way, or the fingers slid: nothing to learn from.
        totals = {"strokes": leader.strokes, "strokes_rad": leader.wanted, "turned_rad": leader.done}
        facts.update(totals)
        yield run.finish()._replace(totals=totals)


def _varied(episode: ReachEpisode, rng: np.random.Generator) -> ReachEpisode:
    return replace(episode, object_spec=vary_object(episode.object_spec, rng))


def _contact_patterns(shard: Shard) -> dict[str, float]:
    """Count which fingers are loaded together, in the order of the hand's fingers."""
    loaded = (shard.tensors["loads"] > CONTACT_FORCE).astype(int)
    patterns, counts = np.unique(loaded, axis=0, return_counts=True)
    return {
        "pattern_" + "".join(map(str, pattern)): float(count)
        for pattern, count in zip(patterns, counts, strict=True)
    }


_SOURCES: dict[int, Callable[[CorpusConfig, CorpusEnv, Episodes], Iterator[Shard]]] = {
    OPERATED: _operated,
    ACQUIRED: _acquired,
    TURNED: _turned,
}
