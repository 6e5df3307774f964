"""The pieces of an expert's motion are as documented."""

import numpy as np
import pytest

from lerobot_dexflex.experts.command import Unsteadiness, fingertips_of, min_jerk
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hands import LEAP


def test_unsteadiness_has_the_documented_size_and_correlation():
    noise = Unsteadiness(np.random.default_rng(0), np.full(2000, 0.01))
    values = np.array([noise.step() for _ in range(60)])[30:]
    assert values.std() == pytest.approx(0.01, rel=0.05)
    assert np.corrcoef(values[:-1].ravel(), values[1:].ravel())[0, 1] == pytest.approx(0.95, abs=0.02)


def test_min_jerk_starts_and_ends_at_rest_and_is_symmetric():
    assert [min_jerk(0), min_jerk(0.5), min_jerk(1)] == [0, 0.5, 1]
    assert min_jerk(0.01) < 1e-4


def test_fingertips_of_joints_agree_with_the_kernel():
    joints = np.array(LEAP.nominal_joints)
    assert np.allclose(fingertips_of(LEAP, joints), fingertips(LEAP.tables, joints), atol=1e-9)
