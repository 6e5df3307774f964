"""How a bar that lies level is gripped from above: the handles of hammers, brushes and spatulas."""

from collections.abc import Iterator

import numpy as np

from lerobot_dexflex.experts.command import Array, Command
from lerobot_dexflex.experts.tool.grip import Grip
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script

HELD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Orientation of a tool in the hand once it is straight: z along y, its head at the first finger; x up."""


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
        held: The tool in the working frame once it is straight.
        seed: Arm from which the pose above the bar is solved [rad].
        preload: Squeeze per finger that is wished for [N]; None leaves the operator's margin.
    """
    script.hand.go(grip.open, 20)
    yield from script.swing(grasp_point + np.array([0, 0, 0.08]), PALM_DOWN, 22, seed)
    script.care = 0.2
    yield from script.take(grip, grasp_point, PALM_DOWN, 15, preload)
    yield from script.glide(script.position + np.array([0, 0, 0.02]), PALM_DOWN, 6)
    script.hand.lead(*held)
