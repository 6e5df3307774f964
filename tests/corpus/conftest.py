"""One grasp that holds, and a short recorded episode with noisy drafts and everything that a world can do."""

from typing import NamedTuple

import numpy as np
import pytest

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.schema import OPERATED
from lerobot_dexflex.corpus.shard import Shard
from lerobot_dexflex.corpus.world import Push, Slip, World
from lerobot_dexflex.experts.reach.operator import Operator
from lerobot_dexflex.hands import LEAP, SHARPA

SEEDS = {LEAP.name: 4, SHARPA.name: 6}
"""A capsule and a cylinder in firm grasps, which the operator can also hold without one of its fingers."""
STEPS, NOISE = 40, 5e-4


class Recorded(NamedTuple):
    """A recorded episode and what was wanted in each of its steps."""

    shard: Shard
    guidances: list
    drafts: list
    states: list
    """What the operator saw before each step."""
    spoilt: np.ndarray
    """Whether the noisy draft was executed."""


@pytest.fixture(scope="session", params=[LEAP, SHARPA], ids=lambda hand: hand.name)
def hand(request):
    return request.param


@pytest.fixture(scope="session")
def seed(hand):
    return SEEDS[hand.name]


@pytest.fixture(scope="session")
def episode(hand, seed):
    return CorpusEnv(hand).draw(seed)


@pytest.fixture(scope="session")
def world(hand):
    return World(
        seed=3,
        gravity_rate=0.1,
        gains=tuple(np.linspace(0.9, 1.1, hand.n_joints)),
        damping=1.2,
        joint_noise=0.002,
        sway=(1.0, 0.0, 0.0),
        sway_period=20.0,
        pushes=[Push(5, 4, (0.0, 0.3, 0.2), (0.001, 0.0, 0.0))],
        slips=[Slip(20, 6, 0.7)],
    )


@pytest.fixture(scope="session")
def recorded(hand, seed, episode, world):
    """An episode of 40 steps; in 8 to 15 the noisy draft is executed."""
    run = RunningEpisode(CorpusEnv(hand), episode, world, OPERATED, {"seed": seed, "commit": "none"})
    rng = np.random.default_rng(0)
    operator, guidances, drafts, states = Operator(run.senses, rng, strength=1.2), [], [], []
    spoilt = np.arange(STEPS) // 8 == 1
    for noisy in spoilt:
        guidances.append(operator.guide(run.now))
        states.append(run.now)
        plan = guidances[-1].tips - run.now.tips
        drafts.append(plan + rng.uniform(-NOISE, NOISE, plan.shape))
        run.step(guidances[-1], drafts[-1], bool(noisy))
    return Recorded(run.finish(), guidances, drafts, states, spoilt)
