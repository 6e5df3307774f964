"""A method by name: an interface, perhaps with a gain. Superseded at the merge by the one grammar."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces import registry
from lerobot_dexflex.interfaces.controller_folder import FILES, find_controller
from lerobot_dexflex.interfaces.protocol import CommandSpace, Interface
from lerobot_dexflex.interfaces.registry import INTERFACES, InterfaceEntry, interface_entry


@dataclass(frozen=True)
class Method:
    """An interface as it is named everywhere."""

    name: str

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the method with this name; raises DexFlexError if it is none."""
        interface_entry(name)
        return cls(name)

    @property
    def entry(self) -> InterfaceEntry:
        """The interface's entry in the registry."""
        return interface_entry(self.name)

    @property
    def command_space(self) -> CommandSpace:
        """What its drafts are."""
        return self.entry.command_space

    @property
    def learned(self) -> bool:
        """Whether it needs a trained controller."""
        return self.entry.learned

    @property
    def modules(self) -> tuple[str, ...]:
        """Full names of the modules that are imported to make it."""
        gain = ("lerobot_dexflex.interfaces.gain",) if "@" in self.name else ()
        return (self.entry.module, *gain)

    def weights(self, controller: str | Path | None = None) -> tuple[Path, ...]:
        """Return the files of a controller's folder that decide what it does; none if it is not learned."""
        if not self.learned:
            return ()
        files = FILES[self.name.partition("@")[0]]
        return tuple(find_controller(controller, files) / file for file in files)

    def make(self, controller: str | Path | None = None) -> Interface:
        """Build the interface."""
        options = {"controller": self.weights(controller)[0].parent} if self.learned else {}
        return registry.make_interface(self.name, **options)


def make_interface(name: str, controller: str | Path | None = None) -> Interface:
    """Build an interface by the name of a method; see `Method.parse` and `Method.make`."""
    return Method.parse(name).make(controller)


def require_drafts(name: str) -> Method:
    """Return the method with this name if an operator can work through it; raises DexFlexError if not."""
    method = Method.parse(name)
    if method.command_space != "draft":
        drafts = [other for other, entry in INTERFACES.items() if entry.command_space == "draft"]
        raise DexFlexError(
            f"The interface must be one that reads drafts: {', '.join(drafts)}. Got {name!r}: an operator "
            "commands fingertips."
        )
    return method
