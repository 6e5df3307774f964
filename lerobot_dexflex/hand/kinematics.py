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
from lerobot_dexflex.hands import Hand


class FingerFrames(NamedTuple):
    """Frames along the fingers, in the palm frame.

    Fingers may differ in their number of joints: rows beyond a finger's own are zero.
    """

    origins: Tensor
    """Joint origins [m]. Shape (batch, fingers, joints of the longest finger, 3)."""
    axes: Tensor
    """Unit joint axes. Shape (batch, fingers, joints of the longest finger, 3)."""
    distal_rotation: Tensor
    """Orientation of the distal links. Shape (batch, fingers, 3, 3)."""


def joint_limits(hand: Hand) -> tuple[Tensor, Tensor]:
    """Return the lower and upper joint limits [rad], float64, each of shape (joints,)."""
    return torch.tensor(hand.joint_lower), torch.tensor(hand.joint_upper)


def finger_frames(hand: Hand, hand_joints: Tensor) -> FingerFrames:
    """Run forward kinematics of all fingers.

    Args:
        hand: Whose fingers.
        hand_joints: Joint positions [rad]. Shape (batch, joints).
    """
    found = kernels.frames(hand.tables, as_array(hand_joints, (-1, hand.n_joints)))
    return FingerFrames(*[torch.from_numpy(part).to(hand_joints) for part in found])


def fingertips(hand: Hand, hand_joints: Tensor) -> Tensor:
    """Return the fingertips [m] in the palm frame, (batch, fingers, 3), of joints (batch, joints) [rad]."""
    tips = kernels.fingertips(hand.tables, as_array(hand_joints, (-1, hand.n_joints)))
    return torch.from_numpy(tips).to(hand_joints)


def pads(hand: Hand, hand_joints: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pad centres [m] and outward pad normals in the palm frame, each (batch, fingers, 3)."""
    centres, normals = kernels.pads(hand.tables, as_array(hand_joints, (-1, hand.n_joints)))
    return torch.from_numpy(centres).to(hand_joints), torch.from_numpy(normals).to(hand_joints)


def pad_rotations(hand: Hand, hand_joints: Tensor) -> Tensor:
    """Return the orientation of the pads in the palm frame, as columns along, across and outward.

    Shape (batch, fingers, 3, 3), of joints (batch, joints) [rad].
    """
    return finger_frames(hand, hand_joints).distal_rotation @ torch.tensor(hand.pad_rotations).to(hand_joints)


def solve_fingertips(
    hand: Hand,
    targets: Tensor,
    previous: Tensor,
    posture_weight: float = kernels.POSTURE_WEIGHT,
    iterations: int = 3,
) -> Tensor:
    """Find hand joints that reach fingertip targets: damped least squares, one finger at a time.

    The posture is tied to `previous` because four or five joints serve a three-dimensional point; a weak tie
    lets what is free wander under noise. Damping grows with the remaining error, so far targets stay tame.

    Args:
        hand: Whose fingers.
        targets: Fingertip targets in the palm frame [m]. Shape (batch, fingers, 3).
        previous: Previous joint command, seed and posture [rad]. Shape (batch, joints).
        posture_weight: Weight of the posture tie [m/rad].
        iterations: Gauss-Newton steps.

    Returns:
        Joint targets within the limits [rad]. Shape (batch, joints).
    """
    wanted, seeds = as_array(targets, (-1, hand.n_fingers, 3)), as_array(previous, (-1, hand.n_joints))
    solved = kernels.solve_fingertips(hand.tables, wanted, seeds, float(posture_weight), int(iterations))
    return torch.from_numpy(solved).to(previous)


def contact_torques(hand: Hand, hand_joints: Tensor, points: Tensor, forces: Tensor) -> Tensor:
    """Return the joint torques [N m], shape (batch, joints), with which the fingertips exert forces.

    Args:
        hand: Whose fingers.
        hand_joints: Joint positions [rad]. Shape (batch, joints).
        points: Contact points on the distal links, palm frame [m]. Shape (batch, fingers, 3).
        forces: Forces of the fingers on what they touch, palm frame [N]. Shape (batch, fingers, 3).
    """
    shape = (-1, hand.n_fingers, 3)
    joints = as_array(hand_joints, (-1, hand.n_joints))
    torques = kernels.contact_torques(hand.tables, joints, as_array(points, shape), as_array(forces, shape))
    return torch.from_numpy(torques).to(hand_joints)


def leads(hand: Hand, torques: Tensor) -> Tensor:
    """Return by how much joint targets must lead the joints for a grip [rad]. Shape (batch, joints).

    Args:
        hand: Whose motors.
        torques: Joint torques of the grip [N m], of which a motor gives its largest. Shape (batch, joints).
    """
    largest, gains = (torch.tensor(part).to(torques) for part in (hand.grip_torques, hand.position_gains))
    return torques.clamp(-largest, largest) / gains


def as_array(tensor: Tensor, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return a tensor as the kernels want it: float64 and C-contiguous, reshaped."""
    return tensor.detach().to("cpu", torch.float64).reshape(shape).contiguous().numpy()
