"""Spread a wrench over contacts fast enough for every control step of an operator."""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.compiled import compiled
from lerobot_dexflex.hand import contacts

Array = NDArray[np.float64]

_TORQUE_SCALE, _PRELOAD_WEIGHT = contacts.TORQUE_SCALE, contacts.PRELOAD_WEIGHT
_SWEEPS = 60


@compiled
def balance_forces(
    points: Array,
    inward: Array,
    centre: Array,
    wrench: Array,
    friction: float,
    preload: float,
    least: float = 0.0,
) -> tuple[Array, float]:
    """Distribute a wrench over contacts as `hand.contacts.balance_forces`, by coordinate descent.

    Sixty sweeps do not go to the end: forces are up to 0.3 N from the optimum, where several serve alike.
    `least` is the smallest normal force of every contact [N]: a finger that hardly presses is lost when
    anything moves. Plain loops, so that no BLAS chooses an order of summation.
    """
    n = 4 * len(points)
    system, target = np.empty((6, n)), wrench.copy()
    target[3:] *= _TORQUE_SCALE
    for j in range(n):
        normal, arm = inward[j // 4], points[j // 4] - centre
        tangent = _cross(normal, np.array([1.0, 0.0, 0.0] if abs(normal[0]) < 0.7 else [0.0, 1.0, 0.0]))
        tangent /= np.sqrt(_dot(tangent, tangent))
        if j % 4 > 1:
            tangent = _cross(normal, tangent)
        system[:3, j] = normal + (friction if j % 2 == 0 else -friction) * tangent
        system[3:, j] = _TORQUE_SCALE * _cross(arm, system[:3, j])
    gram, pull, weights = np.empty((n, n)), np.empty(n), np.full(n, preload / 4)
    for i in range(n):
        pull[i] = _dot(system[:, i], target) + _PRELOAD_WEIGHT**2 * preload / 4
        for j in range(n):
            gram[i, j] = _dot(system[:, i], system[:, j]) + (_PRELOAD_WEIGHT**2 if i == j else 0.0)
    for _ in range(_SWEEPS):
        for j in range(n):
            weights[j] = max(least / 4, weights[j] + (pull[j] - _dot(gram[j], weights)) / gram[j, j])
    forces, missed = np.zeros((n // 4, 3)), -target
    for j in range(n):
        forces[j // 4] += weights[j] * system[:3, j]
        missed += weights[j] * system[:, j]
    return forces, float(np.sqrt(_dot(missed, missed)))


@compiled
def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@compiled
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total
