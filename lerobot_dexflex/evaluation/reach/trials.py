"""Chunks of motion tried out in the simulator before one is executed: the true outcome of each."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.commands.loop import Slot
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.experts.reach.sensing import HandState
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE, gripping_joints

Array = NDArray[np.float64]
LOST_GRASP, LOST_FINGER = 1000.0, 40.0
"""Cost of holding with fewer than two fingers at any step, and of each loaded finger that ends unloaded,
beside the mean squared distance of fingertips from where they are wanted [mm^2]."""


class Outcomes(NamedTuple):
    """What each of N chunks comes to."""

    cost: Array
    """Squared distance and losses, see `LOST_GRASP`. Shape (N,)."""
    lost: NDArray[np.bool_]
    """Fingers that carried load and do not any more. Shape (N, fingers)."""
    grasp_lost: NDArray[np.bool_]
    """Whether fewer than two fingers carried load at some step, though two did at first. Shape (N,)."""


def try_out(
    slot: Slot,
    chunks: Array,
    wanted: Array,
    grip: Callable[[HandState], Array],
    moving: int = DRAFT_HORIZON,
) -> Outcomes:
    """Execute chunks with a grip, each from the state now, and return there.

    Args:
        slot: A running episode.
        chunks: Where the fingertips should be after 1, 2, ... steps, relative to where they are now [m].
            Shape (N, H, fingers, 3).
        wanted: What they are compared with [m]. Shape (H, fingers, 3).
        grip: Given the state, the contact forces at the pads [N] (fingers, 3); asked at every step.
        moving: Steps of both after which they stand still.
    """
    last = np.minimum(np.arange(len(wanted)), moving - 1)
    env, snapshot, loaded = slot.held.env, slot.held.env.snapshot(), slot.state.loads > CONTACT_FORCE
    hand = env.hand
    found = []
    for chunk in chunks:
        env.restore(snapshot)
        state, least, posture = slot.state, hand.n_fingers, slot.state.joints
        for offset in chunk[last]:
            posture = kernels.solve_fingertips(hand.tables, slot.state.tips + offset, posture)
            centres = kernels.pads(hand.tables, state.joints)[0]
            joints = gripping_joints(hand, posture, state.joints, centres, grip(state))
            state = slot.held.execute(joints)
            least = min(least, int((state.loads > CONTACT_FORCE).sum()))
        lost, grasp_lost = loaded & (state.loads <= CONTACT_FORCE), least < min(2, int(loaded.sum()))
        distance = 1e6 * float(np.square((chunk - wanted)[last]).sum(-1).mean())
        found.append((distance + LOST_GRASP * grasp_lost + LOST_FINGER * lost.sum(), lost, grasp_lost))
    env.restore(snapshot)
    return Outcomes(*(np.array(part) for part in zip(*found, strict=True)))
