"""One job: a few objects, episodes of every kind until each has its share of control steps, one shard."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from lerobot_dexflex.corpus.acquisition import Acquisition, find_opening, open_episode
from lerobot_dexflex.corpus.config import CorpusConfig
from lerobot_dexflex.corpus.distortion import Distortion, sample_errors
from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.execution import Driven, run_interface, run_raw
from lerobot_dexflex.corpus.goal_follower import GoalFollower
from lerobot_dexflex.corpus.manifest import kind_key, stage_folder
from lerobot_dexflex.corpus.run import Run
from lerobot_dexflex.corpus.schema import ACQUIRED, INTERFACED, OPERATED, SEARCH
from lerobot_dexflex.corpus.searched import search_episode
from lerobot_dexflex.corpus.shard import Shard, concatenate, shard_path, write_shard
from lerobot_dexflex.corpus.world import World, vary_object
from lerobot_dexflex.envs.reach import ReachEpisode
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.interfaces.method import make_interface

Episodes = dict[int, ReachEpisode]
"""Start of every object, by its seed."""

_EPISODE_STEPS = (60, 180)
_MAX_ROUNDS = 12
"""After so many rounds through its objects a job is content with fewer steps."""
_DISTORTED = 0.3
"""How often the commands of an acquisition are spoilt."""


def run_job(config: CorpusConfig, commit: str, split: str, number: int) -> None:
    """Make one shard and write it.

    Args:
        config: The recipe.
        commit: Commit of the code, for the metadata.
        split: `train`, `tune` or `test`.
        number: Number of the job within the split.
    """
    begun = time.process_time()
    env = CorpusEnv()
    episodes = {seed: env.draw(seed) for seed in config.object_seeds(split, number)}
    total = config.steps_per_object * config.objects_per_job
    budgets = {kind: share * total for kind, share in config.shares.by_kind.items()}
    parts: list[Shard] = []
    for kind, source in _SOURCES.items():
        if budgets[kind]:
            parts += _fill(source(config, env, episodes), budgets, kind)
    if config.shares.interfaced:
        parts += _fill(_interfaced(config, episodes), budgets, INTERFACED)
    for part in parts:
        part.episodes[0]["commit"] = commit
    shard = concatenate(parts)
    totals = shard.totals | _contact_patterns(shard)
    totals |= {"objects": len(episodes), "cpu_seconds": time.process_time() - begun}
    write_shard(shard_path(stage_folder(config) / split, number), shard._replace(totals=totals))


def _fill(source: Iterator[Shard], budgets: dict[int, float], kind: int) -> Iterator[Shard]:
    """Yield episodes until the budget of `kind` is spent; a search's failures spend their own."""
    left = dict(budgets)
    for episode in source:
        own, rows = episode.episodes[0]["kind"], len(episode.tensors["step"])
        if left[own] > 0:
            left[own] -= rows
            totals = episode.totals | {"steps": rows, "episodes": 1, kind_key(own): rows}
            yield episode._replace(totals=totals)
        if left[kind] <= 0:
            return


def _rounds(
    config: CorpusConfig, episodes: Episodes, kind: int
) -> Iterator[tuple[int, ReachEpisode, np.random.Generator]]:
    """Go round the objects; everything about an episode follows from the generator it gets."""
    for attempt in range(_MAX_ROUNDS):
        for seed, episode in episodes.items():
            yield seed, episode, np.random.default_rng((config.seed, seed, kind, attempt))


def _searched(config: CorpusConfig, env: CorpusEnv, episodes: Episodes) -> Iterator[Shard]:
    for seed, episode, rng in _rounds(config, episodes, SEARCH):
        yield from search_episode(env, _varied(episode, rng), World.sample(rng), rng, {"seed": seed})


def _operated(config: CorpusConfig, env: CorpusEnv, episodes: Episodes) -> Iterator[Shard]:
    for seed, episode, rng in _rounds(config, episodes, OPERATED):
        driven = _driven(env, episode, rng, OPERATED, seed)
        run_raw(driven)
        yield _finished(driven)


def _interfaced(config: CorpusConfig, episodes: Episodes) -> Iterator[Shard]:
    waiting = (
        _driven(CorpusEnv(), episode, rng, INTERFACED, seed)
        for seed, episode, rng in _rounds(config, episodes, INTERFACED)
    )
    for driven in run_interface(waiting, make_interface(config.interface, config.controller), len(episodes)):
        yield _finished(driven)


def _acquired(config: CorpusConfig, env: CorpusEnv, episodes: Episodes) -> Iterator[Shard]:
    for seed, episode, rng in _rounds(config, episodes, ACQUIRED):
        opening = find_opening(env, episode, rng)
        if opening is None:
            continue
        world = World.sample(rng)
        errors = sample_errors(rng, clean_share=1.0 - _DISTORTED)
        facts = {"seed": seed, "corruption": errors.name}
        run = Run(env, open_episode(_varied(episode, rng), world, opening, rng), world, ACQUIRED, facts)
        leader = Acquisition(opening, rng)
        run_raw(Driven(run, leader, Distortion(errors, rng)))
        facts["released"] = not run.lost_steps
        yield run.finish()._replace(totals={"acquisitions": 1, "released": int(facts["released"])})


def _driven(env: CorpusEnv, episode: ReachEpisode, rng: np.random.Generator, kind: int, seed: int) -> Driven:
    """Start an operator under spoilt commands, in half of the episodes with pushes and slips too."""
    world, steps = World.sample(rng), int(rng.integers(*_EPISODE_STEPS))
    episode = _varied(episode, rng)
    if rng.random() < 0.5:
        world.disturb(rng, steps, episode.object_spec.mass)
    errors = sample_errors(rng)
    run = Run(env, episode, world, kind, {"seed": seed, "corruption": errors.name})
    return Driven(run, GoalFollower(run, rng, steps), Distortion(errors, rng))


def _finished(driven: Driven) -> Shard:
    leader = driven.leader
    assert isinstance(leader, GoalFollower)
    goals = {"goals_attempted": leader.attempted, "goals_solved": leader.solved}
    driven.run.facts.update(goals)
    return driven.run.finish()._replace(totals=goals)


def _varied(episode: ReachEpisode, rng: np.random.Generator) -> ReachEpisode:
    return replace(episode, object_spec=vary_object(episode.object_spec, rng))


def _contact_patterns(shard: Shard) -> dict[str, float]:
    """Count which fingers are loaded together; index, middle, ring, thumb."""
    loaded = (shard.tensors["loads"] > CONTACT_FORCE).astype(int)
    patterns, counts = np.unique(loaded, axis=0, return_counts=True)
    return {
        "pattern_" + "".join(map(str, pattern)): float(count)
        for pattern, count in zip(patterns, counts, strict=True)
    }


_SOURCES: dict[int, Callable[[CorpusConfig, CorpusEnv, Episodes], Iterator[Shard]]] = {
    SEARCH: _searched,
    OPERATED: _operated,
    ACQUIRED: _acquired,
}
