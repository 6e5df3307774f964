import dataclasses

import numpy as np
import pytest
from evaluation_fakes import ENV_ID, FakeController, FakePolicies

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.comparison import Comparison, compare
from lerobot_dexflex.evaluation.summary import summarise

INTERFACES = ("good", "lucky", "still")


@pytest.fixture
def comparison(tmp_path):
    return Comparison(ENV_ID, INTERFACES, FakePolicies(), tmp_path / "out", episodes=6, seed=10, videos=0)


def content(result):
    """Everything but when and by whom."""
    return {key: value for key, value in result.items() if key != "provenance"}


def run(comparison, workers=0):
    return compare(comparison, workers, quiet=True)


def elsewhere(comparison, tmp_path, **changes):
    return dataclasses.replace(comparison, output=tmp_path / "elsewhere", **changes)


def test_all_interfaces_meet_the_same_seeds_and_noise(comparison):
    result, outcomes = run(comparison)
    for name in INTERFACES:
        assert [o.seed for o in outcomes if o.interface == name] == [10, 11, 12, 13, 14, 15]
    # Even seeds draw the same speeds under `good` and `lucky`, hence end after the same steps.
    steps = {(o.interface, o.seed): o.steps for o in outcomes}
    assert all(steps["good", seed] == steps["lucky", seed] for seed in (10, 12, 14))
    assert result["seeds"] == [10, 15]


def test_the_summary_holds_the_rates_tests_and_metrics_derived_by_hand(comparison):
    result, _ = run(comparison)
    rates = {name: numbers["n_success"] for name, numbers in result["per_interface"].items()}
    assert rates == {"good": 6, "lucky": 3, "still": 0}
    first = result["pairwise"][0]
    # good vs lucky: 3 discordant pairs, all for `good`: p = 2 / 2^3. The family also has 2 / 2^6 and 2 / 2^3.
    assert (first["only_first"], first["only_second"], first["p_value"]) == (3, 0, 0.25)
    assert result["pairwise"][1]["p_value_holm"] == pytest.approx(3 * 2 / 2**6)
    assert first["p_value_holm"] == pytest.approx(0.5)
    assert result["per_interface"]["lucky"]["drops"]["mean"] == 0.5
    assert result["per_interface"]["lucky"]["endings"] == {"success": 3, "dropped": 3, "time out": 0}
    assert result["per_interface"]["still"]["completion_time"] is None
    # |0 - d| / (|d| + 1e-6) with |d| = 0.001 sqrt(12)
    size = 0.001 * np.sqrt(12)
    assert result["per_interface"]["still"]["intervention"]["mean"] == pytest.approx(
        size / (size + 1e-6), abs=1e-6
    )


def test_an_interrupted_comparison_continues_to_the_same_result(comparison, tmp_path, monkeypatch):
    whole, _ = run(comparison)
    partial = elsewhere(comparison, tmp_path)
    act, calls = FakeController.act, iter(range(10_000))

    def interrupted(self, observation, task):
        if next(calls) == 40:
            raise KeyboardInterrupt
        return act(self, observation, task)

    monkeypatch.setattr(FakeController, "act", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(partial)
    monkeypatch.setattr(FakeController, "act", act)
    finished = len((partial.output / "episodes.jsonl").read_text().splitlines())
    assert 0 < finished < 18
    resumed, _ = run(partial)
    assert content(resumed) == content(whole)
    assert [s["episodes_run"] for s in resumed["provenance"]["sessions"]] == [finished, 18 - finished]


def test_worker_processes_change_no_bit(comparison, tmp_path):
    here, _ = run(comparison)
    workers, _ = run(elsewhere(comparison, tmp_path), workers=2)
    assert content(workers) == content(here)


def test_more_episodes_extend_a_comparison(comparison):
    run(dataclasses.replace(comparison, episodes=2))
    result, outcomes = run(comparison)
    assert len(outcomes) == 18
    assert [s["episodes_run"] for s in result["provenance"]["sessions"]] == [6, 12]


def test_a_group_that_grew_is_run_again(comparison):
    batched = dataclasses.replace(comparison, batch_size=4)
    run(dataclasses.replace(batched, episodes=6))
    result, outcomes = run(dataclasses.replace(batched, episodes=8))
    assert [s["episodes_run"] for s in result["provenance"]["sessions"]] == [18, 12]
    assert sorted(o.episode for o in outcomes if o.interface == "good") == list(range(8))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 11}, "seed: 10 in the folder, 11 now"),
        ({"policies": FakePolicies("b")}, "checkpoint.fake: 'a'"),
    ],
)
def test_another_seed_or_checkpoint_is_refused(comparison, change, named):
    run(dataclasses.replace(comparison, episodes=1))
    with pytest.raises(DexFlexError, match=named):
        run(dataclasses.replace(comparison, **change))


def test_nothing_unpaired_is_compared(comparison):
    _, outcomes = run(comparison)
    with pytest.raises(DexFlexError, match="nothing is paired"):
        summarise(outcomes[:-1], INTERFACES)


@pytest.mark.parametrize(
    "change", [{"episodes": 0}, {"batch_size": 0}, {"seed": -1}, {"interfaces": ("good", "good")}]
)
def test_settings_that_mean_nothing_are_refused(comparison, change):
    with pytest.raises(DexFlexError, match=next(iter(change))):
        dataclasses.replace(comparison, **change)
