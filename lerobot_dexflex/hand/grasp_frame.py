"""The frame in which hands are alike: where they grasp, the way they reach, and the side they oppose from.

Cameras, start poses of the arm and poses of the operator's palm are written for one palm on one mount.
Through grasp frames they mean the same for any other hand.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.hands.tables import rotation_of

Array = NDArray[np.float64]


class GraspFrame(NamedTuple):
    """Where and how a hand grasps, in the frame of its palm or of the flange that carries it."""

    centre: Array
    """Middle of the region of graspable objects [m]. Shape (3,)."""
    axes: Array
    """As columns: toward the fingers that oppose, along the row of the others, the way that the hand reaches.
    Shape (3, 3)."""

    def moved(self, position: Array | Sequence[float], rotation: Array) -> "GraspFrame":
        """Return it in a frame in which its own frame has a position [m] (3,) and a rotation (3, 3)."""
        return GraspFrame(np.add(position, rotation @ self.centre), rotation @ self.axes)


_PALM = GraspFrame(np.mean([(-0.055, -0.06, -0.145), (0.01, 0.005, -0.085)], 0), np.diag([-1.0, 1.0, -1.0]))
_FLANGE = _PALM.moved((0.065, -0.04, 0.0), np.diag([1.0, -1.0, -1.0]))
"""The grasp frame of the hand that tasks and operators are written for, in its palm's and its flange's."""


@cache
def grasp_frame(hand: Hand) -> GraspFrame:
    """Return the grasp frame of a hand: it reaches along the axis of the flange that carries it."""
    reach = rotation_of(hand.mount_quaternion)[2]
    row = np.subtract(hand.finger_order, np.dot(hand.finger_order, reach) * reach)
    row /= np.linalg.norm(row)
    pads, _ = kernels.pads(hand.tables, np.array(hand.nominal_joints))
    opposing = pads[list(hand.opposing_fingers)].mean(0) - pads[list(hand.opposed_fingers)].mean(0)
    if np.cross(row, reach) @ opposing < 0:  # A left hand's row begins at the other end.
        row = -row
    axes = np.stack([np.cross(row, reach), row, reach], 1)
    return GraspFrame(np.mean(hand.object_region, 0), axes)


def palm_turn(hand: Hand) -> Array:
    """Return the rotation (3, 3) that takes directions written for the palm to those of a hand's palm."""
    return grasp_frame(hand).axes @ _PALM.axes.T


def palm_point(hand: Hand, point: Array | Sequence[float]) -> Array:
    """Return the point of a hand's palm frame [m] that means what `point` means where it is written. (3,)."""
    turn = palm_turn(hand)
    return turn @ np.asarray(point, float) + (grasp_frame(hand).centre - turn @ _PALM.centre)


def flange_change(hand: Hand) -> GraspFrame:
    """Return how the flange must move, in its frame, for a hand to grasp where it is written that it does.

    `centre` is by how much its grasp point is to move [m], `axes` by which rotation, about the flange's axis.
    """
    now = grasp_frame(hand).moved(hand.mount_position, rotation_of(hand.mount_quaternion))
    return GraspFrame(_FLANGE.centre - now.centre, _FLANGE.axes @ now.axes.T)
