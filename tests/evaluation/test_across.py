import json

import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.across import across
from lerobot_dexflex.evaluation.report.table import across_markdown, paired_sentence


def result(**successes):
    """Return what a comparison file holds of these episodes."""
    rows = [
        {"interface": name, "episode": k, "success": bool(value), "progress_max": value}
        for name, values in successes.items()
        for k, value in enumerate(values)
    ]
    count = len(next(iter(successes.values())))
    return {
        "config_hash": "x",
        "n_episodes": count,
        "per_interface": dict.fromkeys(successes),
        "episodes": rows[::-1],
    }


def test_rates_and_tests_over_tasks_are_those_of_all_episodes_together():
    found = across(
        {
            "pour": result(raw=[0, 0, 0, 1], dexflex=[1, 1, 1, 1]),
            "hang": result(raw=[1, 0, 0, 1], dexflex=[1, 1, 0, 0]),
        }
    )
    assert found["success"]["raw"]["pour"]["n_success"] == 1
    assert found["success"]["raw"]["average"]["n_success"] == 3
    assert found["success"]["dexflex"]["average"]["pc_success"] == 75
    (test,) = found["pairwise"]
    assert (test["only_first"], test["only_second"]) == (1, 4)
    # Two-sided binomial test of 1 in 5: 2 (1 + 5) / 2^5.
    assert test["p_value"] == test["p_value_holm"] == pytest.approx(12 / 32)
    assert found["progress"]["raw"]["mean"] == pytest.approx(3 / 8)
    text = across_markdown(found)
    assert "| `raw` | 25 % [5, 70] | 50 % [15, 85] | 38 % [14, 69] |" in text
    assert "4 paired episodes per cell" in text
    assert text.endswith("(Holm): all pairs p ≥ 0.38.")


def test_a_sentence_names_the_pairs_that_differ_and_bounds_the_others():
    def pair(second, p):
        return {"first": "raw", "second": second, "p_value_holm": p}

    assert paired_sentence([pair("hold", 0.001), pair("clip", 0.3), pair("joint", 0.051)]) == (
        "raw against hold p = 0.001, all other pairs p ≥ 0.051"
    )
    assert paired_sentence([pair("hold", 0.049)]) == "raw against hold p = 0.049"
    assert paired_sentence([]) == ""


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (result(raw=[1, 0], dexflex=[1, 0]), "differ in episodes per interface"),
        (result(raw=[1], filter=[1]), "differ in interfaces"),
    ],
)
def test_comparisons_that_do_not_match_have_no_average(other, message):
    with pytest.raises(DexFlexError, match=message):
        across({"pour": result(raw=[1], dexflex=[1]), "hang": other})


def test_nothing_has_no_average():
    with pytest.raises(DexFlexError, match=r"give one or more comparison\.json"):
        across({})


def test_the_command_writes_the_average_and_refuses_what_is_no_comparison(load_script, tmp_path, capsys):
    script = load_script("across_tasks")
    (tmp_path / "pour.json").write_text(json.dumps(result(raw=[1, 0], dexflex=[1, 1])))
    assert script.main([str(tmp_path / "pour.json"), "--output", str(tmp_path / "all.json")]) == 0
    assert json.loads((tmp_path / "all.json").read_text())["columns"] == ["pour", "average"]
    (tmp_path / "hang.json").write_text(json.dumps(result(raw=[0, 1], dexflex=[0, 1])))
    assert (
        script.main([f"heavy={tmp_path}/pour.json,{tmp_path}/hang.json", "--output", f"{tmp_path}/2.json"])
        == 0
    )
    pooled = json.loads((tmp_path / "2.json").read_text())
    assert (pooled["columns"], pooled["n_episodes"]) == (["heavy", "average"], 4)
    assert pooled["success"]["dexflex"]["heavy"]["n_success"] == 3
    assert pooled["pairwise"][0]["only_second"] == 1  # Episodes are paired within their file.
    assert script.main([f"heavy={tmp_path}/pour.json,{tmp_path}/nothing.json"]) == 2
    (tmp_path / "other.json").write_text("{}")
    assert script.main([str(tmp_path / "other.json")]) == 2
    assert script.main([str(tmp_path / "nothing.json")]) == 2
    assert "other.json is no comparison" in capsys.readouterr().err


def test_of_many_interfaces_only_the_last_ones_tests_are_told():
    names = ("joint", "raw", "filter", "shrink", "dexgen", "dexflex")
    found = across({"pour": result(**{name: [int(name == "dexflex")] * 40 for name in names})})
    sentence = across_markdown(found).rpartition("(Holm): ")[2]
    # 40 to 0, two-sided: 2 / 2^40, times all 15 pairs.
    assert sentence.count("against dexflex p = 2.7e-11") == 5
    assert "all other pairs" not in sentence
    found = across({"pour": result(**{name: [int(name == "dexflex")] * 40 for name in names[1:]})})
    assert "all other pairs p = 1" in across_markdown(found)
