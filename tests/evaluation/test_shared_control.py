"""The command of the shared-control experiment."""

import pytest

from lerobot_dexflex.commands.levels import LEVELS


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("shared_control")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--level=expert"], f"`level` must be empty or one of {', '.join(LEVELS)}. Got 'expert'."),
        (["--tasks=PourTea-v0"], "Unknown task 'PourTea-v0'"),
        (["--methods=telepathy"], "Unknown interface 'telepathy'"),
        (["--source=squeeze"], "`source` must be one of motion, pressing. Got 'squeeze'"),
        (["--episodes=0"], "`episodes` must be at least 1"),
    ],
)
def test_bad_input_gets_one_clear_line(script, capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert script.main(arguments) == 1
    assert message in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_every_method_meets_the_same_people_on_held_out_seeds(script):
    comparison = script.build(script.Config())
    assert min(comparison.seeds) >= 100_000
    assert comparison.conditions == ("novice",)
    assert comparison.label == "operator-pressing"
    jobs = comparison.jobs(comparison.versions())
    assert {job.task for job in jobs} == set(script.TOOLS)
    assert len(jobs) == len(comparison.players) * len(comparison.methods) * 100
    assert script.build(script.Config(level="", source="motion")).conditions == ("clean",)


def test_an_episode_leaves_a_row_and_a_report(script, tmp_path):
    words = ("--tasks=HammerNail-v0", "--methods=raw", "--episodes=1", "--seed=53000", "--workers=0")
    assert script.main([*words, f"--output={tmp_path}", "--videos=0"]) == 0
    assert "operator-pressing/raw" in (tmp_path / "tasks.csv").read_text()
    assert (tmp_path / "report.html").exists()
