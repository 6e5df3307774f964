"""How the operator holds the hammer, and turns it straight in the hand."""

import numpy as np
import pytest
from expert_checks import angle_between, demonstrate, pads_of

from lerobot_dexflex.experts.place_hammer import GRASP_AT
from lerobot_dexflex.experts.tool.bar import HELD
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.hands import LEAP

HOLD = holds_of(LEAP).bar
FOUR, THREE = 11, 8
"""Seeds of hammers gripped by all fingers, and without the ring finger."""


@pytest.mark.parametrize(("seed", "idle"), [(FOUR, []), (THREE, [2])])
def test_the_thumb_holds_against_the_fingers_that_were_drawn(seed, idle):
    shown = demonstrate("PlaceHammer-v0", seed)
    gripped, held = shown.forces[shown.during(1, 2)], shown.forces[shown.during(2, 4)]
    assert ((gripped[:, np.setdiff1d(np.arange(4), idle)] > 0.05).mean(0) > 0.7).all()
    assert not gripped[:, idle].any()
    assert held[:, 3].mean() == pytest.approx(held[:, :3].sum(1).mean(), rel=0.5)


def test_the_hammer_is_gripped_askew_and_turned_straight_in_the_hand():
    shown = demonstrate("PlaceHammer-v0")
    handles = shown.rotations[:, :, 2]
    gripped = int(np.argmax(shown.progress > 0))
    assert angle_between(handles[gripped], HELD[:, 2]) > 0.25
    straight = shown.during(3, 4)
    assert angle_between(handles, HELD[:, 2])[straight].max() < 0.06
    offsets = shown.positions - (HOLD.centre - GRASP_AT * HELD[:, 2])
    assert np.linalg.norm(offsets, axis=1)[straight].max() < 0.004


def test_the_search_for_a_grip_begins_with_all_four_pads_flat_on_a_handle():
    centres, normals = pads_of(HOLD.touch)
    side = np.array([1, 1, 1, -1])
    # The handle is a cylinder of 13 mm radius along palm y through the grasp centre.
    assert np.allclose(centres[:, 0] - HOLD.centre[0], side * 0.013, atol=1e-3)
    assert np.allclose(centres[:, 2], HOLD.centre[2], atol=1e-3)
    assert np.allclose(normals[:, 0], -side, atol=1e-3)
