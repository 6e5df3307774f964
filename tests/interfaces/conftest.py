import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # interface_cases

from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface


@pytest.fixture
def make(controller_folder):
    """Make any interface by a method's name, learned ones around the random controller."""

    def build(name):
        return make_interface(LEAP, name, controller_folder)

    return build
