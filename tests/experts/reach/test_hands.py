"""What the operator does with any hand: hold, lead to goals, find new places for a finger."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_dexflex.envs import reach
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import TOLERANCE, HeldObject, build_chain
from lerobot_dexflex.experts.reach.fingers import Mode
from lerobot_dexflex.experts.reach.regrasp import regrasp_points
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.poses import pose_error
from lerobot_dexflex.hands import HANDS, SHARPA

TEN_SECONDS = 200
STARTS = {"leap": 9, "sharpa": 8}
"""Seeds whose grasps are found soon."""
CHAIN = 50_004
"""A seed with eight goals for SHARPA."""
MANY_PLACES = 6
"""A seed whose object has room for every finger of SHARPA."""


@pytest.mark.parametrize("hand", HANDS.values(), ids=HANDS)
def test_it_holds_an_object_of_100_g_for_ten_seconds_within_a_millimetre(hand, monkeypatch):
    sample = reach.sample_object
    monkeypatch.setattr(reach, "sample_object", lambda rng: replace(sample(rng), mass=0.1))
    held = HeldObject(ReachEnv(cameras=(), hand=hand), STARTS[hand.name])
    state = start = held.senses.read()
    farthest, guidance = 0.0, held.operator.guide(start)
    assert held.senses.mass == pytest.approx(0.1)
    for _ in range(TEN_SECONDS):
        state = held.execute(guidance.joints)
        guidance = held.operator.guide(state)
        farthest = max(farthest, float(np.linalg.norm(state.position - start.position)))
    assert farthest < 0.001
    assert ((state.loads > CONTACT_FORCE) == (start.loads > CONTACT_FORCE)).all()
    assert guidance.tips.shape == (8, hand.n_fingers, 3)
    assert guidance.joints.shape == (hand.n_joints,)


@pytest.fixture(scope="module")
def chain():
    found = build_chain(ReachEnv(cameras=(), hand=SHARPA), CHAIN, verify=False)
    assert found is not None
    return found


def test_five_fingers_lead_an_object_to_goals(chain):
    held = HeldObject(ReachEnv(cameras=(), hand=SHARPA), chain.seed, chain.episode)
    for index, goal in enumerate(chain.goals[:2]):
        held.set_goal(index, goal)
        missed = []
        for _ in range(30):
            state = held.execute(held.operator.guide().joints)
            missed.append(pose_error(state.position, state.quaternion, *goal.pose))
        assert min(missed[0]) > 0.0
        assert any(distance < TOLERANCE[0] and angle < TOLERANCE[1] for distance, angle in missed)


def test_what_it_says_its_tips_do_is_what_its_joints_do(chain):
    held = HeldObject(ReachEnv(cameras=(), hand=SHARPA), chain.seed, chain.episode)
    held.set_goal(0, chain.goals[0])
    now = held.senses.read()
    tips = held.operator.guide(now).tips
    for _ in range(4):
        now = held.execute(held.operator.guide(now).joints)
    carrying = now.loads > CONTACT_FORCE
    np.testing.assert_allclose(kernels.fingertips(SHARPA.tables, now.joints), now.tips, atol=1e-6)
    asked, got = tips[4] - tips[0], now.tips - tips[0]
    assert np.linalg.norm(asked[carrying], axis=1).min() > 0.002
    assert np.linalg.norm((asked - got)[carrying], axis=1).max() < 0.006


def test_new_places_keep_the_fingers_as_far_apart_as_their_pads_are_wide():
    held = HeldObject(ReachEnv(cameras=(), hand=SHARPA), MANY_PLACES)
    now, operator = held.senses.read(), held.operator
    points, normals = operator.surface
    for finger in range(SHARPA.n_fingers):
        rng = np.random.default_rng(0)
        places = regrasp_points(operator, now, finger, operator.surface, rng, limit=4)
        assert len(places) == 4, SHARPA.finger_names[finger]
        others = [k for k in np.flatnonzero(operator.fingers.mode == Mode.HOLD) if k != finger]
        kept = (now.points[others] - now.position) @ now.rotation
        for anchor, inward in places:
            alike = points[(normals @ -inward) > 1 - 1e-9]
            place = alike[np.linalg.norm(alike - anchor, axis=1).argmin()]
            assert np.linalg.norm(place - kept, axis=1).min() >= SHARPA.pad_spacing - 0.001
