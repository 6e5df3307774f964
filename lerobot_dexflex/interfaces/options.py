"""What an option of a method may be: how its text is read, and how it is written again."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple


class Kind(NamedTuple):
    """A kind of value."""

    meaning: str
    """What is valid, for messages."""
    read: Callable[[str], Any]
    """Reads the text, or raises ValueError."""


def written(value: Any) -> str:
    """Return the one text of a value that `Kind.read` reads."""
    if isinstance(value, tuple):
        return "/".join(written(part) for part in value)
    # `+` joins options, so that exponents go without.
    return f"{value:.15g}".replace("e+", "e") if isinstance(value, float) else str(value)


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _switch(text: str) -> bool:
    if text not in ("True", "False"):
        raise ValueError(text)
    return text == "True"


def _list(read: Callable[[str], Any]) -> Callable[[str], tuple[Any, ...]]:
    return lambda text: tuple(read(part) for part in text.split("/"))


NUMBER = Kind("a number", _number)
WHOLE = Kind("a whole number", int)
SWITCH = Kind("True or False", _switch)
WORD = Kind("a word", str)
NUMBERS = Kind("numbers with '/' between them", _list(_number))
WORDS = Kind("words with '/' between them", _list(str))
