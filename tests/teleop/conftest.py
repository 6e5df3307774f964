import sys
from pathlib import Path

import pytest

# Tests import the moving hand, the synthetic hand and the counting task by name.
sys.path[:0] = [str(Path(__file__).parents[1] / name) for name in ("teleop", "streams", "recording")]


@pytest.fixture
def counting_task(monkeypatch):
    from counting_task import counting

    from lerobot_dexflex.recording import attempt
    from lerobot_dexflex.teleop import leader

    with counting(monkeypatch, attempt, leader) as task:
        yield task
