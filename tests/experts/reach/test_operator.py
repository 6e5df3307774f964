"""The operator holds and leads the object by its own joint targets, and says what the tips will do."""

import numpy as np
import pytest

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import TOLERANCE, HeldObject
from lerobot_dexflex.experts.reach.fingers import Mode
from lerobot_dexflex.experts.reach.operator import LEAD, LEAST_FORCE, Operator
from lerobot_dexflex.experts.reach.paths import LIFT_HEIGHT, LIFT_STEPS, SWING_SPEED
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.poses import pose_error, quaternion_of, quaternion_product
from lerobot_dexflex.hands import LEAP

SEEDS = (50_003, 50_006, 50_010)
FOUR, FINGER = 50_014, 1
"""A start in which all fingers hold, and one of them that no other is in the way of."""


@pytest.fixture(scope="module")
def env():
    return ReachEnv(cameras=())


@pytest.fixture
def held(env):
    """An object in the hand whose four fingers have settled."""
    return settled(env, FOUR)


def settled(env, seed, steps=6):
    held = HeldObject(env, seed)
    work(held, steps)
    return held


def work(held, steps):
    """Execute the operator's joint targets; returns what it said and the states it led to."""
    said, states = [], []
    for _ in range(steps):
        said.append(held.operator.guide())
        states.append(held.execute(said[-1].joints))
    return said, states


def lift(held, finger=FINGER):
    """Send a finger to where it is already; returns where its contact points into the object, palm frame."""
    now = held.senses.read()
    fingers = held.operator.fingers
    held.operator.regrasp(finger, fingers.anchor[finger].copy(), fingers.inward[finger].copy(), now)
    return now.rotation @ fingers.inward[finger]


@pytest.mark.parametrize("seed", SEEDS)
def test_its_own_joint_targets_hold_an_object_where_it_is(env, seed):
    held = HeldObject(env, seed)
    before = held.senses.read()
    _, states = work(held, 60)
    for state in states:
        assert (state.loads > CONTACT_FORCE).sum() >= 2
    distance, angle = pose_error(
        states[-1].position, states[-1].quaternion, before.position, before.quaternion
    )
    assert distance < 0.005
    assert angle < 0.2


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("seed", SEEDS)
def test_it_leads_the_object_to_goals(env, seed, axis):
    held = settled(env, seed)
    now, start, unit = held.senses.read(), held.snapshot(), np.eye(3)[axis]
    moved = now.position + 0.015 * unit, now.quaternion
    turned = now.position, quaternion_product(quaternion_of(0.35 * unit), now.quaternion)
    for goal in (moved, turned):
        held.restore(start)
        held.operator.set_goal(*goal)
        _, states = work(held, 25)
        distance, angle = pose_error(states[-1].position, states[-1].quaternion, *goal)
        assert distance < TOLERANCE[0]
        assert angle < TOLERANCE[1]


@pytest.mark.parametrize("lifted", [False, True])
def test_what_it_says_is_a_function_of_its_state_bit_for_bit(held, lifted):
    now = held.senses.read()
    held.operator.set_goal(now.position + np.array([0.0, 0.0, 0.01]), now.quaternion)
    if lifted:
        lift(held)
        work(held, 3)
    state, now = held.operator.state(), held.senses.read()
    first = [held.operator.guide(now) for _ in range(5)]
    held.operator.set_state(state)
    again = [held.operator.guide(now) for _ in range(5)]
    other = Operator(held.senses, np.random.default_rng(7))
    other.set_state(state)
    others = [other.guide(now) for _ in range(5)]
    for one, two, three in zip(first, again, others, strict=True):
        for a, b, c in zip(one, two, three, strict=True):
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(a, c)
    assert not np.array_equal(first[0].tips, first[-1].tips)  # It goes on meanwhile.


def test_a_snapshot_is_not_changed_by_what_comes_after(held):
    state = held.operator.state()
    before = state.fingers.anchor.copy(), state.fingers.forces.copy(), state.rng
    lift(held)
    work(held, 4)
    np.testing.assert_array_equal(state.fingers.anchor, before[0])
    np.testing.assert_array_equal(state.fingers.forces, before[1])
    assert state.fingers.mode[FINGER] == Mode.HOLD


def test_a_lifted_fingers_look_ahead_goes_outward_and_is_what_it_then_does(held):
    inward = lift(held)
    assert held.operator.gaiting
    now = held.senses.read()
    guidance = held.operator.guide(now)
    ahead = -(guidance.tips[:, FINGER] - now.tips[FINGER]) @ inward
    assert (np.diff(ahead) > 0).all()
    assert ahead[-1] == pytest.approx(LIFT_HEIGHT, abs=0.004)
    assert not guidance.forces[FINGER].any()
    held.execute(guidance.joints)
    _, states = work(held, 7)
    reached = states[-1].tips[FINGER]
    assert np.linalg.norm(reached - guidance.tips[-1, FINGER]) < 0.006
    assert states[-1].loads[FINGER] < CONTACT_FORCE


def test_a_lifted_finger_comes_back_to_the_object_and_holds_again(held):
    lift(held)
    modes = []
    for _ in range(45):
        work(held, 1)
        modes.append(int(held.operator.fingers.mode[FINGER]))
        if modes[-1] == Mode.HOLD:
            break
    assert sorted(set(modes), key=modes.index) == [Mode.LIFT, Mode.SWING, Mode.PLACE, Mode.HOLD]
    assert LIFT_STEPS - 1 <= modes.count(Mode.LIFT) <= LIFT_STEPS
    _, states = work(held, 10)  # It may bounce once.
    assert all(state.loads[FINGER] > 0.5 for state in states[5:])


def test_a_parked_finger_is_to_stay_where_it_is_parked(held):
    now, operator = held.senses.read(), held.operator
    operator.fingers.mode[FINGER] = Mode.PARKED
    away = np.array([0.0, 0.0, 0.010])
    operator.fingers.park[FINGER] = now.tips[FINGER] + away
    guidance = operator.guide(now._replace(loads=now.loads * (np.arange(4) != FINGER)))
    ahead = guidance.tips[1:, FINGER] - now.tips[FINGER]
    np.testing.assert_allclose(ahead, np.tile(away, (7, 1)), atol=1e-12)


def test_the_first_step_is_where_its_joints_lead_beside_the_grip(held):
    now = held.senses.read()
    guidance = held.operator.guide(now)
    torques = kernels.contact_torques(LEAP.tables, now.joints, guidance.points, guidance.grip)
    reached = kernels.fingertips(LEAP.tables, guidance.joints - torques / 3.0)
    assert np.linalg.norm(reached - guidance.tips[0], axis=1).max() <= 1e-9


def test_carrying_fingers_go_with_the_object_as_one_body(held):
    """In the look-ahead their distances hardly change, and nothing is faster than the lead."""
    now = held.senses.read()
    held.operator.set_goal(now.position + np.array([0.0, 0.0, 0.02]), now.quaternion)
    guidance = held.operator.guide(now)
    carrying = now.loads > CONTACT_FORCE
    assert carrying.sum() >= 3
    tips = guidance.tips[:, carrying]
    spread = np.linalg.norm(tips[:, :, None] - tips[:, None], axis=-1)
    assert np.abs(spread - spread[0]).max() < 1e-3
    steps = np.diff(tips, axis=0)
    assert np.linalg.norm(steps, axis=-1).max() <= LEAD[0] + 1e-9
    assert (steps[..., 2] > 0.0005).all()  # All go the way of the goal.


def test_forces_carry_the_weight_inside_the_friction_cones(held):
    _, states = work(held, 15)
    now = states[-1]
    held.operator.set_goal(now.position, now.quaternion)
    said, _ = work(held, 15)
    now = held.senses.read()
    guidance = held.operator.guide(now)
    weight = -held.senses.mass * held.senses.gravity
    assert np.linalg.norm(guidance.forces.sum(0) - weight) < 0.35 * np.linalg.norm(weight) + 0.15
    normals = held.operator.fingers.inward @ now.rotation.T
    along = (guidance.forces * normals).sum(1)
    across = np.linalg.norm(guidance.forces - along[:, None] * normals, axis=1)
    pressing = np.linalg.norm(guidance.forces, axis=1) > 0.1
    assert pressing.sum() >= 3
    assert (across[pressing] <= 1.1 * held.senses.friction * along[pressing] * np.sqrt(2)).all()
    assert said


def test_a_finger_that_lost_the_object_seeks_it_with_a_small_force(held):
    operator, fingers = held.operator, held.operator.fingers
    now = held.senses.read()
    fingers.timer[FINGER] = 3
    away = now._replace(loads=np.where(np.arange(4) == FINGER, 0.0, now.loads))
    for _ in range(20):
        operator.guide(away)
        fingers.timer[FINGER] = 3
    inward = now.rotation @ fingers.inward[FINGER]
    np.testing.assert_allclose(operator.guide(away).forces[FINGER], LEAST_FORCE * inward, atol=0.01)


def test_an_expected_finger_seeks_instead_of_staying_parked(held):
    operator, now = held.operator, held.senses.read()
    operator.fingers.mode[FINGER] = Mode.PARKED
    inward = np.zeros((4, 3))
    inward[FINGER] = (0.0, 0.0, 1.0)
    operator.expect(inward, now)
    assert operator.fingers.mode[FINGER] == Mode.HOLD
    np.testing.assert_allclose(now.rotation @ operator.fingers.inward[FINGER], inward[FINGER], atol=1e-12)


def test_a_firmer_operator_squeezes_more(env):
    held = settled(env, FOUR)
    now = held.senses.read()
    wanted, exerted = [], []
    for strength in (1.0, 2.0):
        guidance = Operator(held.senses, np.random.default_rng(0), strength).guide(now)
        wanted.append(np.linalg.norm(guidance.forces, axis=1).sum())
        exerted.append(np.linalg.norm(guidance.grip, axis=1).sum())
    assert exerted[1] > 1.5 * exerted[0]
    assert wanted == [exerted[0]] * 2  # What it holds for right does not depend on it.


def test_it_does_not_push_an_object_that_fewer_than_two_fingers_hold(held):
    now = held.senses.read()
    held.operator.set_goal(now.position + np.array([0.0, 0.0, 0.02]), now.quaternion)
    loads = np.array([1.0, 0.0, 0.0, 0.0])
    alone = now._replace(loads=loads, points=np.where(loads[:, None] > 0, now.points, now.tips))
    guidance = held.operator.guide(alone)
    for _ in range(10):
        guidance = held.operator.guide(alone)
        assert np.linalg.norm(guidance.tips - alone.tips, axis=-1).max() < 8 * SWING_SPEED
    assert np.linalg.norm(guidance.tips[:, 0] - alone.tips[0], axis=-1).max() < 0.001
    held.operator.set_state(held.operator.state())
    free = now._replace(loads=np.zeros(4), points=now.tips, inward=np.zeros((4, 3)))
    for _ in range(10):
        assert all(np.isfinite(part).all() for part in held.operator.guide(free))


def test_a_finger_goes_to_a_better_place_only_if_three_hold(held):
    operator = held.operator
    loads = held.senses.read().loads
    assert (loads > 2 * CONTACT_FORCE).sum() >= 3
    went = operator.try_gait()
    assert went == operator.gaiting
    operator.fingers.mode[:] = Mode.HOLD
    operator.fingers.mode[2] = Mode.LIFT
    assert not operator.try_gait()  # One at a time.


def test_the_operators_randomness_is_its_own(held):
    operator, state = held.operator, held.operator.state()
    choices = []
    for seed in (1, 1, 2, 3, 4, 5):
        operator.set_state(state)
        operator.reseed(seed)
        choices.append(tuple(operator._rng.permutation(4)))
    assert choices[0] == choices[1]
    assert len(set(choices)) > 1
