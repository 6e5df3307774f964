"""From rows to rates, averages, tests and LeRobot's form of them, by hand."""

import json

import pandas as pd
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.report.table import (
    markdown,
    pair_rows,
    pairs_sentence,
    rate_rows,
    selectivity_rows,
)
from lerobot_dexflex.evaluation.summary import AVERAGE, grown, newest, summarise, write_eval_info

A, B = "PourCup-v0", "PlaceHammer-v0"


def episodes(method, successes, task=A, condition="clean", first=0, version=None):
    """One row per character of `successes`: 1 is a success after 10 s, 0 a time out, d a drop."""
    return pd.DataFrame(
        [
            {
                "method": method,
                "version": version or method,
                "task": task,
                "condition": condition,
                "seed": first + k,
                "success": letter == "1",
                "steps": 200,
                "seconds": 10.0,
                "progress": 1.0 if letter == "1" else 0.5,
                "progress_final": 0.5,
                "drops": int(letter == "d"),
                "holding": 0.5,
                "intervention": None,
            }
            for k, letter in enumerate(successes)
        ]
    )


def test_rates_are_averaged_over_tasks_with_equal_numbers():
    rows = pd.concat([episodes("raw", "1111"), episodes("raw", "1000", B)])
    summary = summarise(rows, ["raw"])
    assert summary.columns == (A, B, AVERAGE)
    assert [summary.rates["raw", c].n_success for c in summary.columns] == [4, 1, 5]
    assert summary.rates["raw", AVERAGE].n_episodes == 8
    unequal = summarise(pd.concat([rows, episodes("raw", "1", B, first=4)]), ["raw"])
    assert ("raw", AVERAGE) not in unequal.rates
    assert rate_rows(unequal) == [["raw", "100 % [51, 100], n = 4", "40 % [12, 77], n = 5", "-"]]


def test_conditions_stand_side_by_side_with_their_tasks_pooled():
    rows = pd.concat(
        [
            episodes("raw", "11", A, "heavy"),
            episodes("raw", "10", B, "heavy"),
            episodes("raw", "00", A, "pushed"),
        ]
    )
    summary = summarise(rows, ["raw"], "condition", ["pushed", "heavy"])
    assert [summary.rates["raw", c].n_success for c in ("pushed", "heavy")] == [0, 3]
    assert summary.rates["raw", "heavy"].n_episodes == 4


def test_methods_are_tested_on_the_episodes_that_both_ran():
    rows = pd.concat([episodes("raw", "000000", first=2), episodes("dexflex", "1111110")])
    summary = summarise(rows, ["raw", "dexflex"])
    (test,) = summary.tests
    # Seeds 2 to 6: dexflex solved 4 that raw did not: p = 2 / 2^4.
    assert (test.n_episodes, test.only_first, test.only_second) == (5, 0, 4)
    assert test.p_value == pytest.approx(2 / 16)
    gain = summary.progress_gain(test)
    assert gain is not None
    assert gain.mean == pytest.approx(0.5 * 4 / 5)
    assert test.e_value is None


def test_methods_without_a_common_episode_are_not_tested():
    rows = pd.concat([episodes("raw", "00"), episodes("dexflex", "11", first=2)])
    summary = summarise(rows, ["raw", "dexflex"])
    assert summary.tests == ()
    assert "McNemar" not in markdown(summary, "x")


def test_holm_is_over_all_pairs():
    rows = pd.concat([episodes("a", "111111"), episodes("b", "000000"), episodes("c", "111000")])
    tests = {(t.first, t.second): t for t in summarise(rows, ["a", "b", "c"]).tests}
    # p = 2/2^6, 2/2^3, 2/2^3; sorted times 3, 2, 1 and monotone.
    assert tests["a", "b"].p_value_holm == pytest.approx(3 * 2 / 64)
    assert tests["a", "c"].p_value_holm == tests["b", "c"].p_value_holm == pytest.approx(0.5)


def test_an_e_value_stands_beside_the_test_where_n_grew():
    rows = pd.concat([episodes("raw", "0" * 8), episodes("dexflex", "1" * 8)])
    origins = pd.DataFrame(
        [
            {"version": "dexflex", "method": "dexflex", "command": command, "commit": "c"}
            for command in ("--episodes=4", "--episodes=8")
        ]
        + [{"version": "raw", "method": "raw", "command": "--episodes=8", "commit": "c"}]
    )
    assert grown(origins) == {"dexflex"}
    summary = summarise(rows, ["raw", "dexflex"], grew=grown(origins))
    (test,) = summary.tests
    # a = 1, 8 of 8: 2^8 / 9.
    assert test.e_value == pytest.approx(256 / 9)
    assert test.p_anytime_holm == pytest.approx(9 / 256)
    assert pair_rows(summary)[0][-2:] == ["28.4", "0.0352"]
    assert pairs_sentence(summary) == (
        "raw against dexflex p = 0.0078. These episodes come from more than one command; E-values, valid "
        "also if some were added after a look (Holm): raw against dexflex p = 0.035."
    )


def test_the_version_that_was_appended_last_counts():
    rows = pd.concat(
        [
            episodes("raw", "00", version="old"),
            episodes("raw", "11", B, version="old"),
            episodes("raw", "1", version="new"),
        ]
    )
    found = newest(rows)
    assert found.groupby("task", sort=False)["version"].unique().map(list).to_dict() == {
        B: ["old"],
        A: ["new"],
    }


def test_only_successes_have_a_time_and_missing_numbers_no_mean():
    summary = summarise(episodes("raw", "10d"), ["raw"])
    assert summary.mean("raw", "completion_time") == (10.0, None, 1)
    assert summary.mean("raw", "intervention") is None
    drops = summary.mean("raw", "drops")
    assert drops is not None
    assert drops.mean == pytest.approx(1 / 3)


def test_changes_at_contacts_stand_beside_those_in_calm_where_drafts_were_changed():
    rows = pd.concat([episodes("raw", "10"), episodes("dexflex", "10")])
    assert selectivity_rows(summarise(rows, ["raw", "dexflex"])) == []  # Rows of before these columns.
    for column, values in {"change_event": (0, 0, 3, 1), "change_calm": (0, 0, 1, 0)}.items():
        rows[column] = rows[column.replace("change", "intervention")] = [float(value) for value in values]
    [row] = selectivity_rows(summarise(rows, ["raw", "dexflex"]))
    assert row[0] == "dexflex"
    assert [cell.split()[0] for cell in row[1:4]] == ["2.00", "0.50", "4.0"]


def test_a_method_without_episodes_is_refused():
    with pytest.raises(DexFlexError, match="no episodes of telepathy"):
        summarise(episodes("raw", "10"), ["raw", "telepathy"])


def test_rates_are_written_as_lerobot_names_them(tmp_path):
    rows = pd.concat([episodes("raw", "10"), episodes("raw", "11", B), episodes("dexflex", "11", B)])
    write_eval_info(rows, tmp_path / "summary.json")
    info = json.loads((tmp_path / "summary.json").read_text())
    assert set(info) == {"per_task", "per_group", "overall"}
    group = info["per_group"]["raw clean"]
    assert (group["n_success"], group["n_episodes"], group["pc_success"]) == (3, 4, 75.0)
    assert len(group["pc_success_ci95"]) == 2
    assert info["overall"]["n_success"] == 5
    first = info["per_task"][0]
    assert (first["task_group"], first["task_id"], first["task"]) == ("raw clean", 0, A)
    assert first["metrics"]["successes"] == [True, False]
    assert first["metrics"]["seeds"] == [0, 1]
