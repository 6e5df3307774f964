import pytest

from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.reach import bounds
from lerobot_dexflex.interfaces import Method


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("degraded_commands")


def test_default_names_are_methods_and_conditions(script):
    ours = [name for name in script.METHODS.split(",") if name not in ("projection", "dexgen", "dexflex")]
    assert {bounds.FORCES, bounds.OPERATOR} <= {*ours}
    for name in (*ours, *script.DEMO_METHODS.split(",")):
        assert Method.parse(name).name == name
    for name in (*script.CONDITIONS.split(","), *script.DEMO_CONDITIONS.split(",")):
        assert Condition.parse(name).name == name


def test_both_sources_meet_the_same_errors(script):
    found = [Condition.parse(name) for name in script.CONDITIONS.split(",")]
    motion, pressing = ([c.errors for c in found if c.source == s] for s in ("motion", "pressing"))
    assert motion == pressing
    assert len(motion) == 7


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods=magic"], "'magic'"),
        (["--methods=raw", "--conditions=rain_2mm"], "rain"),
        (["--workers=-1"], "`workers` must not be negative"),
        (["--episodes=-1"], "`episodes` must not be negative"),
        (["--methods=raw", "--group=0"], "`group` must be at least 1"),
        (["--methods=raw", "--conditions=heavy"], "no heavy hand"),
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


def test_progress_of_the_grid_is_found_by_candidates_and_evaluations(script, load_script, tmp_path):
    table = tmp_path / "reach.csv"
    rows = [f"{name},{k / 10}" for k, name in enumerate(script.GRID_METHODS)]
    table.write_text("\n".join(["method,progress", "dexflex,0.9", *rows]))
    found = load_script("bench").grid_progress(table)
    cells = [(count, evaluations) for count in (4, 16, 64) for evaluations in (1, 4)]
    assert found == {cell: k / 10 for k, cell in enumerate(cells)}
