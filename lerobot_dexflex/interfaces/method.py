"""The one grammar of methods: an interface by name, with its ablation, options and gain."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.options import written
from lerobot_dexflex.interfaces.protocol import CommandSpace, Interface
from lerobot_dexflex.interfaces.registry import INTERFACES, InterfaceEntry

Options = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Method:
    """An interface as it is named everywhere: `base[-ablation][:options][@gain]`.

    Options are `key=value` words joined by `+`; an interface's main option needs no key, several values are
    joined by `/`. A gain scales the motion that the interface asks of the hand, not its grip. Examples:
    `raw`, `press:2.5+blocked=True`, `dexflex-notouch@0.7`, `dexflex:nfe=2+levels=0.5/0.75`,
    `oracle:clean+moving=2`.
    """

    base: str
    """Key of `INTERFACES`."""
    ablation: str = ""
    """One of its entry's ablations, or empty."""
    options: Options = ()
    """Keys and values, the main option first, then by key."""
    gain: float = 1.0
    """In (0, 1]; 1 is the interface itself."""

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the method with this name; equal methods have one `name`, however they were written.

        Raises:
            DexFlexError: If interface, ablation, option or gain are none; says which there are.
        """
        rest, at, gain = name.partition("@")
        rest, colon, options = rest.partition(":")
        base, dash, ablation = rest.partition("-")
        if base not in INTERFACES:
            raise DexFlexError(f"Unknown interface {base!r} in {name!r}. Valid: {', '.join(INTERFACES)}.")
        entry = INTERFACES[base]
        if dash and ablation not in entry.ablations:
            raise DexFlexError(
                f"Unknown ablation {ablation!r} in {name!r}. Valid of {base!r}: "
                f"{', '.join(entry.ablations) or 'none'}."
            )
        found = _options(base, entry, options, name) if colon else ()
        return cls(base, ablation, found, _gain(base, entry, gain, name) if at else 1.0)

    @property
    def name(self) -> str:
        """The one name of the method."""
        words = [
            written(value) if key == self.entry.main_option else f"{key}={written(value)}"
            for key, value in self.options
        ]
        ablation = f"-{self.ablation}" if self.ablation else ""
        gain = f"@{written(self.gain)}" if self.gain != 1.0 else ""
        return f"{self.base}{ablation}{':' if words else ''}{'+'.join(words)}{gain}"

    @property
    def entry(self) -> InterfaceEntry:
        """The interface's entry in the registry."""
        return INTERFACES[self.base]

    @property
    def command_space(self) -> CommandSpace:
        """What its drafts are."""
        return self.entry.command_space

    @property
    def learned(self) -> bool:
        """Whether it needs a trained controller."""
        return bool(self.entry.files)

    @property
    def modules(self) -> tuple[str, ...]:
        """Full names of the modules that are imported to make it, beside what they import themselves."""
        return (self.entry.module,)

    def weights(self, hand: Hand, controller: str | Path | None = None) -> tuple[Path, ...]:
        """Return the files of a controller's folder that decide what it does; none if it is not learned.

        Args:
            hand: The hand that it is to serve.
            controller: Folder or hub id; the one shipped for the hand if empty.

        Raises:
            DexFlexError: If there is no such controller, or it lacks a file.
        """
        if not self.learned:
            return ()
        folder = find_controller(hand, controller, self.entry.files)
        return tuple(folder / file for file in self.entry.files)

    def make(self, hand: Hand, controller: str | Path | None = None) -> Interface:
        """Build the interface; its `name` is the method's.

        Args:
            hand: The hand that it is to serve.
            controller: Folder or hub id of the controller, if it needs one; the one shipped for the hand if
                empty.

        Raises:
            DexFlexError: If the controller is missing or damaged, or an option is out of its range.
        """
        arguments = {"hand": hand, **dict(self.options)}
        if self.learned:
            arguments["controller"] = find_controller(hand, controller, self.entry.files)
        if self.ablation:
            arguments["ablation"] = self.ablation
        interface = getattr(importlib.import_module(self.entry.module), self.entry.maker)(**arguments)
        if self.gain != 1.0:
            interface.gain = self.gain
        interface.name = self.name
        return interface


def make_interface(hand: Hand, name: str, controller: str | Path | None = None) -> Interface:
    """Build an interface by the name of a method; see `Method.parse` and `Method.make`."""
    return Method.parse(name).make(hand, controller)


def require_drafts(name: str) -> Method:
    """Return the method with this name if an operator, who commands fingertips, can work through it.

    Raises:
        DexFlexError: If there is no such method, or it does not read drafts.
    """
    method = Method.parse(name)
    if method.command_space != "draft":
        drafts = [other for other, entry in INTERFACES.items() if entry.command_space == "draft"]
        raise DexFlexError(
            f"The interface must be one that reads drafts: {', '.join(drafts)}. Got {name!r}: an operator "
            "commands fingertips."
        )
    return method


def _options(base: str, entry: InterfaceEntry, text: str, name: str) -> Options:
    found: dict[str, Any] = {}
    for each in text.split("+"):
        key, equals, value = each.partition("=")
        if not equals and entry.main_option:
            key, value = entry.main_option, each
        if key not in entry.options or key in found:
            what = "Repeated" if key in found else "Unknown"
            raise DexFlexError(
                f"{what} option {each!r} in {name!r}. Valid of {base!r}: "
                f"{', '.join(f'{k}=...' for k in entry.options) or 'none'}."
            )
        try:
            found[key] = entry.options[key].read(value)
        except ValueError as error:
            raise DexFlexError(
                f"Option `{key}` in {name!r} must be {entry.options[key].meaning}. Got {value!r}."
            ) from error
    return tuple(sorted(found.items(), key=lambda item: (item[0] != entry.main_option, item[0])))


def _gain(base: str, entry: InterfaceEntry, text: str, name: str) -> float:
    if entry.command_space != "draft":
        raise DexFlexError(f"Only drafts can be scaled; {base!r} executes joint targets. Got {name!r}.")
    try:
        gain = float(text)
    except ValueError:
        gain = 0.0
    if not 0 < gain <= 1:
        raise DexFlexError(f"An interface's gain must be in (0, 1], as in {base}@0.4. Got {name!r}.")
    return gain
