import numpy as np
import pandas as pd
import pytest
from degraded_fakes import row

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach import tables
from lerobot_dexflex.evaluation.reach.plots import (
    _curves,
    _gain_curves,
    around_removals,
    bars,
    gains,
    main_methods,
    settings,
)
from lerobot_dexflex.evaluation.reach.summary import FAMILIES, default_reference, family, summarise
from lerobot_dexflex.runs.statistics import rank_test

pytestmark = pytest.mark.usefixtures("learned")


def rows(table):
    """From {(method, condition): progress per episode}."""
    return pd.DataFrame(
        row(method, condition, seed, value, dropped=value < 0.5)
        for (method, condition), values in table.items()
        for seed, value in enumerate(values)
    )


def mean(summary, method, condition, metric="progress"):
    found = summary.mean(method, condition, metric)
    assert found is not None
    return found.mean


def test_conditions_know_their_family_and_controls_have_none():
    names = ["noise_2mm", "scale_1.5", "scale_0.5", "clean", "removal_3mm+pressing", "bias_1mm", "pressing"]
    assert [family(n) for n in names] == ["noise", "scale", None, None, "removal", None, None]
    assert family("noise_2mm+delay_2") is None


def test_every_source_and_kind_of_goals_has_an_average_of_its_own():
    conditions = {"clean": 1.0, "noise_1mm": 0.8, "delay_2": 0.4, "noise_1mm+pressing": 0.6, "verified": 0.9}
    found = summarise(rows({("raw", name): [value] * 2 for name, value in conditions.items()}))
    assert found.averages == ("families", "families+pressing")
    assert found.run == tuple(conditions)
    assert mean(found, "raw", "families") == pytest.approx(0.6)
    assert mean(found, "raw", "families+pressing") == pytest.approx(0.6)
    assert settings(found) == [(), ("pressing",), ("verified",)]
    for setting in settings(found):
        assert bars(found, setting).startswith(b"\x89PNG")


def test_every_family_counts_the_same_however_many_conditions_it_has():
    conditions = ["noise_1mm", "noise_2mm", "removal_2mm", "scale_0.5", "clean"]
    values = dict(zip(conditions, (0.8, 0.4, 0.2, 1.0, 1.0), strict=True))
    found = summarise(rows({("raw", c): [v, v] for c, v in values.items()}))
    # Noise (0.8 + 0.4) / 2, removal 0.2; the control and clean are no degradation.
    assert mean(found, "raw", FAMILIES) == pytest.approx((0.6 + 0.2) / 2)
    assert found.conditions == (FAMILIES, *conditions)
    dropped = dict(zip(tables.drop_header(found), *tables.drop_rows(found), strict=True))
    assert dropped["noise_2mm"].startswith("2/2 ")
    assert FAMILIES not in dropped


def test_the_average_leaves_out_episodes_in_which_a_metric_is_undefined():
    table = rows({("raw", "noise_1mm"): [0.2, 0.4], ("raw", "removal_2mm"): [0.6, 0.8]})
    table.loc[(table["seed"] == 1) & (table["condition"] == "noise_1mm"), "retention"] = None
    found = summarise(table)
    assert mean(found, "raw", FAMILIES) == pytest.approx(0.5)
    assert mean(found, "raw", FAMILIES, "retention") == pytest.approx(0.4)


def test_a_metric_that_no_episode_has_has_no_average():
    table = rows({("raw", "noise_1mm"): [0.2, 0.4], ("press", "noise_1mm"): [0.2, 0.4]})
    table.loc[table["method"] == "raw", "goal_steps"] = None
    found = summarise(table)
    assert found.mean("raw", FAMILIES, "goal_steps") is None
    assert mean(found, "press", FAMILIES, "goal_steps") == pytest.approx(0.3)


def test_the_reference_is_tested_on_the_episodes_that_both_ran():
    table = {
        ("raw", "noise_1mm"): np.linspace(0.1, 0.5, 8),
        ("dexflex", "noise_1mm"): np.linspace(0.3, 0.7, 8),
    }
    table |= {("oracle", "noise_1mm"): [1.0] * 3, ("dexflex@0.7", "noise_1mm"): np.linspace(0.3, 0.7, 8)}
    found = summarise(rows(table))
    assert found.reference == "dexflex"
    tests = {(t.condition, t.method): t for t in found.tests}
    assert {m for _, m in tests} == {"raw", "dexflex@0.7"}  # Upper bounds are not tested against.
    test = tests["noise_1mm", "raw"]
    assert (test.kind, test.n) == ("baseline", 8)
    assert test.gain.mean == pytest.approx(0.2)
    assert test.p_value == pytest.approx(2 / 2**8)  # Exact: all 8 signs agree.
    assert tests["noise_1mm", "dexflex@0.7"].p_value == 1.0
    assert test.p_value_holm == test.p_value  # Alone in its family: variants are another.


def test_holm_counts_the_baselines_of_a_condition():
    ours = np.linspace(0.3, 0.7, 8)
    table = {(m, "clean"): ours - 0.1 * k for k, m in enumerate(("dexflex", "raw", "press", "press:4"))}
    assert [t.p_value_holm for t in summarise(rows(table)).tests] == pytest.approx([3 * 2 / 2**8] * 3)


def test_a_label_before_the_name_does_not_change_what_a_method_is():
    labelled = ("both/dexflex", "tenth/dexflex:levels=0.5/0.75", "both/press", "both/oracle:clean")
    found = summarise(rows({(m, "clean"): [0.5] * 8 for m in labelled}), reference="both/dexflex")
    kinds = {test.method: test.kind for test in found.tests}
    assert kinds == {"tenth/dexflex:levels=0.5/0.75": "variant", "both/press": "baseline"}


def test_missing_and_doubled_episodes_are_refused_and_not_averaged_over():
    whole = rows({("raw", "clean"): [1.0, 1.0]})
    with pytest.raises(DexFlexError, match=r"'press' has 0 episodes .* none at all"):
        summarise(whole, ["raw", "press"], ["clean"])
    gap = pd.concat([whole, rows({("press", "clean"): [1.0, 1.0]}).iloc[1:]])
    with pytest.raises(DexFlexError, match=r"'press' has 1 episodes .* gaps"):
        summarise(gap)
    with pytest.raises(DexFlexError, match="none of the methods: raw"):
        summarise(whole, reference="dexflex")
    with pytest.raises(DexFlexError, match=r"'raw' has several rows .* choose one `version`"):
        summarise(pd.concat([whole, whole.assign(version="other")]))


def test_the_default_reference_is_ours_without_an_ablation():
    assert default_reference(["raw", "dexflex-notouch", "dexflex@0.7", "dexflex"]) == "dexflex"
    assert default_reference(["raw", "dexflex-notouch", "dexflex@0.7"]) == "dexflex@0.7"
    assert default_reference(["press", "raw"]) == "press"


def test_a_figure_shows_one_method_of_each_kind_and_scaled_ones_only_for_want_of_others():
    shown = ["dexflex", "dexgen@0.4", "raw", "press:2", "press:2+blocked=True"]
    methods = ["dexflex@0.7", "dexflex-notouch", *shown, "press:4", "dexflex:force=3"]
    assert main_methods(methods) == shown


def test_progress_over_the_gain_is_drawn_for_methods_that_ran_with_several():
    progress = {"raw": 0.1, "press:2": 0.5, "press:2@0.5": 0.4, "press:4@0.5": 0.3}
    several = rows({(name, "noise_1mm"): [value] * 2 for name, value in progress.items()})
    assert _gain_curves(list(progress))["press:2"] == {1.0: "press:2", 0.5: "press:2@0.5"}
    drawn = gains(summarise(several))
    assert drawn is not None
    assert drawn.startswith(b"\x89PNG")
    assert gains(summarise(several[several["method"] != "press:2"])) is None


def test_tables_show_removals_and_candidates_only_where_there_are_some():
    found = summarise(
        pd.DataFrame(
            [
                row("raw", "removal_2mm", 0, intent_event=0.5, intent_calm=0.1, intervention_event=0.0),
                row("dexflex", "removal_2mm", 0, draft=0.25, pure=0.0, seeded=0.75, finger=0.0),
            ]
        )
    )
    assert [line[:3] for line in tables.split_rows(found)] == [["raw", "removal_2mm", "0.50 / 0.10"]]
    assert tables.branch_rows(found) == [["dexflex", "removal_2mm", "25 %", "0 %", "75 %", "0 %"]]


def test_equal_numbers_are_no_difference_and_unequal_lengths_no_pairs():
    assert rank_test([0.5, 0.7], [0.5, 0.7]).p_value == 1.0
    with pytest.raises(DexFlexError, match="equal length"):
        rank_test([0.5], [0.5, 0.7])


def test_interventions_around_removals_are_drawn_from_what_two_episodes_or_more_tell():
    curves = ["0.10 " * 7 + "nan", "0.30 " * 7 + "nan", "nan " * 7 + "0.50"]
    found = pd.DataFrame(row("dexflex", "removal_2mm", k, around=text) for k, text in enumerate(curves))
    assert _curves(found).shape == (3, 8)
    drawn = around_removals(summarise(found))
    assert drawn is not None
    assert drawn.startswith(b"\x89PNG")
    assert around_removals(summarise(rows({("dexflex", "clean"): [0.5]}))) is None
