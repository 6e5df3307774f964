"""Draw points and normals on the surface of programmatic objects."""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.objects import ObjectSpec, Part

Array = NDArray[np.float64]
_EDGE_MARGIN = 0.004
"""Room around a point for a pad to lie flat [m]."""
_MAX_ROUNDS = 100


def surface_samples(object_spec: ObjectSpec, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw points on the surface, uniform in area, 4 mm away from edges and corners (less on small parts).

    Args:
        object_spec: The object.
        n: Number of points.
        rng: Source of randomness.

    Returns:
        Points [m] and outward unit normals in the body frame, each of shape (n, 3).

    Raises:
        DexFlexError: If the parts of a tool are so alike in size and place that no free surface is found.
    """
    parts = object_spec.parts
    areas = np.array([_area(part) for part in parts])
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    for _ in range(_MAX_ROUNDS):
        counts = rng.multinomial(n, areas / areas.sum())
        for k, (part, count) in enumerate(zip(parts, counts, strict=True)):
            local, normal = _sample_part(part, int(count), rng)
            local = local + part.position
            buried = np.zeros(len(local), bool)
            for other in parts[:k] + parts[k + 1 :]:
                buried |= _near(other, local)
            points, normals = np.vstack([points, local[~buried]]), np.vstack([normals, normal[~buried]])
        if len(points) >= n:
            break
    else:
        raise DexFlexError(f"No free surface found on {object_spec}; make head and handle differ more.")
    order = rng.permutation(len(points))[:n]
    return points[order], normals[order]


def _area(part: Part) -> float:
    if part.shape == "box":
        x, y, z = part.size
        return 8 * (x * y + y * z + x * z)
    radius, half = part.size
    caps = 2 if part.shape == "cylinder" else 4
    return np.pi * radius * (4 * half + caps * radius)


def _sample_part(part: Part, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    rows = np.arange(n)
    if part.shape == "box":
        half = np.array(part.size)
        faces = half.prod() / half
        axis = rng.choice(3, n, p=faces / faces.sum())
        sign = rng.choice([-1.0, 1.0], n)
        points = rng.uniform(-1, 1, (n, 3)) * np.maximum(half - _EDGE_MARGIN, 0.5 * half)
        normals = np.zeros((n, 3))
        normals[rows, axis] = sign
        points[rows, axis] = sign * half[axis]
        return points, normals
    radius, half = part.size
    angle = rng.uniform(-np.pi, np.pi, n)
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], -1)
    height = rng.uniform(-1, 1, n)[:, None] * [0, 0, 1]
    end = np.where(rng.random(n) < 0.5, -1.0, 1.0)[:, None] * [0, 0, 1]
    if part.shape == "cylinder":
        on_cap = rng.random(n) < radius / (radius + 2 * half)
        side = around * radius + height * max(half - _EDGE_MARGIN, 0.5 * half)
        cap = (
            around * (max(radius - _EDGE_MARGIN, 0.5 * radius) * np.sqrt(rng.random(n)))[:, None] + end * half
        )
        cap_normals = end
    else:
        on_cap = rng.random(n) < radius / (radius + half)
        side = around * radius + height * half
        direction = rng.normal(size=(n, 3))
        cap_normals = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        cap = cap_normals * radius + np.sign(cap_normals[:, 2:]) * half * [0, 0, 1]
    chosen = on_cap[:, None]
    return np.where(chosen, cap, side), np.where(chosen, cap_normals, around)


def _near(part: Part, points: Array) -> NDArray[np.bool_]:
    """Say which points lie inside a part or within the margin of it (of a box grown by it)."""
    local = np.abs(points - part.position)
    if part.shape == "box":
        return np.all(local < np.add(part.size, _EDGE_MARGIN), axis=1)
    radius, half = part.size
    beyond = np.maximum(local[:, 2] - half, 0)
    radial = np.linalg.norm(local[:, :2], axis=1)
    if part.shape == "cylinder":
        return (radial < radius + _EDGE_MARGIN) & (beyond < _EDGE_MARGIN)
    return np.hypot(radial, beyond) < radius + _EDGE_MARGIN
