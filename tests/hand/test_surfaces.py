"""Surface points: on the surface, with outward normals, spread by area, never inside the object."""

import numpy as np
import pytest

from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hand.surfaces import surface_samples

BOX, RADIUS, HALF = np.array([0.02, 0.03, 0.04]), 0.02, 0.03


def box_distance(points, half=BOX):
    outside = np.abs(points) - half
    return np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(1), 0)


def capsule_distance(points, radius=RADIUS, half=HALF):
    axis = np.clip(points[:, 2], -half, half)[:, None] * [0, 0, 1]
    return np.linalg.norm(points - axis, axis=1) - radius


def cylinder_distance(points):
    sides = np.stack([np.linalg.norm(points[:, :2], axis=1) - RADIUS, np.abs(points[:, 2]) - HALF], 1)
    return np.linalg.norm(np.maximum(sides, 0), axis=1) + np.minimum(sides.max(1), 0)


def tool_distance(points):
    head = points - [0, 0, 0.05 + 0.006]
    return np.minimum(capsule_distance(points, 0.012, 0.05), box_distance(head, np.array([0.02, 0.03, 0.02])))


@pytest.mark.parametrize(
    ("kind", "size", "distance"),
    [
        ("box", tuple(BOX), box_distance),
        ("cylinder", (RADIUS, HALF), cylinder_distance),
        ("capsule", (RADIUS, HALF), capsule_distance),
        ("tool", (0.012, 0.05, 0.02, 0.03, 0.02), tool_distance),
    ],
)
def test_points_lie_on_the_surface_and_normals_point_out(kind, size, distance):
    points, normals = surface_samples(ObjectSpec(kind, size, 0.1), 500, np.random.default_rng(0))
    assert points.shape == normals.shape == (500, 3)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.abs(distance(points)).max() < 1e-9
    # Room for a pad: neither an edge nor a tool's other part is nearer than the test's millimetre.
    assert distance(points + 1e-3 * normals) == pytest.approx(1e-3, abs=1e-9)


def test_larger_faces_get_more_points():
    points, normals = surface_samples(ObjectSpec("box", tuple(BOX), 0.1), 4000, np.random.default_rng(0))
    on_x = np.abs(normals[:, 0]) == 1
    # Half areas 3 x 4, 2 x 4 and 2 x 3: the x faces have 12 / 26 of the surface (sigma 0.8 %).
    assert on_x.mean() == pytest.approx(12 / 26, abs=0.03)
    # A pad needs room: no centre within 4 mm of an edge.
    assert np.abs(points[on_x, 1]).max() <= 0.026


def test_the_same_state_draws_the_same_points():
    first, second = (
        surface_samples(ObjectSpec("capsule", (0.02, 0.03), 0.1), 50, np.random.default_rng(5)) for _ in "ab"
    )
    assert np.array_equal(first, second)
