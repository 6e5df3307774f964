"""Repair a draft by what touch says of the grasp: the analytic member of the candidate set.

Fingers that carry the object move together: their common rigid motion passes, what they do against each
other is damped, and not passed at all where it would open a loose grasp. Everything goes slowly. A small
servo holds the squeeze but never loosens what the draft presses, and a finger that lost the object a moment
ago returns to it. Where there is no grasp to protect, because none has formed yet or the drafts ask to let go
for long enough, they pass as they are.

A draft whose steps differ is a plan: it knows what the fingers are to do against each other, which then
passes (`planned_gain`), and says beforehand when it lets go. One that only holds its first step, as a
glove's, does not look ahead, and is trusted less.

Rigid-motion and freeze-a-finger candidates were the favourites of the simulator oracle in our prototype;
this is their closed form, with gains found by random search on training objects (log in `eval/README.md`).
"""

import torch
from torch import Tensor

from lerobot_dexflex.controller.history import History
from lerobot_dexflex.controller.settings import ProjectionSettings
from lerobot_dexflex.conventions import FINGER_NAMES
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.kinematics import pads

_PAIR, _ENOUGH = 2, 3
"""Loaded fingers that make a grasp worth protecting; and that make its motion more than a guess."""
_RECENT = 3
"""Newest frames (now, 1 and 3 steps ago) in which a load counts as recent."""
_THUMB, _LET_GO = FINGER_NAMES.index("thumb"), 0.002
"""It lets go where recent drafts, or a plan, take thumb and two fingers outward, on average so fast [m]."""
_PLAN = 1e-4
"""The steps of a plan differ by more [m]."""
_MAX_SQUEEZE, _MAX_RELIEF = 0.0015, 0.001
"""Largest displacement of the squeeze servo, inward and outward [m]."""
_REGULAR = (1e-9, 1e-6)
"""Regularisation of the fit, [1] for translation and [m^2] for rotation."""


def project_draft(
    draft: Tensor, history: History, drafts_history: Tensor, settings: ProjectionSettings
) -> Tensor:
    """Return the draft as a motion that keeps loaded fingertips on the object.

    A finger whose touch is missing counts as free. Without any touch it cannot be known whether there is a
    grasp: only `free_gain` and `speed` act.

    Args:
        draft: Displacements of the commanded fingertips [m]. Shape (batch, horizon, 4, 3).
        history: The state; its newest frames, and its loads of the last 28 steps, are read.
        drafts_history: First displacements of earlier drafts [m]. Shape (batch, 8, 4, 3).
        settings: Gains and limits.

    Returns:
        Shape of `draft`.
    """
    missing = history.tactile_missing[:, None]
    loads = history.tactile[:, :_RECENT].sum((-1, -2)).double()  # (batch, frames, 4)
    loads = loads.masked_fill(missing, 0.0)
    loaded, recent = loads[:, 0] > CONTACT_FORCE, (loads > CONTACT_FORCE).any(1)  # (batch, 4)
    inward = pads(history.joints[:, 0].double())[1][:, None]  # (batch, 1, 4, 3): out of the pad
    asked = draft.double()
    tips = history.fingertips[:, 0].double()
    rigid = _rigid_motion(asked, tips, loaded.double())
    internal = asked - rigid
    normal = (internal * inward).sum(-1, keepdim=True)
    planned = (asked - asked[:, :1]).abs().amax((1, 2, 3)) > _PLAN
    gain = torch.where(planned, settings.planned_gain, settings.internal_gain)[:, None, None, None]
    firm = (loads[:, 0] > settings.opening_load)[:, None, :, None]
    opening = gain * normal.clamp(max=0) * firm
    closing = settings.closing_gain * normal.clamp(min=0)
    together = rigid + gain * (internal - normal * inward) + (opening + closing) * inward
    held = (loaded & (loaded.sum(1, keepdim=True) >= _ENOUGH))[:, None, :, None]
    moved = torch.where(held, settings.gain * together, settings.free_gain * asked)
    moved = moved * (settings.speed / moved.norm(dim=-1, keepdim=True).clamp(min=1e-9)).clamp(max=1.0)
    squeeze = (settings.squeeze_gain * (settings.preload - loads[:, 0])).clamp(-_MAX_RELIEF, _MAX_SQUEEZE)
    squeeze = (squeeze * recent)[:, None, :, None].expand_as(normal)
    squeeze = torch.where(
        normal > 0, squeeze.clamp(min=0), squeeze
    )  # It never loosens what the draft presses.
    back = (settings.return_speed * ~loaded * recent)[:, None, :, None]
    moved = moved + (squeeze + back) * inward

    slow = history.slow_loads.masked_fill(missing, 0.0) > CONTACT_FORCE  # (batch, 8, 4)
    formed = (slow.sum(-1) >= _PAIR).any(1) & recent.any(1)
    leaving = _lets_go(drafts_history.double(), inward) | (planned & _lets_go(asked, inward))
    blind = missing.flatten(1).all(1)
    protect = (formed & ~leaving) | blind
    return torch.where(protect[:, None, None, None], moved, asked).to(draft.dtype)


def _lets_go(displacements: Tensor, inward: Tensor) -> Tensor:
    """Return whether displacements (batch, steps, 4, 3) take thumb and two fingers outward: (batch,)."""
    outward = -(displacements.mean(1) * inward[:, 0]).sum(-1) > _LET_GO  # (batch, 4)
    return outward[:, _THUMB] & (outward.sum(1) >= _ENOUGH)


def _rigid_motion(displacements: Tensor, tips: Tensor, weights: Tensor) -> Tensor:
    """Return the rigid motion of all tips that fits the weighted ones best, by least squares.

    Args:
        displacements: Shape (batch, horizon, 4, 3) [m].
        tips: Shape (batch, 4, 3) [m].
        weights: Shape (batch, 4).
    """
    total = weights.sum(1).clamp(min=1)[:, None, None]
    arms = tips - (weights[..., None] * tips).sum(1, keepdim=True) / total
    x, y, z = arms.unbind(-1)
    zero = torch.zeros_like(x)
    # Row i of a finger maps the twist (v, w) to its velocity v + w x r.
    cross = torch.stack([zero, z, -y, -z, zero, x, y, -x, zero], -1).unflatten(-1, (3, 3))
    jacobian = torch.cat([torch.eye(3).to(cross).expand_as(cross), cross], -1)  # (batch, 4, 3, 6)
    weighted = (jacobian * weights[..., None, None]).flatten(1, 2)  # (batch, 12, 6)
    regular = torch.diag(torch.tensor([_REGULAR[0]] * 3 + [_REGULAR[1]] * 3).to(cross))
    wanted = (displacements * weights[:, None, :, None]).flatten(2)  # (batch, horizon, 12)
    twist = torch.linalg.solve(
        weighted.mT @ weighted + regular, weighted.mT @ wanted.mT
    )  # (batch, 6, horizon)
    return (jacobian.flatten(1, 2) @ twist).mT.unflatten(-1, (4, 3))
