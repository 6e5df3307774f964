"""The methods under test by name: interfaces with options, ablations and gains, and the upper bounds."""

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.controller_folder import FILES, controller_of
from lerobot_dexflex.interfaces.gain import GainInterface
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.interfaces.registry import INTERFACES, make_interface

CLEAN, ORACLE = "clean", "oracle"
"""Upper bounds: the operator's own clean commands; and our candidates, chosen by the simulator."""
ABLATIONS = ("noscore", "notouch", "noconsequence", "nopure", "noseeded", "noslow")
_MAIN_OPTION = {"shrink": "gain", "clip": "limit", "dexgen": "guidance", ORACLE: "reference"}
"""What a bare option means."""
_LEARNED = ("dexgen", "dexflex", ORACLE)

_UPPER_BOUNDS = {CLEAN: "clean", ORACLE: "oracle"}


@dataclass(frozen=True)
class Method:
    """A method under test.

    Its name is `base[-ablation][:options][@gain]`, options joined by `+`: `raw`, `shrink:0.7`, `clip:0.0015`,
    `dexflex`, `dexflex-notouch`, `dexflex:temperature=0.2+n_pure=16@0.7`, `dexgen:20`,
    `oracle:clean+moving=2`.
    """

    name: str
    base: str
    ablation: str | None = None
    options: tuple[tuple[str, Any], ...] = ()
    gain: float = 1.0

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the method with this name.

        Raises:
            DexFlexError: If there is no such interface or ablation, or an option is no value.
        """
        rest, _, gain = name.partition("@")
        rest, _, options = rest.partition(":")
        base, _, ablation = rest.partition("-")
        valid = (*(k for k, entry in INTERFACES.items() if entry.command_space == "draft"), ORACLE, CLEAN)
        if base not in valid:
            raise DexFlexError(f"Unknown method {name!r}. Valid: {', '.join(valid)}.")
        if ablation and (ablation not in ABLATIONS or base != "dexflex"):
            raise DexFlexError(f"Unknown ablation {name!r}. Valid: dexflex-({'|'.join(ABLATIONS)}).")
        try:
            found = tuple(_option(base, word) for word in options.split("+") if word)
            return cls(name, base, ablation or None, found, float(gain) if gain else 1.0)
        except ValueError as error:
            raise DexFlexError(
                f"Cannot read {name!r}: {error}. Valid: name[:key=value+...][@gain]."
            ) from error

    @property
    def learned(self) -> bool:
        """Whether it needs a trained controller."""
        return self.base in _LEARNED

    @property
    def modules(self) -> tuple[str, ...]:
        """Names of the modules that it is made from."""
        here = __name__.rpartition(".")[0]
        bound = _UPPER_BOUNDS.get(self.base)
        module = f"{here}.{bound}" if bound else INTERFACES[self.base].module
        return (module,) if self.gain == 1.0 else (module, GainInterface.__module__)

    def weights(self, controller: str | Path | None = None) -> tuple[Path, ...]:
        """Return the files of the controller that decide what it does.

        Raises:
            DexFlexError: If it needs a controller that is not there.
        """
        if not self.learned:
            return ()
        kind = "dexgen" if self.base == "dexgen" else "dexflex"
        folder = controller_of(kind, controller or None)
        return tuple(folder / name for name in FILES[kind])

    def make(self, controller: str | Path | None = None) -> Interface:
        """Build the interface.

        Args:
            controller: Folder of the trained controller; the shipped one if None.

        Raises:
            DexFlexError: If the controller is missing or an option does not fit.
        """
        try:
            inner = self._inner(controller)
        except (TypeError, ValueError) as error:
            if isinstance(error, DexFlexError):
                raise
            raise DexFlexError(
                f"{self.name!r} has an option that {self.base!r} does not take: {error}"
            ) from error
        return inner if self.gain == 1.0 else GainInterface(inner, self.gain)

    def _inner(self, controller: str | Path | None) -> Interface:
        options = dict(self.options)
        if self.base == CLEAN:
            from lerobot_dexflex.evaluation.reach.clean import CleanInterface

            return CleanInterface(**options)
        if self.base == "dexgen":
            return make_interface("dexgen", controller=controller, **options)
        if not self.learned:
            return make_interface(self.base, **options)
        from lerobot_dexflex.evaluation.reach.oracle import OracleInterface
        from lerobot_dexflex.interfaces.dexflex import DexFlexInterface

        tried = {key: options.pop(key) for key in ("reference", "moving") if key in options}
        settings = selection_settings(self.ablation, options)
        loaded = shared_controller(controller)
        if self.base == ORACLE:
            return OracleInterface(loaded, settings=settings if options else None, **tried)
        return DexFlexInterface(loaded, settings)


def selection_settings(ablation: str | None, options: dict[str, Any]) -> Any:
    """Return the selection settings of an ablation; every ablation chooses among as many candidates."""
    from lerobot_dexflex.controller import SelectionSettings

    settings = SelectionSettings(**options)
    total = settings.n_candidates
    match ablation:
        case None:
            return settings
        case "noscore":
            return replace(settings, use_score=False)
        case "notouch":
            return replace(settings, use_touch=False)
        case "noconsequence":
            return replace(settings, use_dream=False)
        case "noslow":
            return replace(settings, use_slow=False)
        case "nopure":
            return replace(settings, n_pure=0, n_seeded=settings.n_pure + settings.n_seeded)
        case "noseeded":
            return replace(settings, n_pure=total, n_seeded=0, include_draft=False, project=False)
    raise DexFlexError(f"Unknown ablation {ablation!r}. Valid: {', '.join(ABLATIONS)}.")


@functools.cache
def shared_controller(folder: str | Path | None) -> Any:
    """Load a controller once per process; interfaces keep their state beside it."""
    from lerobot_dexflex.controller import DexFlexController
    from lerobot_dexflex.interfaces.controller_folder import find_controller

    return DexFlexController.from_pretrained(find_controller(folder))


def _option(base: str, word: str) -> tuple[str, Any]:
    key, found, text = word.partition("=")
    if not found:
        if base not in _MAIN_OPTION:
            raise ValueError(f"{base!r} takes no bare option {word!r}")
        key, text = _MAIN_OPTION[base], word
    return key, _value(text)


def _value(text: str) -> Any:
    if text in ("True", "False"):
        return text == "True"
    if "/" in text:
        return tuple(_value(part) for part in text.split("/"))
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
