"""Rows of several trainings, by hand."""

import importlib.util
from pathlib import Path

import pandas as pd
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.report import plots
from lerobot_dexflex.evaluation.report.trainings import markdown
from lerobot_dexflex.evaluation.trainings import over_trainings, pool, read_trainings

A, B = "PourCup-v0", "PlaceHammer-v0"
LIMITS = {A: 20.0, B: 15.0}


def episodes(training, method, successes, task=A, condition="clean"):
    """One row per character of `successes`: 1 is a success after 10 s, 0 a time out, d a drop after 2 s."""
    seconds = {"1": 10.0, "0": LIMITS[task], "d": 2.0}
    return pd.DataFrame(
        {
            "method": method,
            "version": f"{method}{training}",
            "task": task,
            "condition": condition,
            "seed": seed,
            "success": letter == "1",
            "steps": int(20 * seconds[letter]),
            "seconds": seconds[letter],
            "progress": 1.0,
            "progress_final": 1.0,
            "drops": int(letter == "d"),
            "holding": 0.25 if letter == "d" else 0.75,
            "intervention": None,
        }
        for seed, letter in enumerate(successes)
    )


def two_trainings():
    first = [episodes(0, "raw", "00d1"), episodes(0, "dexflex", "1101")]
    second = [episodes(1, "raw", "0000"), episodes(1, "dexflex", "1110")]
    return {"tasks.csv": pd.concat(first), "tasks_seed1.csv": pd.concat(second)}


def test_pairs_are_of_the_same_training():
    found = over_trainings(two_trainings(), ["raw", "dexflex"])
    (pair,) = found.pairs
    # Seeds 0, 1 of training 0 and 0, 1, 2 of training 1: p = 2 / 2^5.
    assert (pair.test.n_episodes, pair.test.only_first, pair.test.only_second) == (8, 0, 5)
    assert pair.test.p_value == pair.test.p_value_holm == pytest.approx(2 / 32)
    assert pair.each == (50.0, 75.0)
    assert pair.gain.mean == 62.5
    rate = found.summary.rates["dexflex", A]
    assert (rate.n_success, rate.n_episodes) == (6, 8)
    assert found.methods[0].success == (25.0, 0.0)


def test_the_gain_is_the_average_over_tasks_whatever_their_episodes():
    tables = {
        name: pd.concat([rows, episodes(k, "raw", "01", B), episodes(k, "dexflex", "01", B)])
        for k, (name, rows) in enumerate(two_trainings().items())
    }
    (pair,) = over_trainings(tables, ["raw", "dexflex"]).pairs
    assert pair.gain.mean == pytest.approx((62.5 + 0) / 2)
    assert pair.each == (25.0, 37.5)


def test_failures_count_as_the_limit_of_the_task_even_if_a_drop_ended_them():
    raw, ours = over_trainings(two_trainings(), ["raw", "dexflex"]).methods
    assert raw.time.mean == pytest.approx((10 + 7 * 20) / 8)
    assert ours.time.mean == pytest.approx((6 * 10 + 2 * 20) / 8)
    assert (raw.median, ours.median) == (None, 10.0)
    assert raw.drops is not None
    assert raw.drops.mean == pytest.approx(1 / 8)
    assert raw.holding is not None
    assert raw.holding.mean == pytest.approx((7 * 0.75 + 0.25) / 8)


def test_what_a_task_does_not_report_has_no_mean():
    tables = {name: rows.assign(drops=None) for name, rows in two_trainings().items()}
    assert over_trainings(tables, ["raw"]).methods[0].drops is None


def test_an_episode_beyond_the_limit_is_of_another_task():
    tables = {name: rows.assign(seconds=20.05) for name, rows in two_trainings().items()}
    with pytest.raises(
        DexFlexError, match=r"raw in PourCup-v0, clean took 20.05 s, seed 0; the limit is 20 s"
    ):
        over_trainings(tables, ["raw"])


def test_cells_that_one_training_lacks_are_named():
    tables = two_trainings()
    tables["tasks_seed1.csv"] = tables["tasks_seed1.csv"].query("method != 'dexflex' or seed < 1")
    message = "tasks_seed1.csv lacks .* of dexflex in PourCup-v0, clean: 3 of 4 episodes, seeds 1 to 3. Run"
    with pytest.raises(DexFlexError, match=message):
        over_trainings(tables, ["raw", "dexflex"])
    assert over_trainings(tables, ["raw"]).pairs == ()


def test_many_missing_cells_are_counted():
    tables = two_trainings()
    more = [episodes(1, "raw", "0", B, name) for name in ("heavy", "pushed", "noise_2mm", "delay_2")]
    tables["tasks_seed1.csv"] = pd.concat([tables["tasks_seed1.csv"], *more])
    with pytest.raises(
        DexFlexError, match=r"^tasks.csv lacks .*raw in PlaceHammer-v0, heavy.* and of 1 more"
    ):
        pool(tables)


def test_the_same_training_twice_is_refused():
    rows = two_trainings()["tasks.csv"]
    with pytest.raises(
        DexFlexError, match=r"tasks.csv and copy.csv hold the same version raw0 of raw in PourCup"
    ):
        pool({"tasks.csv": rows, "copy.csv": rows})
    with pytest.raises(DexFlexError, match="at least one training"):
        pool({})


def test_letters_come_from_the_adjusted_tests_and_stand_in_table_and_plot():
    outcomes = {"worst": "0" * 20, "best": "1" * 20, "middle": "1" * 9 + "0" * 11, "low": "0" * 15 + "1" * 5}
    rows = pd.concat([episodes(0, name, text) for name, text in outcomes.items()])
    found = over_trainings({"tasks.csv": rows}, list(outcomes))
    # Holm over six: best against all others at most 2 / 2^11 * 4; worst against middle 2 / 2^9 * 3 = 0.012;
    # low against worst 2 / 2^5, against middle 9 to 5: neither.
    assert found.summary.letters == {"best": "a", "middle": "b", "low": "bc", "worst": "c"}
    text = markdown(found)
    assert "| `low` | 25 % [11, 47] | bc |" in text
    assert text.count("One training, 20 rollouts per cell.") == 1
    assert "each training" not in text
    assert text.count(" vs ") == 6
    assert markdown(found, "best").count(" vs ") == 3
    unlettered = over_trainings({"tasks.csv": rows.assign(seed=range(len(rows)))}, list(outcomes)).summary
    assert unlettered.letters == {}
    assert plots.success(found.summary) != plots.success(unlettered)


def test_the_table_script_reads_every_training_of_the_folder(tmp_path):
    path = Path(__file__).parents[2] / "eval/readme_table.py"
    spec = importlib.util.spec_from_file_location("readme_table", path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    for name, rows in two_trainings().items():
        rows.to_csv(tmp_path / name, index=False)
    pd.DataFrame(columns=["version", "method", "command", "commit"]).to_csv(
        tmp_path / "runs.csv", index=False
    )
    view = script.View("raw,dexflex", tasks=A, trainings=True, results=tmp_path)
    text = script.markdown(view)
    assert "| `raw` vs `dexflex` | 0 | 5 | 0.062 |" in text
    assert "| +50, +75 |" in text
    assert "2 trainings, 8 rollouts per cell." in text
    (tmp_path / "tasks_seed1.csv").unlink()
    assert "One training, 4 rollouts per cell." in script.markdown(view)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DexFlexError, match=r"tasks_seed1.csv not found"):
        read_trainings([tmp_path / "tasks_seed1.csv"])
