"""Batched fingertip kinematics against MuJoCo, against itself, and its behaviour under bad wishes."""

import mujoco
import numpy as np
import pytest
import torch

from lerobot_dexflex.hand import kernels, kinematics
from lerobot_dexflex.hand.model import add_hand, base_spec
from lerobot_dexflex.hands import LEAP

LOWER, UPPER = kinematics.joint_limits(LEAP)


@pytest.fixture
def joints():
    share = torch.rand(64, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    return torch.lerp(LOWER, UPPER, 0.25 + 0.5 * share)


def near(joints, scale=0.1):
    noise = torch.randn(joints.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return (joints + scale * noise).clamp(LOWER, UPPER)


def test_fingertips_and_pads_agree_with_mujoco(joints):
    spec = base_spec()
    add_hand(spec, spec.worldbody, LEAP, (0, 0, 0), (1, 0, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    tips, (pads, normals) = kinematics.fingertips(LEAP, joints), kinematics.pads(LEAP, joints)
    for row in range(len(joints)):
        data.qpos[:] = joints[row].numpy()
        mujoco.mj_kinematics(model, data)
        for k, finger in enumerate(LEAP.prefixes):
            assert np.allclose(tips[row, k], data.site(f"{finger}_tip").xpos, atol=1e-9)
            pad = data.site(f"{finger}_pad")
            assert np.allclose(pads[row, k], pad.xpos, atol=1e-9)
            assert np.allclose(normals[row, k], pad.xmat.reshape(3, 3)[:, 2], atol=1e-9)


def test_targets_are_reached_within_a_millimetre_on_average_and_exactly_without_the_tie(joints):
    targets = kinematics.fingertips(LEAP, near(joints))
    error = (kinematics.fingertips(LEAP, kinematics.solve_fingertips(LEAP, targets, joints)) - targets).norm(
        dim=-1
    )
    assert error.mean() < 1e-3
    free = kinematics.solve_fingertips(LEAP, targets, joints, posture_weight=0.0, iterations=20)
    assert (kinematics.fingertips(LEAP, free) - targets).norm(dim=-1).median() < 1e-5


def test_one_row_gives_the_same_bits_as_the_batch(joints):
    targets = kinematics.fingertips(LEAP, near(joints))
    batch = kinematics.solve_fingertips(LEAP, targets, joints)
    rows = [
        kinematics.solve_fingertips(LEAP, targets[k : k + 1], joints[k : k + 1]) for k in range(len(joints))
    ]
    assert torch.equal(batch, torch.cat(rows))


def test_numbers_come_back_in_the_type_they_came_in(joints):
    tips, (centres, normals) = (
        kinematics.fingertips(LEAP, joints.float()),
        kinematics.pads(LEAP, joints.float()),
    )
    solved = kinematics.solve_fingertips(LEAP, kinematics.fingertips(LEAP, joints) + 0.002, joints.float())
    assert {x.dtype for x in (tips, centres, normals, solved)} == {torch.float32}
    exact = kinematics.solve_fingertips(
        LEAP, kinematics.fingertips(LEAP, joints) + 0.002, joints.float().double()
    )
    assert torch.equal(solved, exact.float())  # Computed in float64, rounded once.


def test_the_current_fingertips_leave_the_posture_alone(joints):
    solved = kinematics.solve_fingertips(LEAP, kinematics.fingertips(LEAP, joints), joints)
    assert torch.allclose(solved, joints, atol=1e-9)


def test_the_tie_keeps_the_free_joint_from_wandering(joints):
    """Thirty steps of noise around fixed fingertips: a weak tie drifts, the default stays near."""
    generator = torch.Generator().manual_seed(2)
    targets = kinematics.fingertips(LEAP, joints)
    noise = 0.002 * (2 * torch.rand(30, *targets.shape, dtype=torch.float64, generator=generator) - 1)

    def drift(weight):
        posture = joints
        for step in noise:
            posture = kinematics.solve_fingertips(LEAP, targets + step, posture, posture_weight=weight)
        return (posture - joints).abs().mean()

    assert drift(kernels.POSTURE_WEIGHT) < 0.7 * drift(0.001)


@pytest.mark.parametrize("far", [0.3, 10.0])
def test_unreachable_targets_give_finite_joints_within_the_limits(joints, far):
    solved = kinematics.solve_fingertips(LEAP, kinematics.fingertips(LEAP, joints) + far, joints)
    assert torch.isfinite(solved).all()
    assert (solved >= LOWER).all()
    assert (solved <= UPPER).all()


def test_limits_are_those_of_the_tables():
    assert LOWER.tolist() == [link.joint_range[0] for link in LEAP.links]
    assert UPPER.tolist() == [link.joint_range[1] for link in LEAP.links]
