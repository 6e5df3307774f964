import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.record import Record
from lerobot_dexflex.evaluation.reach.summary import FAMILIES, default_reference, summarise
from lerobot_dexflex.runs.statistics import rank_test

METRICS = ("duration", "progress", "goals", "intent", "intent_alive", "intervention", "retention")
SPLITS = ("intent_event", "intent_calm", "intervention_event", "intervention_calm")


def record(method, cell, episode, progress):
    metrics: dict[str, float | None] = dict.fromkeys((*METRICS, *SPLITS))
    metrics.update(dict.fromkeys(METRICS, float(progress)))
    return Record(
        method, cell, episode, episode, "", "", (0, 9), 50, progress < 0.5, metrics, None, None, None
    )


def records(table):
    """From {(method, cell): progress per episode}."""
    return [record(m, c, k, value) for (m, c), values in table.items() for k, value in enumerate(values)]


def test_every_family_counts_the_same_however_many_cells_it_has():
    cells = ["noise_1mm", "noise_2mm", "removal_2mm", "scale_0.5", "clean"]
    values = dict(zip(cells, (0.8, 0.4, 0.2, 1.0, 1.0), strict=True))
    found = summarise(records({("raw", c): [v, v] for c, v in values.items()}), ["raw"], cells)
    # Noise (0.8 + 0.4) / 2, removal 0.2; the control and clean are no degradation.
    assert found[FAMILIES]["raw"]["progress"]["mean"] == pytest.approx((0.6 + 0.2) / 2)
    assert found["averaged_cells"] == ["noise_1mm", "noise_2mm", "removal_2mm"]
    assert found["cells"]["noise_2mm"]["raw"]["drops"] == 2


def test_the_reference_is_tested_on_the_episodes_that_both_ran():
    table = {
        ("raw", "noise_1mm"): np.linspace(0.1, 0.5, 8),
        ("dexflex", "noise_1mm"): np.linspace(0.3, 0.7, 8),
    }
    table |= {("oracle", "noise_1mm"): [1.0] * 3, ("dexflex@0.7", "noise_1mm"): np.linspace(0.3, 0.7, 8)}
    found = summarise(records(table), ["raw", "dexflex", "oracle", "dexflex@0.7"], ["noise_1mm"])
    assert found["reference"] == "dexflex"
    tests = {(t["cell"], t["method"]): t for t in found["tests"]}
    assert {m for _, m in tests} == {"raw", "dexflex@0.7"}  # Upper bounds are not tested against.
    test = tests["noise_1mm", "raw"]
    assert test["gain"]["mean"] == pytest.approx(0.2)
    assert test["p_value"] == pytest.approx(2 / 2**8)  # Exact: all 8 signs agree.
    assert tests["noise_1mm", "dexflex@0.7"]["p_value"] == 1.0
    assert test["p_value_holm"] == test["p_value"]  # Alone in its family: variants are another.


def test_holm_counts_the_baselines_of_a_cell():
    ours = np.linspace(0.3, 0.7, 8)
    table = {(m, "clean"): ours - 0.1 * k for k, m in enumerate(("dexflex", "raw", "hold", "filter"))}
    found = summarise(records(table), ["dexflex", "raw", "hold", "filter"], ["clean"])
    assert [t["p_value_holm"] for t in found["tests"]] == pytest.approx([3 * 2 / 2**8] * 3)


def test_missing_episodes_are_refused_and_not_averaged_over():
    with pytest.raises(DexFlexError, match="none at all"):
        summarise(records({("raw", "clean"): [1.0]}), ["raw", "hold"], ["clean"])
    with pytest.raises(DexFlexError, match="gaps"):
        summarise([record("raw", "clean", 1, 1.0)], ["raw"], ["clean"])
    with pytest.raises(DexFlexError, match="none of the methods"):
        summarise(records({("raw", "clean"): [1.0]}), ["raw"], ["clean"], reference="dexflex")


def test_the_default_reference_is_ours_without_an_ablation():
    assert default_reference(["raw", "dexflex-notouch", "dexflex@0.7", "dexflex"]) == "dexflex"
    assert default_reference(["raw", "dexflex-notouch", "dexflex@0.7"]) == "dexflex@0.7"
    assert default_reference(["hold", "raw"]) == "hold"


def test_equal_numbers_are_no_difference_and_unequal_lengths_no_pairs():
    assert rank_test([0.5, 0.7], [0.5, 0.7]).p_value == 1.0
    with pytest.raises(DexFlexError, match="equal length"):
        rank_test([0.5], [0.5, 0.7])
