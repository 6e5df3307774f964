from typing import Any

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation import latency
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface


@pytest.fixture(scope="module")
def networks(controller_folder):
    return latency.load_networks(LEAP, controller_folder)


class Slow:
    """Takes as many seconds as it was told, step by step."""

    def __init__(self, clock, seconds):
        self.clock, self.seconds = clock, iter(seconds)

    def step(self, observation, draft):
        assert observation["observation.tactile"].shape == (1, 240)
        self.clock.now += next(self.seconds)


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_percentiles_are_of_the_steps_after_the_warm_up():
    clock, warm = Clock(), [1000.0] * latency._WARM_UP
    slow = Slow(clock, [*warm, *range(100, -1, -1)])
    even = Slow(clock, [*warm, *[0.5] * 101])
    interfaces: Any = {"slow": slow, "even": even}
    found = latency.measure(LEAP, interfaces, 101, clock)
    assert found["slow"] == pytest.approx((50, 95, 99))
    assert found["even"] == pytest.approx((0.5, 0.5, 0.5))


def test_interfaces_are_timed_as_they_run_by_default(networks):
    found = latency.interfaces_at_defaults(LEAP, networks)
    assert list(found) == ["raw", "dexgen", "dexflex, 36 candidates", "dexflex, 64 candidates"]
    assert set(latency.measure(LEAP, found, 1)) == set(found)


def test_the_grid_counts_the_draft_among_the_candidates(networks, monkeypatch):
    seen = {}
    monkeypatch.setattr(
        latency, "measure", lambda hand, made, steps: seen.update(made) or dict.fromkeys(made)
    )
    assert set(latency.grid(LEAP, networks, 1, (4, 7), (1, 2))) == {(4, 1), (4, 2), (7, 1), (7, 2)}
    for name, interface in seen.items():
        assert isinstance(interface, DexFlexInterface)
        settings = interface.settings
        assert name == f"{settings.n_candidates} {settings.nfe}"


def test_without_a_shipped_controller_random_weights_are_timed_and_a_named_one_must_exist(
    networks, monkeypatch, tmp_path
):
    assert networks.trained
    monkeypatch.setattr("lerobot_dexflex.interfaces.controller_folder.SHIPPED", tmp_path / "nowhere")
    assert not latency.load_networks(LEAP).trained
    with pytest.raises(DexFlexError, match="No controller for"):
        latency.load_networks(LEAP, str(tmp_path / "named"))
