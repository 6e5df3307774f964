import json

import pytest

from lerobot_dexflex.evaluation.latency import CANDIDATES, EVALUATIONS
from lerobot_dexflex.evaluation.reach.cells import Cell
from lerobot_dexflex.interfaces import INTERFACES, Method


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("degraded_commands")


def test_default_names_are_methods_and_cells(script):
    variants = (*script.ABLATION_METHODS, *script.GRID_METHODS)
    for name in (*script.METHODS.split(","), *variants, *script.DEMO["methods"].split(",")):
        Method.parse(name)
    for name in (*script.CELLS.split(","), *script.DEMO["cells"].split(",")):
        assert Cell.parse(name).name == name
    assert tuple(name.split("-")[1] for name in script.ABLATION_METHODS) == tuple(
        INTERFACES["dexflex"].ablations
    )


def test_progress_of_the_grid_is_found_by_candidates_and_evaluations(script, load_script, tmp_path):
    families = {name: {"progress": {"mean": k / 10}} for k, name in enumerate(script.GRID_METHODS)}
    result = tmp_path / "degraded_grid.json"
    bench = load_script("bench")
    assert bench.grid_progress(result) == {}
    result.write_text(json.dumps({"families": families}))
    keys = [(count, evaluations) for count in (4, 16, 64) for evaluations in (1, 4)]
    assert bench.grid_progress(result) == {key: k / 10 for k, key in enumerate(keys)}
    assert set(keys) <= {(count, evaluations) for count in CANDIDATES for evaluations in EVALUATIONS}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "magic"], "Unknown interface 'magic'"),
        (["--cells", "rain_2mm"], "'rain_2mm'|rain"),
        (["--workers", "-1"], "must not be negative"),
        (["--methods", "raw", "--episodes", "0"], "must be at least 1"),
        (["--methods", "dexflex", "--controller", "/nowhere"], "No controller at"),
    ],
)
def test_mistakes_are_one_line_and_status_2_before_anything_runs(
    script, tmp_path, capsys, arguments, message
):
    folders = ["--output", str(tmp_path / "out"), "--chains", str(tmp_path / "chains")]
    assert script.main([*arguments, *folders]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert any(part in printed for part in message.split("|"))
    assert not (tmp_path / "out").exists()
