import sys
from pathlib import Path

import pytest

from lerobot_dexflex.interfaces.registry import INTERFACES, InterfaceEntry

# Worker processes import the fakes by name.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def learned(monkeypatch):
    """Methods that only have names: learned ones with an ablation and options, and the oracle."""
    entry = InterfaceEntry(
        "nowhere",
        "Nobody",
        "draft",
        files=("x",),
        options=INTERFACES["press"].options,
        ablations={"notouch": ""},
    )
    for name in ("dexflex", "dexgen", "oracle"):
        monkeypatch.setitem(INTERFACES, name, entry)
