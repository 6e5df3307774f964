"""How a hand holds tools: the frame that it works in, and where its pads are on bars.

The *working frame* is fixed to the palm and alike for all hands. Fingers push toward its -x, those that
oppose toward +x; y runs along the row of fingers toward the first; over a table z is up. What operators are
told is in this frame: a hand differs from another in how its palm lies in it.
"""

from typing import NamedTuple

import numpy as np

from lerobot_dexflex.experts.command import Array
from lerobot_dexflex.experts.tool.grip import Grip, Handle, grip_handle
from lerobot_dexflex.hands import Hand

PUSH = np.array([-1.0, 0.0, 0.0])
"""Where fingers that do not oppose push."""
BAR_RADIUS = 0.012
"""Radius of the bars that habits are found with [m]."""
PADS_TURN = -0.45
"""While pads roll a bar they turn the other way, by this share: fingers bend."""
ASIDE = 0.002
"""How far the opposing pads are off where they touch a bar that is rolled [m]."""


class BarHold(NamedTuple):
    """Pads on both sides of a bar along y of the working frame."""

    hand: Hand
    """Whose pads."""
    frame: Array
    """Axes of the working frame in the palm frame, as columns. Shape (3, 3)."""
    centre: Array
    """Point on the bar's axis between the pads, working frame [m]. Shape (3,)."""
    touch: Array
    """All pads on the bar [rad]: where the search for a grip begins. Shape (joints,)."""
    idle: Array
    """Posture of fingers that take no part [rad]. Shape (joints,)."""
    along: Array
    """Where the pads are along the bar, from the centre toward the first finger [m]. Shape (fingers,)."""
    turn: float = 0.0
    """Turn of the push about the bar [rad]."""
    room: float = 0.024
    """How far from the bar the open pads are [m]."""
    approach: float = 0.09
    """From how far the hand reaches straight for an upright tool [m]: before, it may turn."""

    @property
    def push(self) -> Array:
        """Direction in which the fingers push, working frame. Shape (3,)."""
        return np.array([-np.cos(self.turn), 0.0, np.sin(self.turn)])

    def grip(self, axis: Array, half_width: float, fingers: tuple[int, ...]) -> Grip:
        """Return the grip of a bar whose axis in the working frame is (3,), its half width [m]."""
        bar = Handle(self.centre, axis, half_width)
        return grip_handle(
            self.hand, self.frame, bar, self.along, self.push, fingers, self.touch, self.idle, self.room
        )


class DriverHold(NamedTuple):
    """A hold of a bar along y of the working frame that fingers roll about its axis."""

    bar: BarHold
    """The hold in the middle of a stroke."""
    around: Array
    """By how much the push of each finger is turned about the bar there [rad]. Shape (fingers,)."""
    stroke: float
    """How far fingers roll the bar before they grasp it again [rad]."""

    def places(self, handle: Handle, back: float) -> tuple[Array, Array]:
        """Return how the push of each finger is turned [rad], and how far pads are off sideways [m].

        Args:
            handle: The bar.
            back: By how much the fingers have rolled it back from the middle of a stroke [rad].
        """
        beside = np.zeros(len(self.around))
        beside[list(self.bar.hand.opposing_fingers)] = ASIDE
        return self.around + PADS_TURN * back, beside - handle.radius * (1 - PADS_TURN) * back

    def grip(
        self, fingers: tuple[int, ...], handle: Handle, back: float = 0.0, room: float | None = None
    ) -> Grip:
        """Return the grip of a bar whose fingers have rolled it back by an angle [rad]."""
        bar = self.bar
        around, beside = self.places(handle, back)
        return grip_handle(
            bar.hand,
            bar.frame,
            handle,
            bar.along,
            PUSH,
            fingers,
            bar.touch,
            bar.idle,
            bar.room if room is None else room,
            around,
            beside,
        )


class Habit(NamedTuple):
    """Fingers that oppose against a shallow V of two neighbours, on a bar along z of the working frame."""

    hand: Hand
    """Whose fingers."""
    frame: Array
    """Axes of the working frame in the palm frame, as columns. Shape (3, 3)."""
    fingers: tuple[int, ...]
    """Which take part, as indices into `Hand.fingers`."""
    centre: Array
    """Point on the axis between the pads, working frame [m]. Shape (3,)."""
    touch: Array
    """The pads on a bar of 12 mm radius [rad]: where the search for a grip begins. Shape (joints,)."""
    around: Array
    """By how much the push of each finger is turned about the bar [rad]. Shape (fingers,)."""
    beside: Array
    """How far the middle of each pad is off where it touches, sideways [m]. Shape (fingers,)."""
    shift: float
    """By how much the pads that oppose are moved aside per turn of the grip [m/rad]: they roll on the bar."""

    def grip(self, handle: Handle, turn: float = 0.0, room: float = 0.016) -> Grip:
        """Return the grip of a bar with all fingers turned about it by `turn` [rad]."""
        beside = self.beside.copy()
        beside[list(self.hand.opposing_fingers)] = self.shift * turn
        return grip_handle(
            self.hand,
            self.frame,
            handle,
            np.zeros(self.hand.n_fingers),
            PUSH,
            self.fingers,
            self.touch,
            self.touch,
            room,
            self.around + turn,
            beside,
        )


class Holds(NamedTuple):
    """All ways in which a hand holds tools; they share one working frame."""

    frame: Array
    """Axes of the working frame in the palm frame, as columns. Shape (3, 3)."""
    bar: BarHold
    """Of tools that lie level and are gripped from above."""
    pitcher: BarHold
    """Of an upright handle that is gripped from behind."""
    driver: DriverHold
    """Of an upright handle that is gripped from behind and turned."""
    habits: tuple[Habit, Habit]
    """Of upright bars that are gripped from above and turned: with the first two fingers, or the next."""
