import numpy as np
import pytest

from lerobot_dexflex.hand.winkler import blur_matrix, winkler_loads


def test_springs_share_a_force_as_computed_by_hand():
    depths = np.array([[0.003, 0.002, 0.001, 0.0]])
    # k = 100 N/m. 0.05 N: the deepest alone would be pressed 0.5 mm, less than it lies deeper than the next.
    # 0.2 N: two springs, 0.003 + 0.002 - 2 offset = 0.002, offset 1.5 mm. 0.6 N: three springs, offset 0.
    # 0.9 N: still three, as the fourth is outside: offset -1 mm.
    expected = [[0.05, 0, 0, 0], [0.15, 0.05, 0, 0], [0.3, 0.2, 0.1, 0], [0.4, 0.3, 0.2, 0]]
    for force, loads in zip((0.05, 0.2, 0.6, 0.9), expected, strict=True):
        assert winkler_loads(depths, np.array([force]), 100.0)[0] == pytest.approx(loads)


def test_loads_sum_to_the_force_and_are_never_negative():
    rng = np.random.default_rng(0)
    depths = np.maximum(rng.normal(0, 0.001, (50, 60)), 0)
    forces = rng.uniform(0.01, 8, 50)
    loads = winkler_loads(depths, forces, 60.0)
    assert loads.min() >= 0
    assert loads.sum(axis=1) == pytest.approx(forces)


@pytest.mark.parametrize("sigma", [0.0, 0.3, 1.0])
def test_blur_conserves_force_and_keeps_a_uniform_load_uniform(sigma):
    blur = blur_matrix(6, sigma)
    assert blur.sum(axis=0) == pytest.approx(np.ones(6))
    assert blur.sum(axis=1) == pytest.approx(np.ones(6))


def test_blur_spreads_a_point_load_to_its_neighbours():
    # exp(-1 / 2) = 0.607 of the centre's share at a distance of one standard deviation.
    row = blur_matrix(11, 1.0)[5]
    assert row[4] / row[5] == pytest.approx(np.exp(-0.5))
    assert row[6] == row[4]
