"""All action interfaces by name, with what they take and need; known without importing them."""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.options import Kind
from lerobot_dexflex.interfaces.protocol import CommandSpace


@dataclass(frozen=True)
class InterfaceEntry:
    """Where an interface lives, what it takes and what it needs."""

    module: str
    """Full name of its module."""
    maker: str
    """Class in the module, or function that returns the interface, called with `hand` and the options; also
    with `controller` if there are `files`, and with `ablation` if there are ablations."""
    command_space: CommandSpace
    """What its drafts are."""
    files: tuple[str, ...] = ()
    """Files of a trained controller's folder that it needs; none if it is not learned."""
    main_option: str = ""
    """What an option without a key means."""
    options: Mapping[str, Kind] = field(default_factory=dict)
    """What it takes, by key."""
    ablations: Mapping[str, str] = field(default_factory=dict)
    """Its variants that lack something, and what they lack."""


INTERFACES: dict[str, InterfaceEntry] = {}


def register(name: str, entry: InterfaceEntry) -> None:
    """Make an interface known by a name.

    Raises:
        DexFlexError: If the name is taken or cannot be part of a method's name.
    """
    if name in INTERFACES:
        raise DexFlexError(f"There is an interface {name!r} already: {INTERFACES[name].module}.")
    if not name.isidentifier():
        raise DexFlexError(f"An interface's name must be letters, digits and '_'. Got {name!r}.")
    INTERFACES[name] = entry


importlib.import_module("lerobot_dexflex.interfaces.entries")
