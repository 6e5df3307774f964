from pathlib import Path

import pytest

from lerobot_dexflex.envs.registration import TASKS


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("compare_interfaces")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "PourTea-v0"], f"Unknown task 'PourTea-v0'. Valid tasks: {', '.join(TASKS)}."),
        (
            ["--interfaces", "joint", "telepathy"],
            "Unknown interface 'telepathy'. Valid interfaces: joint, raw, filter",
        ),
        (
            ["--joint-policy", "/nowhere"],
            "No joint checkpoint at /nowhere: config.json, model.safetensors not found",
        ),
        (["--workers", "-1"], "`--workers` must not be negative. Got -1."),
        (["--episodes", "0"], "`episodes` must be at least 1. Got 0."),
        (["--policy", "dexflex"], "must look like dexflex=<folder pretrained_model>. Got 'dexflex'"),
        (["--policy", "telepathy=x"], "Unknown interface 'telepathy'"),
        (["--policy", "raw=x", "--policy", "raw=y"], "`--policy` is given twice for raw: x and y"),
        (["--policy", "raw=/nowhere"], "No draft checkpoint at /nowhere"),
        (["--backbone", "x", "--policy", "raw=y"], "Give --backbone, which serves all interfaces, or"),
        (["--operator", "--policy", "raw=y"], "--operator takes the place of every policy"),
        (["--operator", "--interfaces", "joint"], "one that reads drafts: raw, filter"),
        (["--glove-noise", "0.004"], "--glove-noise needs --operator"),
        (["--disturbance", "windy"], "Unknown disturbance 'windy'. Valid: none, heavy"),
    ],
)
def test_bad_input_gets_one_clear_line(script, capsys, arguments, message):
    assert script.main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error


def test_the_shipped_checkpoints_are_named_after_the_task(script):
    assert script.shipped("PlaceHammer-v0", "draft").parts[-3:] == (
        "policies",
        "checkpoints",
        "place_hammer_draft",
    )


def test_the_demo_suggests_the_command_that_extends_it(script, monkeypatch):
    monkeypatch.setattr(script.sys, "executable", str(Path.cwd() / ".venv/bin/python"))
    assert script.next_command(["--seed", "7", "--demo"]) == (
        ".venv/bin/python eval/compare_interfaces.py --seed 7 --episodes 100"
    )
