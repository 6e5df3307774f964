"""New places for a finger are on the object, within reach, apart from the others, in balance."""

import numpy as np
import pytest

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import HeldObject
from lerobot_dexflex.experts.reach.fingers import Mode
from lerobot_dexflex.experts.reach.regrasp import regrasp_points

FINGER, SPACING = 1, 0.024


@pytest.fixture(scope="module")
def held():
    held = HeldObject(ReachEnv(cameras=()), 50_017)
    for _ in range(6):
        held.execute(held.operator.guide().joints)
    return held


def found(held, seed=0, finger=FINGER, **arguments):
    operator = held.operator
    now, rng = held.senses.read(), np.random.default_rng(seed)
    return regrasp_points(operator, now, finger, operator.surface, rng, **arguments)


def test_places_are_on_the_surface_apart_from_other_fingers_and_face_into_the_object(held):
    points, normals = held.operator.surface
    now = held.senses.read()
    others = (now.points[[0, 2, 3]] - now.position) @ now.rotation
    places = [place for seed in range(5) for place in found(held, seed, limit=4)]
    assert len(places) >= 3
    for anchor, inward in places:
        assert np.linalg.norm(inward) == pytest.approx(1.0, abs=1e-6)
        # The anchor is the fingertip's, which is up to some millimetres above its pad's contact point.
        alike = points[(normals @ -inward) > 1 - 1e-9]
        reach = np.linalg.norm(alike - anchor, axis=1)
        assert reach.min() < 0.035
        assert np.linalg.norm(alike[reach.argmin()] - others, axis=1).min() >= SPACING


def test_the_number_of_places_is_limited_and_a_seed_decides_them(held):
    assert len(found(held, limit=1)) == 1
    for first, second in zip(found(held, 3), found(held, 3), strict=True):
        np.testing.assert_array_equal(first[0], second[0])


def test_two_other_fingers_must_hold(held):
    operator = held.operator
    state = operator.state()
    assert found(held)
    operator.fingers.mode[[0, 2]] = int(Mode.LIFT)
    places = found(held)
    operator.set_state(state)
    assert places == []


def test_a_firm_regrasp_asks_that_the_others_carry_the_object_well(held):
    """Without the thumb three fingers on one side cannot."""
    thumb = 3
    assert found(held, finger=FINGER, firm=True)
    assert found(held, finger=thumb, firm=True) == []
