"""How the expert of AssembleTable holds the leg and screws it in."""

import numpy as np
import pytest
from expert_checks import demonstrate, pads_of

from lerobot_dexflex.experts.assemble_table import GRASP_CENTRE, HAND_TOUCH


@pytest.fixture
def demonstration():
    return demonstrate("AssembleTable-v0")


def test_the_leg_is_tight_at_the_end(demonstration):
    assert demonstration.env.lit


def test_expert_holds_the_leg_with_thumb_against_index_and_middle(demonstration):
    stages = demonstration.progress
    held = demonstration.forces[(stages >= 2 / 6) & (stages < 4 / 6)]
    assert len(held) > 30
    assert (held[:, [0, 1, 3]] > 0.5).all()
    assert not held[:, 2].any()
    assert held[:, 3].mean() == pytest.approx(held[:, :2].sum(1).mean(), rel=0.35)


def test_expert_takes_every_stage(demonstration):
    assert set(np.round(6 * demonstration.progress)) == set(range(7))


def test_joint_7_turns_once_without_regrasp(demonstration):
    wrist = np.array([command.joint_targets[6] for command in demonstration.commands])
    assert 2 * np.pi < np.ptp(wrist) < 3 * np.pi
    assert np.abs(np.diff(wrist)).max() < 0.15  # no jump of a branch


def test_touch_posture_puts_three_pads_on_the_leg():
    centres, normals = pads_of(HAND_TOUCH)
    used = [0, 1, 3]
    offsets = (centres - GRASP_CENTRE)[used]
    # Distance of the leg's axis (palm z through the grasp centre) from the pads' planes: the leg's radius.
    distances = -(offsets * normals[used]).sum(1)
    assert np.allclose(distances, 0.012, atol=1e-3)
    assert np.allclose(offsets[:, 2], 0, atol=1e-3)
    assert normals[3] @ (normals[0] + normals[1]) < -1.9
