"""Action interfaces: from a policy's draft to hand joint targets."""

from lerobot_dexflex.interfaces.filter import FilterInterface as FilterInterface
from lerobot_dexflex.interfaces.joint import JointInterface as JointInterface
from lerobot_dexflex.interfaces.protocol import (
    CommandSpace as CommandSpace,
)
from lerobot_dexflex.interfaces.protocol import (
    Interface as Interface,
)
from lerobot_dexflex.interfaces.raw import RawInterface as RawInterface
from lerobot_dexflex.interfaces.registry import INTERFACES as INTERFACES
from lerobot_dexflex.interfaces.registry import interface_entry as interface_entry
from lerobot_dexflex.interfaces.registry import make_interface as make_interface
