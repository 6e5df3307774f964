"""Chains follow from their seed; verified goals are reached again by who executes the operator's targets."""

import json

import numpy as np
import pytest

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.evaluation.reach import bounds
from lerobot_dexflex.experts.reach.chains import MAX_STEPS, N_GOALS, Chain, HeldObject, build_chain
from lerobot_dexflex.experts.reach.goals import ANGLE, DISTANCE
from lerobot_dexflex.hand.poses import pose_error
from lerobot_dexflex.hands import LEAP
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


def test_the_operators_own_targets_complete_a_verified_chain(chain):
    (episode,) = run_chains([chain], NO_ERRORS, make_interface(LEAP, bounds.OPERATOR))
    assert not episode.dropped
    assert episode.goals_reached == N_GOALS
    assert episode.progress == 1.0
    assert episode.goal_steps == [goal.steps for goal in chain.goals]


def test_a_hand_that_only_grips_reaches_nothing(chain):
    (episode,) = run_chains([chain], CommandErrors.of(scale=0.0), make_interface(LEAP, "press:2.5"))
    assert episode.progress < 0.3
    assert np.abs(episode.selected).max() < 1e-12


@pytest.fixture(scope="module")
def unverified(env):
    return next(chain for seed in SEEDS if (chain := build_chain(env, seed, verify=False)))


def test_unverified_goals_are_around_the_start_and_each_apart_from_the_one_before(unverified):
    start = np.array(unverified.episode.position), np.array(unverified.episode.quaternion)
    previous = start
    for goal in unverified.goals:
        position, quaternion = goal.pose
        distance, angle = pose_error(position, quaternion, *start)
        assert distance <= DISTANCE[1] + 1e-3  # The object settles before goals are drawn around it.
        assert angle <= ANGLE[1] + 0.05
        distance, angle = pose_error(position, quaternion, *previous)
        assert distance > DISTANCE[0] - 1e-3 or angle > ANGLE[0] - 0.05
        previous = goal.pose
        assert goal.steps == 0
    assert len(unverified.goals) == N_GOALS


def test_unverified_goals_are_a_function_of_the_seed_and_survive_json(env, unverified):
    assert build_chain(env, unverified.seed, verify=False) == unverified
    assert Chain.from_json(json.loads(json.dumps(unverified.to_json()))) == unverified


def test_now_and_then_a_better_place_is_looked_for(env):
    chains = [chain for seed in SEEDS if (chain := build_chain(env, seed, verify=False))]
    for chain in chains:
        expected = [k > 0 and (chain.seed + k) % 3 == 0 for k in range(N_GOALS)]
        assert [goal.gait for goal in chain.goals] == expected


def test_a_snapshot_brings_hand_object_and_operator_back(env, chain):
    held = HeldObject(env, chain.seed, chain.episode)
    held.set_goal(0, chain.goals[0])

    def work(steps: int) -> list[np.ndarray]:
        return [held.execute(held.operator.guide().joints).position for _ in range(steps)]

    work(5)
    start = held.snapshot()
    first = work(15)
    held.restore(start)
    np.testing.assert_array_equal(first, work(15))
