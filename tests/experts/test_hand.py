"""Free fingers follow their path; a gripped tool is held, led, and let go."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from expert_checks import SEED, make_env

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.experts import make_expert, place_hammer
from lerobot_dexflex.experts.tool.grip import Grip
from lerobot_dexflex.experts.tool.hand import LOST_STEPS, OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hands import LEAP

RELAXED = np.array(LEAP.relaxed_joints)
CLOSED = holds_of(LEAP).bar.touch


def free_hand() -> OperatorHand:
    return OperatorHand(
        cast(Any, SimpleNamespace(hand=LEAP)), RELAXED, np.random.default_rng(0), 1.5, np.eye(3)
    )


@pytest.fixture
def lifted():
    """The hammer environment of seed 11, 68 steps into its demonstration: held and lifted."""
    env = make_env("PlaceHammer-v0")
    env.reset(seed=SEED)
    commands = make_expert("PlaceHammer-v0")(env, np.random.default_rng(SEED))
    for command, _ in zip(commands, range(68), strict=False):
        env.step(command.executed)
    return env


def holding_hand(env, margin: float, preload: float | None = None) -> OperatorHand:
    episode = env.episode
    shape = ObjectSpec("cylinder", (episode.handle_radius, place_hammer.HANDLE_HALF_LENGTH), episode.mass)
    senses = ToolSenses(env, Tool("hammer", shape, np.zeros(3), episode.tip_friction))
    hand = OperatorHand(senses, env.command, np.random.default_rng(0), margin, np.eye(3))
    hand.grip(Grip(CLOSED, CLOSED, senses.read().inward), preload)
    return hand


def test_free_fingers_go_smoothly_where_they_are_sent_and_stay():
    hand = free_hand()
    hand.go(CLOSED, 10)
    joints = np.array([hand.step()[0] for _ in range(14)])
    assert np.abs(joints[0] - RELAXED).max() < 0.02
    assert np.allclose(joints[9:], CLOSED)
    moved = np.linalg.norm(np.diff(np.vstack([RELAXED, joints]), axis=0), axis=1)
    assert moved.max() < 2 * np.linalg.norm(CLOSED - RELAXED) / 10


def test_the_draft_of_free_fingers_is_their_path():
    hand = free_hand()
    hand.go(CLOSED, 10)
    steps = [hand.step() for _ in range(20)]
    tips = np.array([kernels.fingertips(LEAP.tables, joints) for joints, _ in steps])
    for k in range(12):
        draft = steps[k][1]
        assert draft.shape == (DRAFT_HORIZON, 4, 3)
        assert np.allclose(draft, tips[k : k + DRAFT_HORIZON], atol=1e-12)


def test_relaxing_keeps_still_for_the_steps_asked_for():
    hand = free_hand()
    hand.go(CLOSED, 2)
    for _ in range(2):
        hand.step()
    hand.relax(6, after=3)
    joints = [hand.step()[0] for _ in range(12)]
    assert all(np.array_equal(j, CLOSED) for j in joints[:3])
    assert not np.array_equal(joints[3], CLOSED)
    assert np.allclose(joints[-1], RELAXED)


def test_a_free_hand_neither_grips_nor_slips():
    hand = free_hand()
    assert not hand.gripped
    assert not hand.slipping


def test_a_tool_that_is_kept_misses_nothing_and_one_that_is_led_misses_the_way(lifted):
    hand = holding_hand(lifted, 1.5)
    assert hand.gripped
    hand.keep()
    assert hand.miss == pytest.approx((0.0, 0.0), abs=1e-6)
    now = hand.senses.read()
    hand.lead(now.position + np.array([0.0, 0.0, 0.01]), now.rotation)
    assert hand.miss == pytest.approx((0.01, 0.0), abs=1e-6)


def test_a_greater_margin_asks_for_greater_forces(lifted):
    def total(margin: float, preload: float | None = None) -> float:
        hand = holding_hand(lifted, margin, preload)
        assert hand.operator is not None
        forces, inward = hand.operator.guide().forces, hand.senses.read().inward
        return float((forces * inward).sum())

    assert total(2.5) > 1.15 * total(1.3)
    assert total(2.5, 0.0) > 1.15 * total(1.3, 0.0)
    assert total(1.5, 6.0) > total(1.5, 2.0)


def test_a_braced_hand_balances_the_force_that_it_expects(lifted):
    def total(force) -> np.ndarray:
        hand = holding_hand(lifted, 1.5)
        hand.brace(np.array(force), np.zeros(3))
        assert hand.operator is not None
        return hand.operator.guide().forces.sum(0)

    assert np.allclose(total([-0.5, 0.0, 0.3]) - total([0.0, 0.0, 0.0]), [0.5, 0.0, -0.3], atol=0.1)


def test_screwing_may_use_another_share_of_the_friction_than_the_margin_leaves(lifted):
    hand = holding_hand(lifted, 2.0)
    assert hand.operator is not None
    assert hand.operator.friction_share == 0.5
    hand.grip(Grip(CLOSED, CLOSED, hand.senses.read().inward), 6.0, 0.9)
    assert (hand.operator.friction_share, hand.operator.preload) == (0.9, 6.0)


def test_slipping_is_told_once_a_holding_finger_has_felt_nothing_for_long(lifted):
    hand = holding_hand(lifted, 1.5)
    hand.step()
    assert not hand.slipping
    lifted.data.joint("hammer").qpos[2] -= 0.2  # Fallen out of the hand.
    for k in range(1, LOST_STEPS + 1):
        lifted.step(lifted.command)
        hand.step()
        assert hand.slipping == (k == LOST_STEPS)
    assert not hand.gripped


def test_fingers_that_let_go_begin_where_they_are(lifted):
    hand = holding_hand(lifted, 1.5)
    hand.let_go()
    joints, draft = hand.step()
    measured = hand.senses.read().joints
    assert np.array_equal(joints, measured)
    assert np.allclose(draft, kernels.fingertips(LEAP.tables, measured))
    assert not hand.gripped
