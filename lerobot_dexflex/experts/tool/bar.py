"""How a bar that lies level is gripped from above: the handles of hammers, brushes and spatulas."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.grip import Grip, Handle, grip_handle
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script

GRASP_CENTRE = np.array([-0.0405, -0.0353, -0.1401])
"""Point on the bar's axis between the pads, palm frame [m]; the bar runs along palm y in the end."""
HAND_TOUCH = np.array(
    (
        *(1.519, 0.004, 0.368, -0.316),
        *(1.518, -0.024, 0.367, -0.315),
        *(1.524, -0.053, 0.354, -0.307),
        *(1.755, 0.002, 0.386, -0.385),
    )
)
"""All four pads flat on a bar of 13 mm half width [rad]: where the search for a grip begins."""
HAND_IDLE = np.array((0.3, 0.0, 0.3, 0.3) * 3 + (1.6, 0.2, 0.8, -0.2))
"""Fingers that take no part are stretched out [rad]."""
ALONG = np.array([0.043, 0.0, -0.043, 0.012])
"""Where the pads are along the bar, from the middle finger toward the index [m]."""
ROOM = 0.024
"""How far from the bar the open pads are [m]."""
HELD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Orientation of a tool in the palm once it is straight: z along palm y, its head at the index; x up."""


def grip_bar(axis: Array, half_width: float, fingers: tuple[int, ...]) -> Grip:
    """Return the grip of a bar whose axis in the palm frame is (3,), its half width [m]."""
    bar = Handle(GRASP_CENTRE, axis, half_width)
    return grip_handle(bar, ALONG, np.array([-1.0, 0, 0]), fingers, HAND_TOUCH, HAND_IDLE, ROOM)


def pick_up(
    script: Script,
    grip: Grip,
    grasp_point: Array,
    held: Pose,
    seed: tuple[float, ...],
    preload: float | None = None,
) -> Iterator[Command]:
    """Grip a bar from above, lift it by 2 cm, and begin to turn it straight in the hand.

    Args:
        script: Whose palm is above the table.
        grip: Of the bar as it lies.
        grasp_point: Where on the bar, world frame [m]. Shape (3,).
        held: The tool in the palm once it is straight.
        seed: Arm from which the pose above the bar is solved [rad].
        preload: Squeeze per finger that is wished for [N]; None leaves the operator's margin.
    """
    script.hand.go(grip.open, 20)
    yield from script.swing(grasp_point + np.array([0, 0, 0.08]), PALM_DOWN, 22, seed)
    script.care = 0.2
    yield from script.take(grip, grasp_point, PALM_DOWN, 15, preload)
    yield from script.glide(script.position + np.array([0, 0, 0.02]), PALM_DOWN, 6)
    script.hand.lead(*held)
