"""What a controller's networks see fingers as: those of its hand, or slots that several hands share."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.grasp_frame import grasp_frame
from lerobot_dexflex.hands import Hand, get_hand

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

BETWEEN = "+"
"""Between the names of the hands of one controller, as in `leap+sharpa`."""
_LENGTH = 0.1
"""Unit of what the geometry tells of places [m]."""


class Layout:
    """One hand: its own fingers and joints, in the frame of its palm.

    Args:
        hands: The hand.
    """

    geometry_width: int = 0
    """Numbers that tell of the geometry of a finger; none are needed of one hand."""

    def __init__(self, *hands: Hand) -> None:
        self.hands = hands
        self.taxels = hands[0].taxels
        self.n_fingers, self.n_joints = hands[0].n_fingers, hands[0].n_joints

    def finger_joints(self) -> Indices:
        """Return each finger's joints, (fingers, joints of the longest); `n_joints` stands for none."""
        (hand,) = self.hands
        found = np.full((hand.n_fingers, hand.tables.widest), hand.n_joints)
        for row, own in zip(found, hand.finger_joints, strict=True):
            row[: own.stop - own.start] = np.arange(own.start, own.stop)
        return found

    def joint_center(self) -> Array:
        """Return what the encoder takes off joints [rad]. Shape (joints,)."""
        return middle(self.hands[0])

    def joint_range(self) -> Array:
        """Return what it divides them by then [rad]. Shape (joints,)."""
        return (self.hands[0].joint_upper - self.hands[0].joint_lower) / 2

    def tip_center(self) -> Array:
        """Return what it takes off fingertips: their places with joints in the middle [m]. (fingers, 3)."""
        (hand,) = self.hands
        return kernels.fingertips(hand.tables, middle(hand)[None])[0]


class SharedLayout(Layout):
    """Several hands: a slot for each finger by its role, in the frame in which hands are alike.

    The opposed fingers stand along the row, the opposing ones behind them, each with as many joints as the
    longest; for the frame see `grasp_frame`. A slot may be empty, and its geometry tells what it holds.

    Args:
        hands: The hands, each once.

    Raises:
        DexFlexError: If their fingertips have different numbers of taxels.
    """

    def __init__(self, *hands: Hand) -> None:
        super().__init__(*hands)
        if len({hand.taxels for hand in hands}) > 1:
            sizes = ", ".join(f"'{hand.name}' {hand.taxels}" for hand in hands)
            raise DexFlexError(
                f"Hands share a controller only if their fingertips have as many taxels. Got {sizes}."
            )
        self._opposed = max(len(hand.opposed_fingers) for hand in hands)
        self._widest = max(hand.tables.widest for hand in hands)
        self.n_fingers = self._opposed + max(len(hand.opposing_fingers) for hand in hands)
        self.n_joints = self.n_fingers * self._widest
        self.geometry_width = 1 + 3 + 3 + 4 * self._widest

    def slots(self, hand: Hand) -> Indices:
        """Return the slot of each of a hand's fingers. Shape (fingers of the hand,)."""
        pads, _ = kernels.pads(hand.tables, np.array(hand.nominal_joints))
        along = pads @ np.array(hand.finger_order)
        slots = np.empty(hand.n_fingers, np.int64)
        slots[sorted(hand.opposed_fingers, key=lambda k: -along[k])] = np.arange(len(hand.opposed_fingers))
        slots[list(hand.opposing_fingers)] = self._opposed + np.arange(len(hand.opposing_fingers))
        return slots

    def joint_slots(self, hand: Hand) -> Indices:
        """Return where each of a hand's joints stands. Shape (joints of the hand,)."""
        counts = [own.stop - own.start for own in hand.finger_joints]
        starts = self._widest * self.slots(hand)
        return np.concatenate([start + np.arange(n) for start, n in zip(starts, counts, strict=True)])

    def finger_joints(self) -> Indices:
        """Return each finger's joints. Shape (fingers, joints of the longest)."""
        return np.arange(self.n_joints).reshape(self.n_fingers, self._widest)

    def joint_center(self) -> Array:
        """Return zeros: joints come as distances from the middle of their range."""
        return np.zeros(self.n_joints)

    def joint_range(self) -> Array:
        """Return ones: [rad] is a unit that suits all hands."""
        return np.ones(self.n_joints)

    def tip_center(self) -> Array:
        """Return the mean over the hands that have a finger there [m]. Shape (fingers, 3)."""
        found, count = np.zeros((self.n_fingers, 3)), np.zeros((self.n_fingers, 1))
        for hand in self.hands:
            centre, axes = grasp_frame(hand)
            tips, slots = kernels.fingertips(hand.tables, middle(hand)[None])[0], self.slots(hand)
            found[slots] += (tips - centre) @ axes
            count[slots] += 1
        return found / count

    def geometry(self, hand: Hand) -> Array:
        """Return what there is to know of the finger in each slot, zeros of none. (fingers, geometry_width).

        That there is one; where its pad is when the hand is half closed and where that faces; and joint by
        joint, that there is one and how it moves the tip then. In the shared frame, of length unit 0.1 m.
        """
        found = np.zeros((self.n_fingers, self.geometry_width))
        (centre, axes), joints = grasp_frame(hand), np.array(hand.nominal_joints)
        pads, normals = kernels.pads(hand.tables, joints)
        tips = kernels.fingertips(hand.tables, joints)
        origins, turns, _ = kernels.frames(hand.tables, joints)
        for k, slot in enumerate(self.slots(hand)):
            own = hand.finger_joints[k].stop - hand.finger_joints[k].start
            moves = np.zeros((self._widest, 1 + 3))  # That it is there, and how it moves the tip.
            moves[:own, 0] = 1
            moves[:own, 1:] = np.cross(turns[k, :own], tips[k] - origins[k, :own]) @ axes / _LENGTH
            place = (pads[k] - centre) @ axes / _LENGTH
            found[slot] = np.concatenate([[1.0], place, normals[k] @ axes, moves.ravel()])
        return found


def middle(hand: Hand) -> Array:
    """Return the middle of every joint's range [rad]. Shape (joints of the hand,)."""
    return (hand.joint_lower + hand.joint_upper) / 2


@cache
def layout_of(names: str) -> Layout:
    """Return the layout of the hands of these names, one or several with `+` between them.

    Raises:
        DexFlexError: If a hand is unknown or named twice, or they cannot share a controller.
    """
    words = names.split(BETWEEN)
    if len({*words}) < len(words):
        raise DexFlexError(f"`hand` names one hand, or several once each. Got '{names}'.")
    hands = [get_hand(word) for word in words]
    return SharedLayout(*hands) if len(hands) > 1 else Layout(*hands)
