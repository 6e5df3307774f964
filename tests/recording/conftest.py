import shutil
import sys
from pathlib import Path

import pytest

from lerobot_dexflex.recording import RecordConfig, attempt, record

# Tests import the counting task by name.
sys.path.insert(0, str(Path(__file__).parent))
from counting_task import counting


@pytest.fixture
def counting_task(monkeypatch):
    with counting(monkeypatch, attempt, record) as task:
        yield task


@pytest.fixture(scope="session")
def recording_store(tmp_path_factory):
    """Where `recorded` keeps its recording for the next test."""
    return tmp_path_factory.mktemp("recorded") / "count"


@pytest.fixture
def recorded(counting_task, recording_store, tmp_path):
    """A test's own copy of a finished recording of two episodes, called `lerobot-dexflex/count`."""
    if not recording_store.exists():
        assert record.record(RecordConfig(counting_task, episodes=2, root=recording_store, workers=0), [])
    return shutil.copytree(recording_store, tmp_path / "count")
