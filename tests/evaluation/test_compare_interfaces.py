from pathlib import Path

import pytest

from lerobot_dexflex.envs.registration import TASKS


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("compare_interfaces")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tasks=PourTea-v0"], f"Unknown task 'PourTea-v0'. Valid tasks: {', '.join(TASKS)}."),
        (["--methods=joint,telepathy"], "Unknown interface 'telepathy'"),
        (
            ["--joint_policy=/nowhere"],
            "No joint checkpoint at /nowhere: config.json, model.safetensors",
        ),
        (["--workers=-1"], "`workers` must not be negative. Got -1."),
        (["--episodes=-1"], "`episodes` must not be negative. Got -1."),
        (["--episodes=3", "--batch_size=2"], "fill batches of 2"),
        (["--policies=dexflex"], "must look like dexflex=<folder>,raw=<folder>. Got 'dexflex'"),
        (["--policies=telepathy=x"], "Unknown interface 'telepathy'"),
        (["--policies=raw=x,raw=y"], "`policies` holds raw twice"),
        (["--policies=raw=/nowhere", "--methods=raw"], "No draft checkpoint at /nowhere"),
        (["--backbone=x", "--policies=raw=y"], "Give one of --operator, --backbone, which serves all"),
        (["--backbone=/nowhere"], "No checkpoint at /nowhere"),
        (["--operator", "--policies=raw=y"], "Give one of --operator, --backbone"),
        (["--operator", "--methods=joint"], "one that reads drafts: raw, press"),
        (["--tasks=PourCup-v0,PlaceHammer-v0", "--backbone=x"], "A policy learned one task"),
        (["--conditions=removal_-1mm"], "Got -0.001"),
        (
            ["--conditions=windy"],
            "Unknown word 'windy' in the condition 'windy'. Valid, joined by `+`:",
        ),
        (["--methods=press@4"], "An interface's gain must be in (0, 1], as in press@0.4. Got 'press@4'"),
        (["--methods=joint@0.5"], "Only drafts can be scaled; 'joint' executes joint targets."),
    ],
)
def test_bad_input_gets_one_clear_line(script, capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert script.main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert not any(tmp_path.iterdir())


def test_the_shipped_checkpoints_are_named_after_the_task(script):
    assert script.shipped("PlaceHammer-v0", "draft").parts[-3:] == (
        "policies",
        "checkpoints",
        "place_hammer_draft",
    )


def test_rows_are_labelled_by_who_acts(script):
    assert script.build(script.Config(methods="raw")).label == ""
    assert script.build(script.Config(methods="raw", operator=True)).label == "operator"
    assert script.build(script.Config(methods="raw", label="glove")).label == "glove"
    folder = script.shipped("PlaceHammer-v0", "draft")
    assert script.build(script.Config(methods="raw", backbone=folder)).label == "dexflex_flow"


def test_the_demo_suggests_the_command_that_extends_it(script, monkeypatch):
    monkeypatch.setattr(script.sys, "executable", str(Path.cwd() / ".venv/bin/python"))
    assert script.next_command(["--seed=7", "--demo=true"]) == (
        ".venv/bin/python eval/compare_interfaces.py --seed=7 --episodes=100"
    )
