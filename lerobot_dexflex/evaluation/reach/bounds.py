"""The benchmark's upper bounds, which look into the simulator.

Importing this module makes them methods by name: `operator`, `forces`, `oracle`, `oracle:clean+moving=2`.
"""

from lerobot_dexflex.interfaces.controller_folder import CONTROLLER_FILES
from lerobot_dexflex.interfaces.entries import SELECTION_OPTIONS
from lerobot_dexflex.interfaces.options import WHOLE, WORD
from lerobot_dexflex.interfaces.registry import InterfaceEntry, register

OPERATOR, FORCES, ORACLE = BOUNDS = "operator", "forces", "oracle"
_PRIVILEGED = "lerobot_dexflex.evaluation.reach.privileged"

register(OPERATOR, InterfaceEntry(_PRIVILEGED, "OperatorInterface", "draft"))
register(FORCES, InterfaceEntry(_PRIVILEGED, "ForcesInterface", "draft"))
register(
    ORACLE,
    InterfaceEntry(
        "lerobot_dexflex.evaluation.reach.oracle",
        "make_oracle",
        "draft",
        files=CONTROLLER_FILES,
        main_option="reference",
        options={"reference": WORD, "moving": WHOLE, **SELECTION_OPTIONS},
    ),
)
