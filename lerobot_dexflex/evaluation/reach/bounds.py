"""The benchmark's upper bounds, which look into the simulator.

Importing this module makes them methods by name: `operator`, `forces`.
"""

from lerobot_dexflex.interfaces.registry import InterfaceEntry, register

OPERATOR, FORCES, ORACLE = BOUNDS = "operator", "forces", "oracle"
_PRIVILEGED = "lerobot_dexflex.evaluation.reach.privileged"

register(OPERATOR, InterfaceEntry(_PRIVILEGED, "OperatorInterface", "draft"))
register(FORCES, InterfaceEntry(_PRIVILEGED, "ForcesInterface", "draft"))
