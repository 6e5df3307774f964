"""Repair a command by what touch says of the grasp: a hand-written rule, for who commands into the object.

Fingers that carry the object move together: their common rigid motion passes, what they do against each
other is damped, and not passed at all where it would open a loose grasp. Everything goes slowly. A small
servo holds the squeeze but never loosens what the draft presses, and a finger that lost the object a moment
ago returns to it. Where there is no grasp to protect, because none has formed yet or the drafts ask to let go
for long enough, they pass as they are.

A draft that goes on after its first step is a plan: it knows what the fingers are to do against each other,
which then passes (`planned_gain`), and says beforehand when it lets go. One that only says where the fingers
should be, as a glove's, does not look ahead, and is trusted less.
"""

from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import Hand

WINDOW = 29
"""Control steps of loads that are looked at, this one included."""
PAST_DRAFTS = 8
"""Earlier drafts that are looked at."""
_RECENT, _SLOW = [0, 1, 3], slice(None, None, 4)
"""Steps back in which a load counts as recent, and those that tell whether a grasp has formed."""
_PAIR, _ENOUGH = 2, 3
"""Loaded fingers that make a grasp worth protecting; and that make its motion more than a guess."""
_LET_GO = 0.002
"""It lets go where recent drafts, or a plan, take a finger that opposes and two others outward, on average so
fast [m]."""
_PLAN = 1e-4
"""A plan goes on by more in one of its later steps [m]."""
_MAX_SQUEEZE, _MAX_RELIEF = 0.0015, 0.001
"""Largest displacement of the squeeze servo, inward and outward [m]."""
_REGULAR = (1e-9, 1e-6)
"""Regularisation of the fit, [1] for translation and, unless told, [m^2] for rotation."""


@dataclass(frozen=True)
class ProjectionSettings:
    """Gains and limits of the contact projection, found on training objects (log in `eval/LOG.md`).

    Raises:
        DexFlexError: If a value is negative or no number.
    """

    gain: float = 0.6
    """Share of the draft that loaded fingers execute."""
    free_gain: float = 0.3
    """Share of the draft that free fingers execute, and all while fewer than three carry load."""
    internal_gain: float = 0.2
    """Share of what loaded fingers do against each other, along their surfaces, that passes."""
    planned_gain: float = 1.0
    """The same where the draft is a plan. What a plan asks and does not get, it asks again in the next step:
    damping would only make it late."""
    closing_gain: float = 1.0
    """Share of what they do against each other, into the object, that passes."""
    opening_load: float = 1.0
    """Out of the object the same share passes, but only of a finger with more than this load [N]. If nothing
    passed, every inward error of a plan would stay in the grasp, until the fingers no longer are where it
    takes them to be."""
    speed: float = 1e-3
    """Largest displacement of a fingertip before the squeeze is added [m] per step."""
    squeeze_gain: float = 7e-5
    """Inward displacement per missing newton and step [m/N]."""
    preload: float = 4.0
    """Normal force that the squeeze servo aims at [N]. From 2 to 4 N Reach's light objects fare alike; tools
    need more."""
    return_speed: float = 1.2e-3
    """Inward displacement of a finger that lost the object up to 3 steps ago [m] per step."""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if not value >= 0:
                raise DexFlexError(f"`{each.name}` must be 0 or more. Got {value}.")


class Grasp(NamedTuple):
    """What is known of the hand and of what it holds, newest first."""

    joints: Tensor
    """Measured [rad]. Shape (batch, joints)."""
    tips: Tensor
    """Measured fingertips [m]. Shape (batch, fingers, 3)."""
    loads: Tensor
    """Normal force of each fingertip, now and in the steps before [N]. Shape (batch, WINDOW, fingers)."""
    missing: Tensor
    """Fingers whose touch is not known. Shape (batch, fingers), bool."""
    drafts: Tensor
    """First displacements of earlier drafts [m]. Shape (batch, PAST_DRAFTS, fingers, 3)."""


def project_draft(hand: Hand, asked: Tensor, grasp: Grasp, settings: ProjectionSettings) -> Tensor:
    """Return the first displacement of a draft as one that keeps loaded fingertips on the object.

    A finger whose touch is missing counts as free. Without any touch it cannot be known whether there is a
    grasp: only `free_gain` and `speed` act.

    Args:
        hand: The hand.
        asked: Displacements of the commanded fingertips over the next steps [m]. Shape
            (batch, horizon, fingers, 3).
        grasp: What is known.
        settings: Gains and limits.

    Returns:
        Displacement of the commanded fingertips [m]. Shape (batch, fingers, 3).
    """
    loads = grasp.loads.masked_fill(grasp.missing[:, None], 0.0)
    now, recent = loads[:, 0], (loads[:, _RECENT] > CONTACT_FORCE).any(1)  # (batch, fingers)
    loaded, first = now > CONTACT_FORCE, asked[:, 0]
    inward = pads(hand, grasp.joints)[1]
    planned = (asked[:, 1:].abs() > _PLAN).flatten(1).any(1)  # (batch,)

    moved = _together(first, grasp.tips, inward, now, planned, settings)
    held = loaded & (loaded.sum(1, keepdim=True) >= _ENOUGH)
    moved = torch.where(held[..., None], settings.gain * moved, settings.free_gain * first)
    moved = moved * (settings.speed / moved.norm(dim=-1, keepdim=True).clamp(min=1e-9)).clamp(max=1.0)
    squeeze = (settings.squeeze_gain * (settings.preload - now)).clamp(-_MAX_RELIEF, _MAX_SQUEEZE) * recent
    pressed = ((first - rigid_motion(first, grasp.tips, loaded.double())) * inward).sum(-1) > 0
    squeeze = torch.where(pressed, squeeze.clamp(min=0), squeeze)  # It never loosens what the draft presses.
    back = settings.return_speed * (~loaded & recent)
    moved = moved + (squeeze + back)[..., None] * inward

    formed = ((loads[:, _SLOW] > CONTACT_FORCE).sum(-1) >= _PAIR).any(1) & recent.any(1)
    leaving = _lets_go(hand, grasp.drafts, inward) | (planned & _lets_go(hand, asked, inward))
    protect = (formed & ~leaving) | grasp.missing.all(1)
    return torch.where(protect[:, None, None], moved, first)


def _together(
    first: Tensor,
    tips: Tensor,
    inward: Tensor,
    loads: Tensor,
    planned: Tensor,
    settings: ProjectionSettings,
) -> Tensor:
    """Return the common motion of the loaded tips, and what passes of that against each other."""
    rigid = rigid_motion(first, tips, (loads > CONTACT_FORCE).double())
    internal = first - rigid
    normal = (internal * inward).sum(-1, keepdim=True)
    gain = torch.where(planned, settings.planned_gain, settings.internal_gain)[:, None, None]
    opening = gain * normal.clamp(max=0) * (loads > settings.opening_load)[..., None]
    closing = settings.closing_gain * normal.clamp(min=0)
    return rigid + gain * (internal - normal * inward) + (opening + closing) * inward


def _lets_go(hand: Hand, displacements: Tensor, inward: Tensor) -> Tensor:
    """Return whether displacements (batch, steps, fingers, 3) open a grasp, see `_LET_GO`: (batch,)."""
    outward = -(displacements.mean(1) * inward).sum(-1) > _LET_GO  # (batch, fingers)
    return outward[:, list(hand.opposing_fingers)].any(1) & (outward.sum(1) >= _ENOUGH)


def rigid_motion(moves: Tensor, tips: Tensor, weights: Tensor, regular: float = _REGULAR[1]) -> Tensor:
    """Return the rigid motion of all tips that fits the weighted moves best, by least squares.

    Around the weighted centre translation and rotation come apart, and three unknowns are solved by Cramer's
    rule, element by element: no LAPACK chooses an order of summation by the size of the batch.

    Args:
        moves: Shape (batch, fingers, 3) [m].
        tips: Shape (batch, fingers, 3) [m].
        weights: Shape (batch, fingers).
        regular: How much rotation is held back [m^2].
    """
    share, total = weights[..., None], weights.sum(1)[:, None, None]
    arms = tips - (share * tips).sum(1, keepdim=True) / total.clamp(min=1)
    translation = (share * moves).sum(1, keepdim=True) / (total + _REGULAR[0])
    wanted = (share * torch.linalg.cross(arms, moves)).sum(1)  # (batch, 3)
    outer = (share[..., None] * arms[..., :, None] * arms[..., None, :]).sum(1)  # (batch, 3, 3)
    squared = outer[:, 0, 0] + outer[:, 1, 1] + outer[:, 2, 2] + regular
    a, b, c = (squared[:, None, None] * torch.eye(3).to(outer) - outer).unbind(1)
    beside = torch.linalg.cross(b, c)
    determinant = (a * beside).sum(-1, keepdim=True)
    turn = torch.stack(
        [
            (wanted * beside).sum(-1),
            (a * torch.linalg.cross(wanted, c)).sum(-1),
            (a * torch.linalg.cross(b, wanted)).sum(-1),
        ],
        -1,
    )
    return translation + torch.linalg.cross((turn / determinant)[:, None].expand_as(arms), arms)
