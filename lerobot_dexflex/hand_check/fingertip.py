"""Are tip, pad and taxels where the shapes of the fingertip are?"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hand_check.finding import Finding
from lerobot_dexflex.hands import Finger, Hand
from lerobot_dexflex.hands.body import Box, Shape
from lerobot_dexflex.hands.tables import rotation_of

Array = NDArray[np.float64]

_TIP_DEPTH, _PAD_OFF = (-0.003, 0.006), 0.002
_AHEAD = 0.5
_PROBE = 0.002
_LEAST_CHANGE = 0.5
_OVERHANG = 0.0005


def check_tips(hand: Hand) -> Finding:
    """Check that the fingertip point lies at the end of the tip, ahead of the pad."""
    depth = [-_distance(finger, np.array(finger.tip_position)) for finger in hand.fingers]
    ahead = [_in_pad(finger, finger.tip_position)[0] / finger.pad_half_size[0] for finger in hand.fingers]
    low, high = _TIP_DEPTH
    far, behind = int(np.argmax(np.abs(np.array(depth) - (low + high) / 2))), int(np.argmin(ahead))
    return Finding(
        "tips",
        low <= depth[far] <= high and ahead[behind] >= _AHEAD,
        f"{1000 * depth[far]:.1f} mm below the surface ({hand.finger_names[far]}); ahead of the pad's centre "
        f"by {ahead[behind]:.2f} of its half length ({hand.finger_names[behind]})",
        f"{1000 * low:.0f} to {1000 * high:.0f} mm below the surface of `tip` or `nose`; {_AHEAD} or more "
        "ahead",
        "Give `tip_position` in m in the frame of the distal link, and a `pad_quaternion` whose x points "
        "toward the tip.",
    )


def check_pads(hand: Hand) -> Finding:
    """Check that the pad lies on the surface of the tip and looks out of it."""
    off, change = [], []
    for finger in hand.fingers:
        centre, outward = np.array(finger.pad_position), rotation_of(finger.pad_quaternion)[:, 2]
        off.append(abs(_distance(finger, centre)))
        outside, inside = (_distance(finger, centre + side * _PROBE * outward) for side in (1, -1))
        change.append((outside - inside) / (2 * _PROBE))
    far, wrong = int(np.argmax(off)), int(np.argmin(change))
    return Finding(
        "pads",
        off[far] <= _PAD_OFF and change[wrong] >= _LEAST_CHANGE,
        f"{1000 * off[far]:.1f} mm from the surface ({hand.finger_names[far]}); the normal leads out of it "
        f"by {change[wrong]:.2f} of its length ({hand.finger_names[wrong]})",
        f"at most {1000 * _PAD_OFF:.0f} mm from the surface of `tip`; {_LEAST_CHANGE} or more outward",
        "Put `pad_position` on the contact face, and turn `pad_quaternion` such that z points out of it.",
    )


def check_taxels(hand: Hand) -> Finding:
    """Check that the grid of taxels fits on every pad and into the part whose forces it carries."""
    grid = np.array(hand.taxels) * hand.taxel_pitch / 2
    room = np.array([finger.pad_half_size for finger in hand.fingers])
    overhang = (grid - room).max(1)
    worst = int(overhang.argmax())
    corners = np.array(list(product((-grid[0], grid[0]), (-grid[1], grid[1]), (0.0,))))
    beyond = float((np.abs(corners - hand.palmar.position) - hand.palmar.half_size).max())
    return Finding(
        "taxels",
        bool(overhang[worst] <= _OVERHANG and beyond <= 0.0),
        f"{hand.taxels[0]} x {hand.taxels[1]} on {2000 * grid[0]:.1f} x {2000 * grid[1]:.1f} mm stand over "
        f"the pad of {hand.finger_names[worst]} by {1000 * overhang[worst]:.1f} mm and over `palmar` by "
        f"{1000 * beyond:.1f} mm",
        f"over a pad by {1000 * _OVERHANG} mm at most, over `palmar` by 0 (negative: there is room)",
        "Make `taxels` times `taxel_pitch` twice the smallest `pad_half_size` or less, all in m, and let "
        "`palmar` enclose the pad.",
    )


def _in_pad(finger: Finger, point: tuple[float, ...]) -> Array:
    return (np.array(point) - finger.pad_position) @ rotation_of(finger.pad_quaternion)


def _distance(finger: Finger, point: Array) -> float:
    """Return how far a point of the distal frame is outside of tip and nose [m]; negative inside."""
    return min(_shape_distance(shape, point) for shape in (finger.tip, finger.nose) if shape is not None)


def _shape_distance(shape: Shape, point: Array) -> float:
    local = point - shape.position
    if isinstance(shape, Box):
        beyond = np.abs(local) - shape.half_size
        return float(np.linalg.norm(np.maximum(beyond, 0.0)) + min(beyond.max(), 0.0))
    local = local @ rotation_of(shape.quaternion)
    local[2] -= np.clip(local[2], -shape.half_length, shape.half_length)
    return float(np.linalg.norm(local) - shape.radius)
