import pandas as pd
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.trainings import across_trainings, markdown
from lerobot_dexflex.runs.statistics import rank_test

OURS, BLIND = [0.9, 0.8, 0.7, 0.9, 0.6, 0.8], [0.8, 0.7, 0.7, 0.5, 0.5, 0.6]


def table(better, ours=OURS, blind=BLIND, condition="clean"):
    """Rows of one training; `better` is added to every progress of ours."""
    values = {"dexflex": [value + better for value in ours], "dexflex-notouch": blind}
    return pd.DataFrame(
        {"method": method, "condition": condition, "seed": seed, "progress": progress}
        for method, series in values.items()
        for seed, progress in enumerate(series)
    )


def test_progress_is_averaged_over_trainings_before_episodes_are_compared():
    ours, blind = across_trainings([table(0.0), table(0.1)])
    assert (ours.method, blind.method) == ("dexflex", "dexflex-notouch")
    mean = sum(OURS) / 6
    assert ours.means == pytest.approx((mean, mean + 0.1))
    assert ours.together.mean == pytest.approx(mean + 0.05)
    assert ours.gain is None
    expected = rank_test(BLIND, [value + 0.05 for value in OURS])
    assert blind.gain is not None
    assert blind.gain.mean == pytest.approx(expected.gain.mean)
    assert blind.p_value == pytest.approx(expected.p_value)
    assert blind.together.n == 6


def test_p_values_are_adjusted_within_a_condition():
    third = table(0.0).replace("dexflex-notouch", "dexflex-noslow").query("method != 'dexflex'")
    tables = [pd.concat([table(0.0), third]), pd.concat([table(0.1), third])]
    cells = across_trainings(tables)
    alone = across_trainings([table(0.0), table(0.1)])[1]
    assert alone.p_value is not None
    assert [cell.p_value for cell in cells[1:]] == pytest.approx([2 * alone.p_value] * 2)


def test_what_one_training_lacks_is_left_out():
    short = table(0.0).query("seed < 4")
    cells = across_trainings([table(0.0), short, pd.concat([table(0.0, condition="noise_2mm"), short])])
    assert [(cell.condition, cell.together.n, len(cell.means)) for cell in cells] == [("clean", 4, 3)] * 2
    lines = markdown(cells).splitlines()
    assert lines[0].count("training") == 3
    assert len(lines) == 4


def test_one_training_or_no_shared_episode_is_refused():
    with pytest.raises(DexFlexError, match="two tables"):
        across_trainings([table(0.0)])
    with pytest.raises(DexFlexError, match="share no episodes of 'raw'"):
        across_trainings([table(0.0), table(0.0)], "raw")
