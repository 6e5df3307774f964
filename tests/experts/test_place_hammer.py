"""How the expert of PlaceHammer holds the hammer."""

import numpy as np
import pytest
from expert_checks import demonstrate, pads_of

from lerobot_dexflex.experts.place_hammer import GRASP_CENTRE, HAND_TOUCH


def test_expert_squeezes_with_all_four_fingers_and_the_thumb_balances_three():
    held = demonstrate("PlaceHammer-v0").forces[80:140]
    assert (held > 0.5).all()
    assert held[:, 3].mean() == pytest.approx(held[:, :3].sum(1).mean(), rel=0.35)


def test_touch_posture_lays_all_four_pads_flat_on_the_handle():
    centres, normals = pads_of(HAND_TOUCH)
    side = np.array([1, 1, 1, -1])
    # The handle is a cylinder of 13 mm radius along palm y through the grasp centre.
    assert np.allclose(centres[:, 0] - GRASP_CENTRE[0], side * 0.013, atol=1e-3)
    assert np.allclose(centres[:, 2], GRASP_CENTRE[2], atol=1e-3)
    assert np.allclose(normals[:, 0], -side, atol=1e-3)
