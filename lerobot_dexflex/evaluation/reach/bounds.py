"""The benchmark's upper bounds: the operator's clean commands; our candidates, chosen by the simulator.

Importing this module makes them methods by name: `clean`, `oracle`, `oracle:clean+moving=2`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

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


register(CLEAN, InterfaceEntry("lerobot_dexflex.evaluation.reach.clean", "CleanInterface", "draft"))
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
