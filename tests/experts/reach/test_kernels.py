"""The compiled kinematics and statics say what the batched torch versions say."""

import numpy as np
import pytest
import torch

from lerobot_dexflex.experts.reach import kernels
from lerobot_dexflex.hand import contacts, kinematics


@pytest.fixture(params=range(3))
def rng(request):
    return np.random.default_rng(request.param)


def hand(rng: np.random.Generator) -> np.ndarray:
    return np.array(contacts.NOMINAL_JOINTS) + rng.normal(scale=0.15, size=16)


def test_fingertips_agree_with_torch(rng):
    joints = hand(rng)
    expected = kinematics.fingertips(torch.tensor(joints)[None])[0].numpy()
    np.testing.assert_allclose(kernels.fingertips(joints), expected, atol=1e-12)


@pytest.mark.parametrize("reach", [0.003, 0.02, 0.3])
def test_inverse_kinematics_is_the_executors_law(rng, reach):
    joints = hand(rng)
    targets = kernels.fingertips(joints) + rng.normal(scale=reach, size=(4, 3))
    expected = kinematics.solve_fingertips(torch.tensor(targets)[None], torch.tensor(joints)[None])[0].numpy()
    np.testing.assert_allclose(kernels.solve_fingertips(targets, joints), expected, atol=1e-9)


def test_torques_do_the_work_of_the_forces(rng):
    joints, forces, change = hand(rng), rng.normal(size=(4, 3)), 1e-6 * rng.normal(size=16)
    tips = kernels.fingertips(joints)
    torques = kernels.contact_torques(joints, tips, forces)
    moved = kernels.fingertips(joints + change) - tips
    assert torques @ change == pytest.approx((forces * moved).sum(), rel=1e-3, abs=1e-9)


def test_force_balance_agrees_with_non_negative_least_squares(rng):
    points = rng.normal(scale=0.03, size=(4, 3))
    inward = -points / np.linalg.norm(points, axis=1, keepdims=True)
    wrench = np.array([0.5, 0.0, 1.5, 0.0, 0.0, 0.0])
    arguments = points, inward, np.zeros(3), wrench, 0.6, 1.5
    forces, residual = kernels.balance_forces(*arguments)
    expected, expected_residual = contacts.balance_forces(*arguments)
    np.testing.assert_allclose(forces, expected, atol=0.3)  # Coordinate descent, not to the end.
    assert residual == pytest.approx(expected_residual, abs=0.02)
    assert ((forces * inward).sum(1) >= -1e-9).all()
