"""Cut drafts out of predicted chunks.

A chunk holds absolute targets p_0 ... p_{C-1}; at its step k an interface wants the next H steps::

    step       k     k+1   ...   C-1    beyond the chunk
    target    p_k   p_k+1  ...  p_C-1   p_C-1 repeated: no more motion
"""

import torch
from torch import Tensor


def joint_draft(targets: Tensor, step: int, horizon: int) -> Tensor:
    """Return the next joint targets, (batch, horizon, joints), of a chunk (batch, chunk, joints) [rad]."""
    last = targets.shape[1] - 1
    return targets[:, [min(step + k, last) for k in range(horizon)]]


def displacement_draft(
    planned: Tensor, step: int, horizon: int, command: Tensor, previous: Tensor | None, gain: float
) -> Tensor:
    """Return the next displacements of the commanded fingertips.

    d_k = (p_k - p_{k-1}) + gain (p_{k-1} - c_{k-1}), where c follows the draft: planned motion, and a part
    of the lag between the plan p and the executed command c. A gain of 1 always aims at p_k.

    Args:
        planned: Absolute planned fingertips [m]. Shape (batch, chunk, 4, 3).
        step: Step of the chunk that is executed now.
        horizon: Steps of the draft.
        command: Executed commanded fingertips before this step [m]. Shape (batch, 4, 3).
        previous: Planned fingertips of the previous control step [m], (batch, 4, 3); None at the start,
            where the plan begins at the command.
        gain: Part of the lag that is made up per step.

    Returns:
        Displacements [m]. Shape (batch, horizon, 4, 3).
    """
    start = command if previous is None else previous
    targets = joint_draft(planned, step, horizon)
    motion = torch.diff(targets, dim=1, prepend=start.unsqueeze(1))  # (batch, horizon, 4, 3)
    remaining = (1 - gain) ** torch.arange(horizon, dtype=planned.dtype, device=planned.device)
    lag = (start - command).unsqueeze(1)
    return motion + gain * remaining[:, None, None] * lag
