"""Statics of fingers on an object: pads laid on surfaces, torques by virtual work, forces in balance."""

import numpy as np
import pytest
import torch

from lerobot_dexflex.hand.contacts import balance_forces, pinched, solve_pads
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import LEAP

NOMINAL = torch.tensor([LEAP.nominal_joints], dtype=torch.float64)


def test_pads_are_laid_on_points_that_a_near_posture_reaches():
    generator = torch.Generator().manual_seed(0)
    joints = NOMINAL + 0.15 * torch.randn(32, 16, dtype=torch.float64, generator=generator)
    centres, outward = pads(LEAP, joints)
    solution = solve_pads(LEAP, centres, -outward, NOMINAL.expand(32, -1))
    assert solution.distance.max() < 2e-3
    assert solution.alignment.min() > 0.98
    reached, _ = pads(LEAP, solution.joints)
    assert torch.allclose((reached - centres).norm(dim=-1), solution.distance)


def test_two_opposite_pads_carry_a_weight_by_friction_alone():
    points = np.array([[0.02, 0, 0], [-0.02, 0, 0]])
    weight = np.array([0, 0, 2.0, 0, 0, 0])
    forces, missing = balance_forces(points, np.sign(-points), np.zeros(3), weight, friction=0.5, preload=3.0)
    # By symmetry each carries 1 N upward (the preload costs some of it) and presses alike.
    assert forces[:, 2] == pytest.approx([1, 1], abs=0.1)
    assert forces[0, 0] == pytest.approx(-forces[1, 0], abs=1e-6)
    assert missing < 0.2
    # Inside the friction cones, pressing.
    assert (forces[:, 0] * -points[:, 0] > 0).all()
    assert np.abs(forces[:, 2] / forces[:, 0]).max() <= 0.5 + 1e-9


def test_pads_on_one_side_cannot_squeeze():
    points = np.array([[0.02, 0.01, 0], [0.02, -0.01, 0]])
    inward = np.array([[-1.0, 0, 0], [-1.0, 0, 0]])
    forces, _ = balance_forces(points, inward, np.zeros(3), np.zeros(6), friction=0.5, preload=1.0)
    assert np.linalg.norm(forces, axis=1).max() < 0.1
    _, missing = balance_forces(points, inward, np.zeros(3), np.array([5.0, 0, 0, 0, 0, 0]), 0.5, preload=1.0)
    assert missing > 4.5


def test_a_pinch_needs_the_thumb_and_a_finger():
    assert pinched(LEAP, {"th_ds", "rf_ds", "table"})
    assert not pinched(LEAP, {"if_ds", "mf_ds", "rf_ds"})
    assert not pinched(LEAP, {"th_ds", "if_px", "palm_lower"})
