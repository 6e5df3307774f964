import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation import latency
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface


@pytest.fixture(scope="module")
def networks(controller_folder):
    return latency.load_networks(controller_folder)


def test_percentiles_of_all_interfaces_come_from_the_same_run(networks):
    found = latency.measure(latency.interfaces_at_defaults(networks), 5)
    assert list(found) == ["raw", "dexgen", "dexflex, 16 candidates", "dexflex, 64 candidates"]
    assert all(0 < times.p50 <= times.p95 <= times.p99 for times in found.values())
    assert found["raw"].p50 < found["dexflex, 64 candidates"].p50


def test_the_grid_counts_the_draft_among_the_candidates(networks, monkeypatch):
    seen = {}
    monkeypatch.setattr(latency, "measure", lambda made, steps: seen.update(made) or dict.fromkeys(made))
    assert set(latency.grid(networks, 1, (4, 7), (1, 2))) == {(4, 1), (4, 2), (7, 1), (7, 2)}
    for name, interface in seen.items():
        assert isinstance(interface, DexFlexInterface)
        settings = interface.settings
        assert name == f"{settings.n_candidates} {settings.nfe}"


def test_without_a_shipped_controller_random_weights_are_timed_and_a_named_one_must_exist(
    networks, monkeypatch, tmp_path
):
    assert networks.trained
    monkeypatch.setattr("lerobot_dexflex.interfaces.controller_folder.SHIPPED", tmp_path / "nowhere")
    assert not latency.load_networks().trained
    with pytest.raises(DexFlexError, match="No controller at"):
        latency.load_networks(str(tmp_path / "named"))
