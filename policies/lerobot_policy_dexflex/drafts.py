"""Cut drafts out of predicted chunks.

A chunk holds absolute targets p_0 ... p_{C-1}; at its step k an interface wants the next H steps::

    step       k     k+1   ...   C-1    beyond the chunk
    target    p_k   p_k+1  ...  p_C-1   p_C-1 repeated: no more motion
"""

import torch
from torch import Tensor

from lerobot_dexflex.interfaces.contact_projection import rigid_motion

_BEGINNING = 3
"""Steps whose mean is the beginning of a plan: one alone is off by what a sample shivers."""
_REGULAR = 1e-9
"""Of the fit of a rigid motion [m^2]: all of it is to stay."""


def joint_draft(targets: Tensor, step: int, horizon: int) -> Tensor:
    """Return the next targets of a chunk.

    Args:
        targets: Absolute, such as joint targets [rad]. Shape (batch, chunk, ...).
        step: Step of the chunk that is executed now.
        horizon: Steps of the draft.

    Returns:
        Shape (batch, horizon, ...).
    """
    last = targets.shape[1] - 1
    return targets[:, [min(step + k, last) for k in range(horizon)]]


def smoothed(plans: Tensor, steps: int) -> Tensor:
    """Return the moving average of plans over an odd number of steps; ends are repeated beyond the ends.

    Args:
        plans: Shape (batch, chunk, size).
        steps: 1 returns the plans themselves.
    """
    begin, end = (plans[:, at].unsqueeze(1).expand(-1, steps // 2, -1) for at in (0, -1))
    return torch.cat([begin, plans, end], 1).unfold(1, steps, 1).mean(-1)


def without_squeeze(planned: Tensor, tips: Tensor, touching: Tensor) -> Tensor:
    """Take out of plans what would squeeze or open the grip at their beginning: drafts are motion.

    Where plans begin, they are off by millimetres, which pushes some of the touching fingers in and pulls
    others away. What of this moves these fingers as one rigid body, with the object, stays; the rest is taken
    out of all steps. Fingers in the air keep their place.

    Args:
        planned: Where fingertips should be [m]. Shape (batch, chunk, 3 fingers).
        tips: Where they are when the plan begins [m]. Shape (batch, 3 fingers).
        touching: Shape (batch, fingers), bool.
    """
    held, here = touching.double(), tips.double().unflatten(-1, (-1, 3))
    off = planned[:, :_BEGINNING].double().mean(1).unflatten(-1, (-1, 3)) - here
    squeeze = held[..., None] * (off - rigid_motion(off, here, held, _REGULAR))
    return planned - squeeze.flatten(1).to(planned.dtype)[:, None]


def tip_draft(planned: Tensor, step: int, horizon: int, tips: Tensor) -> Tensor:
    """Return where the fingertips should be next, relative to where they are measured now.

    Args:
        planned: Absolute planned fingertips [m]. Shape (batch, chunk, fingers, 3).
        step: Step of the chunk that is executed now.
        horizon: Steps of the draft.
        tips: Fingertips, measured now [m]. Shape (batch, fingers, 3).

    Returns:
        Offsets [m]. Shape (batch, horizon, fingers, 3).
    """
    return joint_draft(planned, step, horizon) - tips[:, None]
