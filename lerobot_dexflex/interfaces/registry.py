"""All action interfaces by name; a module is imported when its interface is made.

`NAME@GAIN`, as in `dexgen@0.4`, executes that share of what the interface would (`GainInterface`).
"""

import importlib
from typing import Any, NamedTuple

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.protocol import CommandSpace, Interface

_HERE = "lerobot_dexflex.interfaces"


class InterfaceEntry(NamedTuple):
    """Where an interface lives and what it takes; known without importing it."""

    module: str
    """Full name of its module."""
    class_name: str
    """Class in the module."""
    command_space: CommandSpace
    """What its drafts are."""
    learned: bool = False
    """Whether it needs a trained controller, its option `controller`."""


INTERFACES: dict[str, InterfaceEntry] = {
    "joint": InterfaceEntry(f"{_HERE}.joint", "JointInterface", "joint"),
    "raw": InterfaceEntry(f"{_HERE}.raw", "RawInterface", "draft"),
    "filter": InterfaceEntry(f"{_HERE}.filter", "FilterInterface", "draft"),
    "hold": InterfaceEntry(f"{_HERE}.hold", "HoldInterface", "draft"),
    "shrink": InterfaceEntry(f"{_HERE}.shrink", "ShrinkInterface", "draft"),
    "clip": InterfaceEntry(f"{_HERE}.clip", "ClipInterface", "draft"),
    "reflex": InterfaceEntry(f"{_HERE}.reflex", "ReflexInterface", "draft"),
    "dexgen": InterfaceEntry(f"{_HERE}.dexgen", "DexGenInterface", "draft", learned=True),
    "dexflex": InterfaceEntry(f"{_HERE}.dexflex", "DexFlexInterface", "draft", learned=True),
    "dexflex-notouch": InterfaceEntry(f"{_HERE}.dexflex", "DexFlexWithoutTouch", "draft", learned=True),
}


def interface_entry(name: str) -> InterfaceEntry:
    """Return the entry of an interface, `NAME` or `NAME@GAIN`.

    Raises:
        DexFlexError: If there is no such interface, or it has no displacement that could be scaled.
    """
    plain, gain = _split(name)
    if plain not in INTERFACES:
        raise DexFlexError(f"Unknown interface {plain!r}. Valid interfaces: {', '.join(INTERFACES)}.")
    if gain is not None and INTERFACES[plain].command_space != "draft":
        raise DexFlexError(f"Only displacements can be scaled; {plain!r} executes joint targets.")
    return INTERFACES[plain]


def make_interface(name: str, **options: Any) -> Interface:
    """Build an interface by name.

    Args:
        name: A key of `INTERFACES`, `@` and a gain in (0, 1] appended or not.
        **options: Arguments of the interface's class; learned ones take `controller`.

    Raises:
        DexFlexError: If there is no such interface, or no controller where one is needed.
    """
    entry, gain = interface_entry(name), _split(name)[1]
    interface = getattr(importlib.import_module(entry.module), entry.class_name)(**options)
    if gain is None:
        return interface
    return importlib.import_module(f"{_HERE}.gain").GainInterface(interface, gain)


def _split(name: str) -> tuple[str, float | None]:
    """Return an interface's plain name and its gain.

    Raises:
        DexFlexError: If the gain is none.
    """
    plain, at, word = name.partition("@")
    if not at:
        return plain, None
    try:
        gain = float(word)
    except ValueError:
        gain = 0.0
    if not 0 < gain <= 1:
        raise DexFlexError(f"An interface's gain must be in (0, 1], as in {plain}@0.4. Got {name!r}.")
    return plain, gain
