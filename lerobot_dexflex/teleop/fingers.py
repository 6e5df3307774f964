"""Lead the robot's fingertips with a person's: one that was lost comes back gently."""

import numpy as np

from lerobot_dexflex.streams.record import Array, Record, leading_tips
from lerobot_dexflex.streams.retarget import Retargeting

RETURN_SPEED = 0.15
"""With which a finger's target goes back to the person's finger [m/s], beside that finger's own motion."""


class FingerLead:
    """Where the fingertips are led, record by record.

    A finger that is not tracked stays. When it comes back, and at the start of everything, the way between
    robot and person is covered at `RETURN_SPEED`.

    Args:
        retargeting: Of this person.
        tips: Where the robot's fingertips are, palm frame [m]. Shape (fingers, 3).
    """

    def __init__(self, retargeting: Retargeting, tips: Array) -> None:
        self._retargeting = retargeting
        self._leading = leading_tips(retargeting.hand)
        self.begin(tips)

    def begin(self, tips: Array) -> None:
        """Go on from where the robot's fingertips are, palm frame [m], (fingers, 3)."""
        self.targets = np.array(tips, float)
        """Where they are led, palm frame [m]. Shape (fingers, 3)."""
        self._gap = np.zeros_like(self.targets)
        self.lose()

    def lose(self) -> None:
        """Stay: no finger is tracked."""
        self._led = np.zeros(len(self._leading), bool)

    def lead(self, record: Record, dt: float) -> Array:
        """Return the targets [m], shape (fingers, 3).

        Args:
            record: The newest, even if it is the same as before.
            dt: Time since the last call [s].
        """
        tracked = record.tracked[self._leading]
        wish = self._retargeting(record.keypoints[self._leading])
        back = tracked & ~self._led
        gap = np.where(back[:, None], self.targets - wish, self._gap)
        far = np.linalg.norm(gap, axis=1, keepdims=True)
        self._gap = gap * np.maximum(0.0, 1.0 - RETURN_SPEED * dt / np.maximum(far, 1e-9))
        self._led = tracked
        self.targets = np.where(tracked[:, None], wish + self._gap, self.targets)
        return self.targets
