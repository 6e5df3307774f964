"""The fast force balance says about what the exact one says."""

import numpy as np
import pytest

from lerobot_dexflex.experts.reach.balance import balance_forces
from lerobot_dexflex.hand import contacts


@pytest.mark.parametrize("seed", range(3))
def test_force_balance_agrees_with_non_negative_least_squares(seed):
    points = np.random.default_rng(seed).normal(scale=0.03, size=(4, 3))
    inward = -points / np.linalg.norm(points, axis=1, keepdims=True)
    wrench = np.array([0.5, 0.0, 1.5, 0.0, 0.0, 0.0])
    arguments = points, inward, np.zeros(3), wrench, 0.6, 1.5
    forces, residual = balance_forces(*arguments)
    expected, expected_residual = contacts.balance_forces(*arguments)
    np.testing.assert_allclose(forces, expected, atol=0.3)  # Coordinate descent, not to the end.
    assert residual == pytest.approx(expected_residual, abs=0.02)
    assert ((forces * inward).sum(1) >= -1e-9).all()
