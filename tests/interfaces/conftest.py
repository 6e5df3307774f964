import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # interface_cases

from lerobot_dexflex.interfaces import INTERFACES, make_interface


@pytest.fixture
def make(controller_folder):
    """Make any interface by name, learned ones around the random controller."""

    def build(name, **options):
        if INTERFACES[name].learned:
            options = {"controller": controller_folder, **options}
        return make_interface(name, **options)

    return build
