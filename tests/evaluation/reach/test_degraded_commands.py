import pandas as pd
import pytest

from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.latency import CANDIDATES, EVALUATIONS
from lerobot_dexflex.interfaces import INTERFACES, Method


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("degraded_commands")


def test_default_names_are_methods_and_conditions(script):
    variants = (*script.ABLATION_METHODS, *script.GRID_METHODS)
    for name in (*script.METHODS.split(","), *variants, *script.DEMO_METHODS.split(",")):
        Method.parse(name)
    for name in (*script.CONDITIONS.split(","), *script.DEMO_CONDITIONS.split(",")):
        assert Condition.parse(name).name == name
    ablations = tuple(INTERFACES["dexflex"].ablations)
    assert tuple(name.split("-")[1] for name in script.ABLATION_METHODS) == ablations


def test_progress_of_the_grid_is_found_by_candidates_and_evaluations(script, load_script, tmp_path):
    bench = load_script("bench")
    table = tmp_path / "reach.csv"
    assert bench.grid_progress(table) == {}
    rows = [(name, k / 10 + shift) for k, name in enumerate(script.GRID_METHODS) for shift in (-0.1, 0.1)]
    pd.DataFrame([*rows, ("raw", 0.2)], columns=pd.Index(["method", "progress"])).to_csv(table)
    keys = [(count, evaluations) for count in (4, 16, 64) for evaluations in (1, 4)]
    assert bench.grid_progress(table) == pytest.approx({key: k / 10 for k, key in enumerate(keys)})
    assert set(keys) <= {(count, evaluations) for count in CANDIDATES for evaluations in EVALUATIONS}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods=magic"], "'magic'"),
        (["--conditions=rain_2mm"], "rain"),
        (["--workers=-1"], "`workers` must not be negative"),
        (["--episodes=-1"], "`episodes` must not be negative"),
        (["--methods=raw", "--group=0"], "`group` must be at least 1"),
        (["--methods=dexflex", "--controller=/nowhere"], "No controller at"),
    ],
)
def test_mistakes_are_one_line_and_status_1_before_anything_runs(
    script, tmp_path, capsys, arguments, message
):
    folders = [f"--output={tmp_path / 'out'}", f"--chains={tmp_path / 'chains'}"]
    assert script.main([*arguments, *folders]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert message in printed
    assert list(tmp_path.iterdir()) == []
