import pytest

from lerobot_dexflex.evaluation.degraded.cells import Cell
from lerobot_dexflex.evaluation.degraded.methods import ABLATIONS, Method


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("degraded_commands")


def test_default_names_are_methods_and_cells(script):
    for name in (*script.METHODS.split(","), *script.ABLATION_METHODS, *script.DEMO["methods"].split(",")):
        Method.parse(name)
    for name in (*script.CELLS.split(","), *script.DEMO["cells"].split(",")):
        assert Cell.parse(name).name == name
    assert tuple(name.split("-")[1] for name in script.ABLATION_METHODS) == ABLATIONS


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "magic"], "Unknown method 'magic'"),
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
