"""The operator reaches verified goals, again and again, and only where its command is executed."""

import json

import numpy as np
import pytest

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import MAX_STEPS, N_GOALS, Chain, HeldObject, build_chain
from lerobot_dexflex.interfaces import make_interface

SEEDS = range(50_000, 50_004)


@pytest.fixture(scope="module")
def env():
    return ReachEnv(cameras=())


@pytest.fixture(scope="module")
def chain(env):
    return next(chain for seed in SEEDS if (chain := build_chain(env, seed)))


def test_a_chain_survives_json(chain):
    assert Chain.from_json(json.loads(json.dumps(chain.to_json()))) == chain


def test_a_seed_decides_its_chain(env, chain):
    assert build_chain(env, chain.seed) == chain


def test_a_verified_chain_fits_the_time_limit(chain):
    assert len(chain.goals) == N_GOALS
    assert all(goal.steps > 0 for goal in chain.goals)
    assert sum(goal.steps for goal in chain.goals) <= MAX_STEPS


def test_clean_commands_complete_the_chain(chain):
    (episode,) = run_chains([chain], NO_ERRORS, make_interface("raw"))
    assert not episode.dropped
    assert episode.goals_reached >= N_GOALS - 1
    np.testing.assert_array_equal(episode.label, episode.draft)


def test_no_command_reaches_nothing(chain):
    (episode,) = run_chains([chain], CommandErrors.of(scale=0.0), make_interface("raw"))
    assert episode.progress < 0.3
    assert np.abs(episode.executed).max() < 1e-12


def test_unverified_goals_return_to_the_start_every_second_time(env, chain):
    unverified = build_chain(env, chain.seed, verify=False)
    assert unverified is not None
    goals = unverified.goals
    assert goals[1].position == chain.episode.position
    assert goals[0].position != chain.episode.position


def test_a_snapshot_brings_hand_object_and_operator_back(env, chain):
    held = HeldObject(env, chain.seed, chain.episode)
    held.set_goal(0, chain.goals[0])

    def work(steps: int) -> list[np.ndarray]:
        return [held.execute(held.operator.displacement(held.command)).position for _ in range(steps)]

    work(5)
    start = held.snapshot()
    first = work(15)
    held.restore(start)
    np.testing.assert_array_equal(first, work(15))
