"""Map hand joints to fingertips and back, batched in torch, straight from the hand's tables.

Every expert, interface and policy moves the hand through `solve_fingertips`, so that executing recorded
fingertip targets reproduces the recorded joint targets. All points live in the palm frame.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.hand import leap

POSTURE_WEIGHT = 0.02
"""Weight of the tie to the previous joint command [m/rad]: a fingertip leaves one joint per finger free."""
DAMPING, MAX_JOINT_STEP = 0.01, 0.5
"""Of the damped least squares: damping [m/rad] and the largest step [rad]."""
_LINKS_PER_FINGER = 4

JOINT_LOWER = torch.tensor([link.joint_range[0] for link in leap.LINKS], dtype=torch.float64)
JOINT_UPPER = torch.tensor([link.joint_range[1] for link in leap.LINKS], dtype=torch.float64)


class FingerFrames(NamedTuple):
    """Frames along the four fingers, in the palm frame."""

    origins: Tensor
    """Joint origins [m]. Shape (batch, fingers, 4, 3)."""
    axes: Tensor
    """Unit joint axes. Shape (batch, fingers, 4, 3)."""
    distal_rotation: Tensor
    """Orientation of the distal links. Shape (batch, fingers, 3, 3)."""

    def points(self, local: Tensor) -> Tensor:
        """Return points given in the distal frames [m], shape (fingers, 3), as (batch, fingers, 3)."""
        return self.origins[:, :, -1] + torch.einsum("bfij,fj->bfi", self.distal_rotation, local)

    def pads(self) -> tuple[Tensor, Tensor]:
        """Return the pad centres [m] and outward pad normals, each (batch, fingers, 3)."""
        return self.points(_PAD.to(self.origins)), -self.distal_rotation[..., 0]


def finger_frames(hand_joints: Tensor) -> FingerFrames:
    """Run forward kinematics of all fingers.

    Args:
        hand_joints: Joint positions [rad]. Shape (batch, 16).
    """
    angles = hand_joints.reshape(-1, len(leap.FINGERS), _LINKS_PER_FINGER)
    positions, rotations = _LINK_POSITION.to(hand_joints), LINK_ROTATION.to(hand_joints)
    cos, sin = torch.cos(angles), torch.sin(angles)
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    # Every LEAP joint turns about -z of its own link.
    turn = torch.stack([cos, sin, zero, -sin, cos, zero, zero, zero, one], -1).unflatten(-1, (3, 3))
    local = rotations @ turn  # (batch, fingers, links, 3, 3)
    origin = positions[:, 0].expand(len(angles), -1, -1)
    rotation = local[:, :, 0]
    origins, axes = [origin], [-rotation[..., 2]]
    for k in range(1, _LINKS_PER_FINGER):
        origin = origin + torch.einsum("bfij,fj->bfi", rotation, positions[:, k])
        rotation = rotation @ local[:, :, k]
        origins.append(origin)
        axes.append(-rotation[..., 2])
    return FingerFrames(torch.stack(origins, 2), torch.stack(axes, 2), rotation)


def fingertips(hand_joints: Tensor) -> Tensor:
    """Return the fingertip points [m] in the palm frame, shape (batch, 4, 3), of joints (batch, 16) [rad]."""
    return finger_frames(hand_joints).points(_TIP.to(hand_joints))


def pads(hand_joints: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pad centres [m] and outward pad normals in the palm frame, each (batch, 4, 3)."""
    return finger_frames(hand_joints).pads()


def solve_fingertips(
    targets: Tensor,
    previous: Tensor,
    posture_weight: float = POSTURE_WEIGHT,
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
    lower, upper = (limit.to(previous).view(4, 4) for limit in (JOINT_LOWER, JOINT_UPPER))
    tip = _TIP.to(previous)
    eye = torch.eye(4, dtype=previous.dtype, device=previous.device)
    posture = previous.reshape(-1, 4, 4)
    joints = posture
    for _ in range(iterations):
        frames = finger_frames(joints.flatten(1))
        points = frames.points(tip)
        error = targets - points  # (batch, fingers, 3)
        arms = points.unsqueeze(2) - frames.origins
        jacobian = torch.linalg.cross(frames.axes, arms).transpose(-1, -2)  # (batch, fingers, 3, 4)
        damping = DAMPING**2 * (0.01 + error.square().sum(-1)) + posture_weight**2
        normal = jacobian.mT @ jacobian + damping[..., None, None] * eye
        gradient = torch.einsum("bfij,bfi->bfj", jacobian, error) + posture_weight**2 * (posture - joints)
        step = torch.linalg.solve(normal, gradient)
        largest = step.abs().amax(-1, keepdim=True).clamp(min=MAX_JOINT_STEP)
        joints = torch.clamp(joints + step * (MAX_JOINT_STEP / largest), lower, upper)
    return joints.flatten(1)


def _rotation(quaternion: leap.Quaternion) -> Tensor:
    w, x, y, z = torch.nn.functional.normalize(torch.tensor(quaternion, dtype=torch.float64), dim=0)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def _per_finger(vectors: dict[str, leap.Vector3]) -> Tensor:
    return torch.tensor([vectors[f] for f in leap.FINGERS], dtype=torch.float64)


_LINK_POSITION = torch.tensor([k.position for k in leap.LINKS], dtype=torch.float64).view(4, 4, 3)
LINK_ROTATION = torch.stack([_rotation(k.quaternion) for k in leap.LINKS]).view(4, 4, 3, 3)
_TIP = _per_finger(leap.TIP_POSITION)
_PAD = _per_finger(leap.PAD_POSITION)
