"""The benchmark's upper bounds: the operator's clean commands; our candidates, chosen by the simulator.

Importing this module makes them methods by name: `clean`, `oracle`, `oracle:clean+moving=2`.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.interfaces.options import WHOLE, WORD
from lerobot_dexflex.interfaces.registry import (
    CONTROLLER_FILES,
    SELECTION_OPTIONS,
    InterfaceEntry,
    register,
)

if TYPE_CHECKING:
    from lerobot_dexflex.evaluation.reach.oracle import OracleInterface

CLEAN, ORACLE = "clean", "oracle"

Teacher = Callable[[np.random.Generator], Iterator[bool]]


def teacher_of(method: Method) -> Teacher | None:
    """Return which steps of an episode execute the clean command instead of the draft; None if none does."""
    return _always if method.base == CLEAN else None


def make_oracle(controller: str | Path, **options: Any) -> "OracleInterface":
    """Build the oracle from the words of a method's name.

    Args:
        controller: Folder of the controller that proposes.
        **options: `reference` and `moving` of `OracleInterface`, others of `SelectionSettings`.
    """
    from lerobot_dexflex.controller import SelectionSettings
    from lerobot_dexflex.evaluation.reach.oracle import OracleInterface
    from lerobot_dexflex.interfaces.learned import shared_controller

    tried = {key: options.pop(key) for key in ("reference", "moving") if key in options}
    settings = SelectionSettings(**options) if options else None
    return OracleInterface(shared_controller(Path(controller)), settings=settings, **tried)


def _always(rng: np.random.Generator) -> Iterator[bool]:
    del rng
    while True:
        yield True


register(CLEAN, InterfaceEntry("lerobot_dexflex.interfaces.raw", "RawInterface", "draft"))
register(
    ORACLE,
    InterfaceEntry(
        "lerobot_dexflex.evaluation.reach.bounds",
        "make_oracle",
        "draft",
        files=CONTROLLER_FILES,
        main_option="reference",
        options={"reference": WORD, "moving": WHOLE, **SELECTION_OPTIONS},
    ),
)
