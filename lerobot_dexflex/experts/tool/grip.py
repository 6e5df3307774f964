"""Where the fingers go on a handle: pads flat on both sides of it, solved for the pose in which it lies."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.contacts import solve_pads
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]


class Handle(NamedTuple):
    """A bar in the working frame; see `holds`."""

    centre: Array
    """A point on its axis [m]. Shape (3,)."""
    axis: Array
    """Unit vector along it. Shape (3,)."""
    radius: float
    """Half of its width where the pads are [m]."""


class Grip(NamedTuple):
    """A way to hold a handle."""

    open: Array
    """Joints around the handle, not touching it [rad]. Shape (joints,)."""
    touch: Array
    """Joints with the pads on it [rad]. Shape (joints,)."""
    inward: Array
    """Unit normals into the handle, palm frame; zero for fingers that take no part. Shape (fingers, 3)."""


def grip_handle(
    hand: Hand,
    frame: Array,
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
    """Lay the pads of fingers that oppose and of others on opposite sides of a handle.

    Args:
        hand: Whose fingers.
        frame: Axes of the working frame in the palm frame. Shape (3, 3).
        handle: The bar.
        along: How far along the handle each finger is, from its centre [m]. Shape (fingers,).
        toward: Direction in which the fingers push; those that oppose push against it. Shape (3,).
        fingers: Which fingers take part, as indices into `Hand.fingers`.
        seed: Posture from which the joints are solved [rad]. Shape (joints,).
        idle: Posture of the fingers that take no part [rad]. Shape (joints,).
        room: How far from the handle the pads are while open [m].
        around: By how much the push of each finger is turned about the handle [rad]. Shape (fingers,).
        beside: How far the middle of each pad is off where it touches, sideways [m]. Shape (fingers,).
    """
    surface, inward = pad_places(hand, frame, handle, along, toward, around, beside)
    solved = solve_pads(
        hand,
        torch.from_numpy(np.stack([surface, surface - room * inward])),
        torch.from_numpy(np.stack([-inward] * 2)),
        torch.from_numpy(np.stack([seed] * 2)),
        iterations=20,
    )
    used = np.isin(np.arange(hand.n_fingers), fingers)
    joints = np.where(used[hand.finger_of_joint], solved.joints.numpy(), idle)
    return Grip(joints[1], joints[0], inward * used[:, None])


def pad_places(
    hand: Hand,
    frame: Array,
    handle: Handle,
    along: Array,
    toward: Array,
    around: Array | None = None,
    beside: Array | None = None,
) -> tuple[Array, Array]:
    """Return where pads are on a handle [m] and unit normals into it, palm frame, each (fingers, 3).

    The arguments are those of `grip_handle`.
    """
    push = toward - (toward @ handle.axis) * handle.axis
    push /= np.linalg.norm(push)
    turned = np.outer(np.zeros(hand.n_fingers) if around is None else around, handle.axis)
    inward = np.array([rotation_matrix(turn) @ push for turn in turned])
    inward[list(hand.opposing_fingers)] *= -1
    surface = handle.centre + np.outer(along, handle.axis) - handle.radius * inward
    if beside is not None:
        surface += np.array(beside)[:, None] * np.cross(handle.axis, inward)
    return surface @ frame.T, inward @ frame.T


def all_fingers(hand: Hand) -> tuple[int, ...]:
    """Return all fingers, as indices into `Hand.fingers`."""
    return tuple(range(hand.n_fingers))


def without(hand: Hand, place: int) -> tuple[int, ...]:
    """Return all fingers but one of those that do not oppose, by its place among them, -1 the last."""
    return tuple(k for k in range(hand.n_fingers) if k != hand.opposed_fingers[place])
