"""Can the fingers meet, and does the inverse kinematics follow them wherever they can go?"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand_check.bench import random_postures
from lerobot_dexflex.hand_check.finding import Finding
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

_MEET, _NEAR = 0.005, 0.03
_FACING = 0.3
_POSTURES, _REFINED, _ITERATIONS = 4000, 8, 12
_PATHS, _STEPS, _SHARE = 300, 20, 0.5
_MEDIAN, _P95 = 0.001, 0.005


def check_opposition(hand: Hand) -> Finding:
    """Check that the pads of opposing and opposed fingers can meet, face to face."""
    distance = {
        (thumb, finger): _closest(hand, thumb, finger)
        for thumb in hand.opposing_fingers
        for finger in hand.opposed_fingers
    }
    best = {k: min(value for pair, value in distance.items() if k in pair) for k in range(hand.n_fingers)}
    told = ", ".join(f"{name} {1000 * best[k]:.0f}" for k, name in enumerate(hand.finger_names))
    meets = all(best[thumb] <= _MEET for thumb in hand.opposing_fingers)
    return Finding(
        "opposition",
        meets and all(value <= _NEAR for value in best.values()),
        f"pads come this near to one of the other side: {told} mm",
        f"opposing fingers {1000 * _MEET:.0f} mm or less, the others {1000 * _NEAR:.0f} mm or less",
        "Look at the picture: are limits, axes and the place of the thumb right, and is `opposing` the "
        "finger that the others close against?",
    )


def _closest(hand: Hand, first: int, second: int) -> float:
    """Return the least distance [m] found between facing pads: of random postures the best, refined."""
    postures = random_postures(hand, _POSTURES)
    centres, outward = kernels.pads(hand.tables, postures)
    apart, partner = map(np.asarray, KDTree(centres[:, second]).query(centres[:, first]))
    facing = (outward[:, first] * outward[partner, second]).sum(1) < -_FACING
    best = np.argsort(np.where(facing, apart, np.inf))[:_REFINED]
    joints, own = postures[best].copy(), hand.finger_joints[second]
    joints[:, own] = postures[partner[best]][:, own]
    points, normals = np.zeros((2, _REFINED, hand.n_fingers, 3))
    points[:] = ((centres[best, first] + centres[partner[best], second]) / 2)[:, None]
    normals[:, first] = outward[partner[best], second] - outward[best, first]
    normals[:, first] /= np.linalg.norm(normals[:, first], axis=1, keepdims=True)
    normals[:, second] = -normals[:, first]
    joints = kernels.solve_pads(hand.tables, points, normals, joints, _ITERATIONS)
    centres, outward = kernels.pads(hand.tables, joints)
    met = np.linalg.norm(centres[:, first] - centres[:, second], axis=1)
    facing = (outward[:, first] * outward[:, second]).sum(1) < -_FACING
    return float(met[facing].min(initial=apart[best[0]]))


def check_inverse(hand: Hand) -> Finding:
    """Check that fingertips follow targets half-way from the nominal to random postures, within a second."""
    start, ends = np.array(hand.nominal_joints), random_postures(hand, _PATHS)
    command = np.broadcast_to(start, ends.shape).copy()
    missed = []
    for share in np.linspace(0, _SHARE, _STEPS + 1)[1:]:
        targets = kernels.fingertips(hand.tables, start + share * (ends - start))
        command = kernels.solve_fingertips(hand.tables, targets, command, kernels.POSTURE_WEIGHT, 3)
        reached = kernels.fingertips(hand.tables, command)
        missed.append(np.linalg.norm(reached - targets, axis=-1))
    errors = np.array(missed)  # (steps, paths, fingers)
    median, p95 = np.median(errors), np.quantile(errors, 0.95, axis=(0, 1))
    worst = int(p95.argmax())
    return Finding(
        "inverse",
        bool(median <= _MEDIAN and p95[worst] <= _P95),
        f"fingertips miss targets by {1000 * median:.2f} mm in the median; 95 % of {hand.finger_names[worst]}"
        f"'s by less than {1000 * p95[worst]:.1f} mm",
        f"median {1000 * _MEDIAN:g} mm, 95 % {1000 * _P95:g} mm or less",
        "A finger needs three joints or more whose axes differ; see `axis`, `quaternion` and limits of its "
        "links.",
    )
