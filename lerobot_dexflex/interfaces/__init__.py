"""Action interfaces: from a policy's draft to hand joint targets. Classes are imported from their modules."""

from lerobot_dexflex.interfaces.method import Method as Method
from lerobot_dexflex.interfaces.method import make_interface as make_interface
from lerobot_dexflex.interfaces.protocol import CommandSpace as CommandSpace
from lerobot_dexflex.interfaces.protocol import Interface as Interface
from lerobot_dexflex.interfaces.registry import INTERFACES as INTERFACES
