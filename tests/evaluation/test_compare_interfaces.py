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
            "Unknown interface 'telepathy' in 'telepathy'. Valid: joint, raw, filter",
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
        (["--backbone", "x", "--policy", "raw=y"], "Give one of --operator, --backbone, which serves all"),
        (["--operator", "--policy", "raw=y"], "Give one of --operator, --backbone"),
        (["--operator", "--interfaces", "joint"], "one that reads drafts: raw, filter"),
        (["--command-removal", "-1"], "`command_removal` must be 0 or more [m]. Got -1.0"),
        (
            ["--interfaces", "dexgen@4"],
            "An interface's gain must be in (0, 1], as in dexgen@0.4. Got 'dexgen@4'",
        ),
        (["--interfaces", "joint@0.5"], "Only displacements can be scaled; 'joint' executes joint targets."),
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
