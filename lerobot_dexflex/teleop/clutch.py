"""Couple the robot's palm to a person's wrist, as one lifts a mouse and sets it down."""

import numpy as np

from lerobot_dexflex.hand.arm import rotation_vector
from lerobot_dexflex.streams.record import Array
from lerobot_dexflex.streams.wrist_frame import Frame

JUMP, TURN = 0.15, 1.0
"""A wrist that moves farther from one record to the next [m], [rad] has not moved: its tracker found itself
anew, or the operator's view was centred again."""


class Clutch:
    """Moves the palm by what the wrist moved since both were coupled.

    The palm turns about the point where a person's wrist would be, as much as the wrist does, and moves with
    it, scaled. Directions are those of the world: x forward, y left, z up, for person and robot.

    Args:
        wrist: Where a person's wrist would be in the palm frame [m]: a `Retargeting`'s offset. Shape (3,).
        scale: Motion of the palm per motion of the wrist.
        heading: How far the person's forward is to the left of the robot's [rad].
    """

    def __init__(self, wrist: Array, scale: float = 1.0, heading: float = 0.0) -> None:
        self._pivot, self._scale = np.asarray(wrist, float), scale
        cos, sin = np.cos(heading), np.sin(heading)
        self._turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self._start: tuple[Frame, Frame] | None = None
        self._last: Frame | None = None

    def uncouple(self) -> None:
        """Let the wrist move alone."""
        self._start = None

    def lead(self, wrist: Frame, palm: Frame) -> Frame:
        """Return where the palm should be.

        Args:
            wrist: Where the person's is now, in the world of its device.
            palm: Where the robot's is now: there it stays if they are coupled now, because they were not, or
                because the wrist jumped.
        """
        if self._start is None or self._last is None or _jumped(self._last, wrist):
            self._start = (wrist, palm)
        self._last = wrist
        first, anchor = self._start
        rotation = self._turn @ wrist.rotation @ first.rotation.T @ self._turn.T @ anchor.rotation
        moved = self._scale * self._turn @ (wrist.position - first.position)
        point = anchor.position + anchor.rotation @ self._pivot + moved
        return Frame(point - rotation @ self._pivot, rotation)


def _jumped(before: Frame, now: Frame) -> bool:
    turn = np.linalg.norm(rotation_vector(now.rotation @ before.rotation.T))
    return bool(np.linalg.norm(now.position - before.position) > JUMP or turn > TURN)
