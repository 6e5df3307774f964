"""The benchmark's upper bounds.

Importing this module makes them methods by name: `operator`, `forces`.
"""

from lerobot_dexflex.interfaces.registry import InterfaceEntry, register

OPERATOR, FORCES = "operator", "forces"
_PRIVILEGED = "lerobot_dexflex.evaluation.reach.privileged"

register(OPERATOR, InterfaceEntry(_PRIVILEGED, "OperatorInterface", "draft"))
register(FORCES, InterfaceEntry(_PRIVILEGED, "ForcesInterface", "draft"))
