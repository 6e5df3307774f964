"""Grip: contact forces become joint leads; a small servo makes up for what touch does not feel of them."""

from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.kinematics import contact_torques, pad_rotations, pads
from lerobot_dexflex.hands import Hand

RECENT = 3
"""A finger that carried load so many control steps ago is still taken to hold."""


@dataclass(frozen=True)
class ServoSettings:
    """Gains and limits of the touch servo.

    Raises:
        DexFlexError: If one is negative or no number.
    """

    gain: float = 1e-4
    """Inward displacement per missing newton and control step [m/N]."""
    back: float = 5e-4
    """Inward displacement per control step of a finger that lost its load a moment ago [m]."""
    release: float = 1e-3
    """How fast the displacement goes back once a finger is not to press [m] per control step."""
    limit: float = 0.02
    """Largest displacement [m]."""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if not value >= 0:
                raise DexFlexError(f"The servo's `{each.name}` must be 0 or more. Got {value}.")


NO_SERVO = ServoSettings(gain=0.0, back=0.0)
"""Forces are fed forward alone: with the operator's true forces the servo costs progress (`eval/LOG.md`)."""


class Exertion(NamedTuple):
    """How a grip is realised."""

    torques: Tensor
    """Joint torques [N m]. Shape (batch, joints)."""
    push: Tensor
    """Displacement of the fingertips along the pads' normals [m]. Shape (batch, fingers, 3)."""


class Grip:
    """Realise contact forces at the pads as torques (J^T f), with a bounded integral of the felt error.

    The forces are those of the fingers on the object. Rows are never written in place.

    Args:
        hand: Whose grip.
        servo: Of the felt load.
    """

    def __init__(self, hand: Hand, servo: ServoSettings | None = None) -> None:
        self.hand = hand
        self.servo = servo or ServoSettings()
        self._offset: Tensor | None = None
        self._unloaded: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the rows in `mask`, shape (batch,) bool, or all."""
        if mask is None or self._offset is None or self._unloaded is None:
            self._offset = self._unloaded = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._offset.device)[:, None]
        self._offset = self._offset.masked_fill(mask, 0.0)
        self._unloaded = self._unloaded.masked_fill(mask, RECENT)

    def feel(self, loads: Tensor) -> Tensor:
        """Take in the loads of this step and return which fingers hold: now, or a moment ago.

        Args:
            loads: Normal force of each fingertip [N]; NaN where it is not known. Shape (batch, fingers).

        Returns:
            Shape (batch, fingers) bool.
        """
        if self._offset is None or self._unloaded is None:
            self._offset = torch.zeros_like(loads, dtype=torch.float64)
            self._unloaded = torch.full(loads.shape, RECENT, dtype=torch.int64, device=loads.device)
        self._unloaded = torch.where(loads > CONTACT_FORCE, 0, self._unloaded + 1)
        return self._unloaded < RECENT

    def exert(self, joints: Tensor, forces: Tensor, loads: Tensor, points: Tensor | None = None) -> Exertion:
        """Return torques and displacement for wanted forces; `feel` the loads before.

        Args:
            joints: Measured [rad], float64. Shape (batch, joints).
            forces: Wanted contact forces in the palm frame [N]; zero for fingers that are not to press.
                Shape (batch, fingers, 3).
            loads: As for `feel`; a finger that is not known is not servoed.
            points: Where they act [m], (batch, fingers, 3); the pads' centres if None.
        """
        assert self._offset is not None
        assert self._unloaded is not None
        servo, forces = self.servo, forces.double()
        centres, inward = pads(self.hand, joints)
        wanted = forces.norm(dim=-1)
        pressing = wanted > CONTACT_FORCE
        touching = self._unloaded == 0
        error = servo.gain * (wanted - loads.double().nan_to_num())
        step = torch.where(touching, error, servo.back)
        step = torch.where(pressing & loads.isfinite(), step, -servo.release)
        self._offset = (self._offset + step).clamp(0.0, servo.limit)
        torques = contact_torques(self.hand, joints, centres if points is None else points, forces)
        return Exertion(torques, self._offset[..., None] * inward)


def centres_of_pressure(hand: Hand, joints: Tensor, tactile: Tensor) -> Tensor:
    """Return where fingertips are pressed, the pads' centres where they are not [m].

    Args:
        hand: Whose fingertips.
        joints: Measured [rad], float64. Shape (batch, joints).
        tactile: Taxels [N]; NaN where they are not known. Shape (batch, fingers x taxels).

    Returns:
        Shape (batch, fingers, 3).
    """
    taxels = tactile.double().nan_to_num().clamp(min=0).reshape(-1, hand.n_fingers, *hand.taxels)
    along, across = (
        pitch * (torch.arange(count, device=taxels.device) - (count - 1) / 2)
        for pitch, count in zip(hand.taxel_pitch, hand.taxels, strict=True)
    )
    total = taxels.sum((-1, -2)).clamp(min=CONTACT_FORCE)
    offset = torch.stack(
        [(taxels.sum(-1) * along).sum(-1) / total, (taxels.sum(-2) * across).sum(-1) / total], -1
    )
    rotation, centres = pad_rotations(hand, joints), pads(hand, joints)[0]
    return centres + offset[..., :1] * rotation[..., 0] + offset[..., 1:] * rotation[..., 1]


def loads_of(hand: Hand, tactile: Tensor) -> Tensor:
    """Return the normal force of each fingertip [N], (batch, fingers), of taxels (batch, fingers x taxels).

    They may be any shape (batch, ...) of that size. It is NaN where a taxel reports no finite number.
    """
    loads = tactile.reshape(len(tactile), hand.n_fingers, -1).sum(-1)
    return loads.masked_fill(~loads.isfinite(), torch.nan)
