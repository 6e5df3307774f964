"""Do the pads of the nominal posture face each other, in order and around the region of objects?"""

from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hand import kernels, xarm7
from lerobot_dexflex.hand.arm import robot_model
from lerobot_dexflex.hand_check.bench import POSTURES
from lerobot_dexflex.hand_check.finding import Finding
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.hands.tables import rotation_of

Array = NDArray[np.float64]

_FACING = 0.5
_IN_ORDER = 0.012
_WIDTHS = (1.0, 3.0)
_OUTSIDE = 0.02
_BEYOND = 0.05


def check_facing(hand: Hand) -> Finding:
    """Check that opposing and opposed pads look at each other in the nominal posture."""
    centres, outward = _nominal_pads(hand)
    opposed = list(hand.opposed_fingers)
    least, looks = 1.0, {}
    for thumb in hand.opposing_fingers:
        mean = outward[opposed].mean(0)
        least = min(least, -float(mean @ outward[thumb]) / max(float(np.linalg.norm(mean)), 1e-9))
        for finger in opposed:
            look = _unit(centres[thumb] - centres[finger]) @ outward[finger]
            looks[hand.finger_names[finger]] = float(look)
        looks[hand.finger_names[thumb]] = float(
            _unit(centres[opposed].mean(0) - centres[thumb]) @ outward[thumb]
        )
    away = min(looks, key=lambda name: looks[name])
    return Finding(
        "facing",
        least >= _FACING and looks[away] > 0.0,
        f"normals oppose by {least:.2f} (1: exactly); {away} looks at the other side by {looks[away]:.2f}",
        f"normals that oppose by {_FACING} or more; every pad looks at the other side by more than 0",
        "Choose `nominal_joints` such that the pads face each other; if they face away, `pad_quaternion` or "
        "the axes have the wrong sign. `opposing` must name the thumb.",
    )


def check_order(hand: Hand) -> Finding:
    """Check that the opposed fingers stand along `finger_order`, and that pads get the room they need."""
    centres, _ = _nominal_pads(hand)
    along = centres[list(hand.opposed_fingers)] @ hand.finger_order
    gap = min((float(first - second) for first, second in pairwise(along)), default=np.inf)
    widths = [hand.pad_spacing / (2 * finger.pad_half_size[1]) for finger in hand.fingers]
    low, high = _WIDTHS
    return Finding(
        "order",
        gap >= _IN_ORDER and low <= min(widths) and max(widths) <= high,
        f"the opposed pads follow each other along `finger_order` by {1000 * gap:.0f} mm or more; "
        f"`pad_spacing` is {min(widths):.2f} to {max(widths):.2f} pads wide",
        f"{1000 * _IN_ORDER:.0f} mm or more; {low:g} to {high:g} pads wide",
        "List `fingers` in the order in which they stand, let `finger_order` point from the last to the "
        "first of the opposed ones, and give `pad_spacing` in m.",
    )


def check_region(hand: Hand) -> Finding:
    """Check that objects are looked for between the pads."""
    centres, _ = _nominal_pads(hand)
    sides = (hand.opposing_fingers, hand.opposed_fingers)
    middle = np.mean([centres[list(fingers)].mean(0) for fingers in sides], 0)
    lower, upper = np.array(hand.object_region)
    outside = float(np.linalg.norm(middle - np.clip(middle, lower, upper)))
    return Finding(
        "region",
        outside <= _OUTSIDE,
        f"the middle between the nominal pads, {tuple(middle.round(3).tolist())} m, is {1000 * outside:.0f} "
        "mm outside of `object_region`",
        f"{1000 * _OUTSIDE:.0f} mm or less",
        "Put `object_region` [m] around the middle between the pads, some 4 to 8 cm wide each way.",
    )


def check_mount(hand: Hand) -> Finding:
    """Check that the arm carries the hand such that it reaches ahead and its tips stay off the arm."""
    centres, _ = _nominal_pads(hand)
    beyond = (centres @ rotation_of(hand.mount_quaternion).T + hand.mount_position)[:, 2].min()
    model = robot_model(hand)
    data, touching = mujoco.MjData(model), set[str]()
    for posture in POSTURES:
        data.qpos[-hand.n_joints :] = getattr(hand, posture)
        mujoco.mj_fwdPosition(model, data)
        touching |= {model.body(model.geom_bodyid[g]).name for contact in data.contact for g in contact.geom}
    touching &= {link.name for link in xarm7.LINKS}
    return Finding(
        "mount",
        bool(beyond >= _BEYOND and not touching),
        f"nominal pads are {1000 * beyond:.0f} mm or more beyond the flange, along its axis"
        + (f"; tips touch {', '.join(sorted(touching))} of the arm" if touching else ""),
        f"{1000 * _BEYOND:.0f} mm or more, and off the arm",
        "`mount_position` [m] and `mount_quaternion` place the palm in the frame of the flange, whose z axis "
        "leads away from the arm: the fingers shall reach along it.",
    )


def _nominal_pads(hand: Hand) -> tuple[Array, Array]:
    centres, outward = kernels.pads(hand.tables, np.array(hand.nominal_joints)[None])
    return centres[0], outward[0]


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
