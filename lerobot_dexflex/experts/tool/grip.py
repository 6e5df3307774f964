"""Where the fingers go on a handle: pads flat on both sides of it, solved for the pose in which it lies."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.contacts import solve_pads
from lerobot_dexflex.hands import LEAP

Array = NDArray[np.float64]


class Handle(NamedTuple):
    """A bar in the palm frame."""

    centre: Array
    """A point on its axis [m]. Shape (3,)."""
    axis: Array
    """Unit vector along it. Shape (3,)."""
    radius: float
    """Half of its width where the pads are [m]."""


class Grip(NamedTuple):
    """A way to hold a handle; palm frame."""

    open: Array
    """Joints around the handle, not touching it [rad]. Shape (16,)."""
    touch: Array
    """Joints with the pads on it [rad]. Shape (16,)."""
    inward: Array
    """Unit normals into the handle; zero for fingers that take no part. Shape (4, 3)."""


def grip_handle(
    handle: Handle,
    along: Array,
    toward: Array,
    fingers: tuple[int, ...],
    seed: Array,
    idle: Array,
    room: float = 0.016,
    around: Array | None = None,
    beside: Array | None = None,
) -> Grip:
    """Lay the pads of fingers and thumb on opposite sides of a handle.

    Args:
        handle: The bar.
        along: How far along the handle each finger is, from its centre [m]. Shape (4,).
        toward: The direction in which the fingers push; the thumb pushes against it. Shape (3,).
        fingers: Which fingers take part, as indices into `FINGERS`; the thumb is 3.
        seed: Posture from which the joints are solved [rad]. Shape (16,).
        idle: Posture of the fingers that take no part [rad]. Shape (16,).
        room: How far from the handle the pads are while open [m].
        around: By how much the push of each finger is turned about the handle [rad]. Shape (4,).
        beside: How far the middle of each pad is off where it touches, sideways [m]. Shape (4,).
    """
    push = toward - (toward @ handle.axis) * handle.axis
    push /= np.linalg.norm(push)
    turned = np.outer(np.zeros(4) if around is None else around, handle.axis)
    inward = np.array([rotation_matrix(turn) @ push for turn in turned]) * np.array([1, 1, 1, -1])[:, None]
    surface = handle.centre + np.outer(along, handle.axis) - handle.radius * inward
    if beside is not None:
        surface += np.array(beside)[:, None] * np.cross(handle.axis, inward)
    solved = solve_pads(
        LEAP,
        torch.from_numpy(np.stack([surface, surface - room * inward])),
        torch.from_numpy(np.stack([-inward] * 2)),
        torch.from_numpy(np.stack([seed] * 2)),
        iterations=20,
    )
    used = np.isin(np.arange(LEAP.n_fingers), fingers)
    joints = np.where(used[LEAP.finger_of_joint], solved.joints.numpy(), idle)
    return Grip(joints[1], joints[0], inward * used[:, None])
