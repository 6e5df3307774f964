"""All action interfaces by name; a module is imported when its interface is made."""

import importlib
from typing import Any, NamedTuple

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.protocol import CommandSpace, Interface

_HERE = "lerobot_dexflex.interfaces"


class InterfaceEntry(NamedTuple):
    """Where an interface lives and what it takes; known without importing it."""

    module: str
    """Module in this package."""
    class_name: str
    """Class in the module."""
    command_space: CommandSpace
    """What its drafts are."""
    learned: bool = False
    """Whether it needs a trained controller, its option `controller`."""


INTERFACES: dict[str, InterfaceEntry] = {
    "joint": InterfaceEntry("joint", "JointInterface", "joint"),
    "raw": InterfaceEntry("raw", "RawInterface", "draft"),
    "filter": InterfaceEntry("filter", "FilterInterface", "draft"),
    "hold": InterfaceEntry("hold", "HoldInterface", "draft"),
    "shrink": InterfaceEntry("shrink", "ShrinkInterface", "draft"),
    "clip": InterfaceEntry("clip", "ClipInterface", "draft"),
    "reflex": InterfaceEntry("reflex", "ReflexInterface", "draft"),
    "dexgen": InterfaceEntry("dexgen", "DexGenInterface", "draft", learned=True),
    "dexflex": InterfaceEntry("dexflex", "DexFlexInterface", "draft", learned=True),
}


def interface_entry(name: str) -> InterfaceEntry:
    """Return an interface's entry.

    Raises:
        DexFlexError: If there is no such interface.
    """
    if name not in INTERFACES:
        raise DexFlexError(f"Unknown interface {name!r}. Valid interfaces: {', '.join(INTERFACES)}.")
    return INTERFACES[name]


def make_interface(name: str, **options: Any) -> Interface:
    """Build an interface by name.

    Args:
        name: A key of `INTERFACES`.
        **options: Arguments of the interface's class; learned ones take `controller`.

    Raises:
        DexFlexError: If there is no such interface, or no controller where one is needed.
    """
    entry = interface_entry(name)
    return getattr(importlib.import_module(f"{_HERE}.{entry.module}"), entry.class_name)(**options)
