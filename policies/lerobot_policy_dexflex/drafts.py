"""Cut drafts out of predicted chunks.

A chunk holds absolute targets p_0 ... p_{C-1}; at its step k an interface wants the next H steps::

    step       k     k+1   ...   C-1    beyond the chunk
    target    p_k   p_k+1  ...  p_C-1   p_C-1 repeated: no more motion
"""

from torch import Tensor


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


def tip_draft(planned: Tensor, step: int, horizon: int, tips: Tensor) -> Tensor:
    """Return where the fingertips should be next, relative to where they are measured now.

    Args:
        planned: Absolute planned fingertips [m]. Shape (batch, chunk, 4, 3).
        step: Step of the chunk that is executed now.
        horizon: Steps of the draft.
        tips: Fingertips, measured now [m]. Shape (batch, 4, 3).

    Returns:
        Offsets [m]. Shape (batch, horizon, 4, 3).
    """
    return joint_draft(planned, step, horizon) - tips[:, None]
