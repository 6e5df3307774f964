"""Action interfaces: from a policy's draft to hand joint targets."""

from collections.abc import Callable

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.filter import FilterInterface as FilterInterface
from lerobot_dexflex.interfaces.joint import JointInterface as JointInterface
from lerobot_dexflex.interfaces.protocol import (
    DRAFT_HORIZON as DRAFT_HORIZON,
)
from lerobot_dexflex.interfaces.protocol import (
    CommandSpace as CommandSpace,
)
from lerobot_dexflex.interfaces.protocol import (
    Interface as Interface,
)
from lerobot_dexflex.interfaces.raw import RawInterface as RawInterface

INTERFACES: dict[str, Callable[[], Interface]] = {
    "joint": JointInterface,
    "raw": RawInterface,
    "filter": FilterInterface,
}


def make_interface(name: str) -> Interface:
    """Build an interface by name.

    Raises:
        DexFlexError: If there is no such interface.
    """
    if name not in INTERFACES:
        raise DexFlexError(f"Unknown interface {name!r}. Valid interfaces: {', '.join(INTERFACES)}.")
    return INTERFACES[name]()
