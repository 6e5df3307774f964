"""How hands hold tools: known holds, and those that are found for a hand that nobody has described."""

import numpy as np
import pytest
import torch

from lerobot_dexflex.experts.tool.grip import Handle, all_fingers, without
from lerobot_dexflex.experts.tool.hold_search import find_holds, working_frame
from lerobot_dexflex.experts.tool.holds import BAR_RADIUS
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import LEAP, SHARPA

AXIS, UP = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


def seen(hand, frame, joints):
    """Return centres [m] and outward normals of the pads, working frame, each (fingers, 3)."""
    centres, outward = pads(hand, torch.tensor(np.array([joints])))
    return centres[0].numpy() @ frame, outward[0].numpy() @ frame


def test_fingers_are_counted_by_what_they_do():
    assert all_fingers(SHARPA) == (0, 1, 2, 3, 4)
    assert (without(LEAP, 1), without(LEAP, -1)) == ((0, 2, 3), (0, 1, 3))
    assert (without(SHARPA, 1), without(SHARPA, -1)) == ((0, 2, 3, 4), (0, 1, 2, 4))


def test_in_the_working_frame_fingers_push_one_way_and_the_thumb_the_other():
    frame = working_frame(SHARPA)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) > 0
    _, outward = seen(SHARPA, frame, SHARPA.nominal_joints)
    assert (outward[list(SHARPA.opposed_fingers), 0] < -0.99).all()
    assert outward[4, 0] > 0.7
    np.testing.assert_allclose(frame[:, 1], SHARPA.finger_order, atol=1e-12)


def test_a_known_hold_is_not_searched_for_and_a_found_one_is_found_again():
    assert np.array_equal(holds_of(LEAP).frame, np.eye(3))
    assert holds_of(SHARPA) is holds_of(SHARPA)
    again = find_holds(SHARPA)
    np.testing.assert_array_equal(again.bar.centre, holds_of(SHARPA).bar.centre)
    np.testing.assert_array_equal(again.habits[1].touch, holds_of(SHARPA).habits[1].touch)


@pytest.mark.parametrize("lean", [-0.2, 0.0, 0.2])
@pytest.mark.parametrize("radius", [0.010, 0.014])
def test_five_pads_lie_on_both_sides_of_bars_of_several_widths(lean, radius):
    hold = holds_of(SHARPA).bar
    axis = np.array([0.0, np.cos(lean), np.sin(lean)])
    grip = hold.grip(axis, radius, all_fingers(SHARPA))
    centres, _ = seen(SHARPA, hold.frame, grip.touch)
    off = centres - hold.centre
    distance = np.linalg.norm(off - np.outer(off @ axis, axis), axis=1)
    assert np.abs(distance - radius).max() < 0.007
    assert np.median(np.abs(distance - radius)) < 0.002
    assert (off[list(SHARPA.opposed_fingers), 0] > 0.5 * radius).all()
    assert off[4, 0] < -0.5 * radius
    opened, _ = seen(SHARPA, hold.frame, grip.open)
    assert opened[:4, 0].min() - opened[4, 0] > 2 * radius + 0.03


@pytest.mark.parametrize("place", [0, 1])
def test_two_neighbours_and_the_thumb_hold_an_upright_bar(place):
    habit = holds_of(SHARPA).habits[place]
    assert habit.fingers == (place, place + 1, 4)
    grip = habit.grip(Handle(habit.centre, UP, BAR_RADIUS))
    centres, _ = seen(SHARPA, habit.frame, grip.touch)
    off = (centres - habit.centre)[list(habit.fingers)]
    assert off[0, 1] > 0.004 > -0.004 > off[1, 1]
    assert (off[:2, 0] > 0).all()
    assert off[2, 0] < 0
    idle = ~np.isin(SHARPA.finger_of_joint, habit.fingers)
    np.testing.assert_array_equal(grip.touch[idle], np.array(SHARPA.idle_joints)[idle])
