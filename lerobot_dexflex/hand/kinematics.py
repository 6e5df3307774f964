"""Map hand joints to fingertips and back: batches of tensors around the compiled `hand.kernels`.

Every expert, interface and policy moves the hand through `solve_fingertips`, so that executing recorded
fingertip targets reproduces the recorded joint targets, whatever else is in the batch. All points live in the
palm frame. Everything is computed in float64 on the CPU and returned with the type and on the device of the
joints that came in; no gradient passes.
"""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.hand import kernels

JOINT_LOWER, JOINT_UPPER = (torch.from_numpy(limit.flatten()) for limit in (kernels.LOWER, kernels.UPPER))
"""Joint limits [rad], float64. Shape (16,)."""


class FingerFrames(NamedTuple):
    """Frames along the four fingers, in the palm frame."""

    origins: Tensor
    """Joint origins [m]. Shape (batch, fingers, 4, 3)."""
    axes: Tensor
    """Unit joint axes. Shape (batch, fingers, 4, 3)."""
    distal_rotation: Tensor
    """Orientation of the distal links. Shape (batch, fingers, 3, 3)."""


def finger_frames(hand_joints: Tensor) -> FingerFrames:
    """Run forward kinematics of all fingers.

    Args:
        hand_joints: Joint positions [rad]. Shape (batch, 16).
    """
    found = kernels.frames(as_array(hand_joints, (-1, 16)))
    return FingerFrames(*[torch.from_numpy(part).to(hand_joints) for part in found])


def fingertips(hand_joints: Tensor) -> Tensor:
    """Return the fingertip points [m] in the palm frame, shape (batch, 4, 3), of joints (batch, 16) [rad]."""
    return torch.from_numpy(kernels.fingertips(as_array(hand_joints, (-1, 16)))).to(hand_joints)


def pads(hand_joints: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pad centres [m] and outward pad normals in the palm frame, each (batch, 4, 3)."""
    centres, normals = kernels.pads(as_array(hand_joints, (-1, 16)))
    return torch.from_numpy(centres).to(hand_joints), torch.from_numpy(normals).to(hand_joints)


def solve_fingertips(
    targets: Tensor,
    previous: Tensor,
    posture_weight: float = kernels.POSTURE_WEIGHT,
    iterations: int = 3,
) -> Tensor:
    """Find hand joints that reach fingertip targets: damped least squares, one finger at a time.

    The posture is tied to `previous` because four joints serve a three-dimensional point; a weak tie lets
    that free joint wander under noise. Damping grows with the remaining error, so far targets stay tame.

    Args:
        targets: Fingertip targets in the palm frame [m]. Shape (batch, 4, 3).
        previous: Previous joint command, seed and posture [rad]. Shape (batch, 16).
        posture_weight: Weight of the posture tie [m/rad].
        iterations: Gauss-Newton steps.

    Returns:
        Joint targets within the limits [rad]. Shape (batch, 16).
    """
    wanted, seeds = as_array(targets, (-1, 4, 3)), as_array(previous, (-1, 16))
    solved = kernels.solve_fingertips(wanted, seeds, float(posture_weight), int(iterations))
    return torch.from_numpy(solved).to(previous)


def contact_torques(hand_joints: Tensor, points: Tensor, forces: Tensor) -> Tensor:
    """Return the joint torques [N m], shape (batch, 16), with which the fingertips exert forces.

    Args:
        hand_joints: Joint positions [rad]. Shape (batch, 16).
        points: Contact points on the distal links, palm frame [m]. Shape (batch, 4, 3).
        forces: Forces of the fingers on what they touch, palm frame [N]. Shape (batch, 4, 3).
    """
    arrays = as_array(hand_joints, (-1, 16)), as_array(points, (-1, 4, 3)), as_array(forces, (-1, 4, 3))
    return torch.from_numpy(kernels.contact_torques(*arrays)).to(hand_joints)


def as_array(tensor: Tensor, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return a tensor as the kernels want it: float64 and C-contiguous, reshaped."""
    return tensor.detach().to("cpu", torch.float64).reshape(shape).contiguous().numpy()
