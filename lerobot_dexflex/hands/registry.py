"""Find a hand by its name: those of the library, and those of a user's module."""

from dataclasses import replace
from functools import cache
from importlib import import_module

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands.hand import Hand
from lerobot_dexflex.hands.leap import LEAP
from lerobot_dexflex.hands.sharpa import SHARPA

HANDS = {hand.name: hand for hand in (LEAP, SHARPA)}
"""Every hand of the library by its name."""


@cache
def get_hand(name: str) -> Hand:
    """Return the hand of a name, the same object for the same name.

    Args:
        name: One of `HANDS`, or `package.module:ATTRIBUTE` for a hand of a module that Python can import.
            This hand then bears that name, whatever it called itself: configurations, checkpoints and data
            sets keep the name of their hand, and find it again by it.

    Raises:
        DexFlexError: If there is no such hand.
    """
    module, colon, attribute = name.partition(":")
    if colon:
        return replace(_of_module(module, attribute), name=name)
    if name not in HANDS:
        raise DexFlexError(
            f"There is no hand '{name}'. Choose from {sorted(HANDS)}, or give a hand of your own as "
            "`package.module:ATTRIBUTE`."
        )
    return HANDS[name]


def _of_module(module: str, attribute: str) -> Hand:
    if not all(part.isidentifier() for part in (*module.split("."), attribute)):
        raise DexFlexError(
            "A hand of your own is named `package.module:ATTRIBUTE`, as `my_hands:CLAW`, without `.py`. "
            f"Got '{module}:{attribute}'."
        )
    try:
        found = import_module(module)
    except ImportError as error:
        raise DexFlexError(
            f"The module '{module}' of the hand '{module}:{attribute}' cannot be imported: {error}. Install "
            "it, or add its folder to the environment variable PYTHONPATH."
        ) from error
    if not hasattr(found, attribute):
        hands = sorted(key for key, value in vars(found).items() if isinstance(value, Hand))
        raise DexFlexError(f"The module '{module}' has no '{attribute}'. Its hands: {hands}.")
    hand = getattr(found, attribute)
    if not isinstance(hand, Hand):
        raise DexFlexError(
            f"'{module}:{attribute}' must be a `lerobot_dexflex.hands.Hand`. Got {type(hand).__name__}."
        )
    return hand
