"""Hands as data: their numbers and how to get one by name."""

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands.body import PALM as PALM
from lerobot_dexflex.hands.finger import Finger as Finger
from lerobot_dexflex.hands.hand import Hand as Hand
from lerobot_dexflex.hands.leap import LEAP as LEAP
from lerobot_dexflex.hands.sharpa import SHARPA as SHARPA

HANDS = {hand.name: hand for hand in (LEAP, SHARPA)}
"""Every hand by its name."""


def get_hand(name: str) -> Hand:
    """Return the hand of a name.

    Raises:
        DexFlexError: If there is no such hand.
    """
    if name not in HANDS:
        raise DexFlexError(f"There is no hand '{name}'. Choose from {sorted(HANDS)}.")
    return HANDS[name]
