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
            ["--policy=/nowhere"],
            "No checkpoint at /nowhere: config.json, model.safetensors",
        ),
        (["--workers=-1"], "`workers` must not be negative. Got -1."),
        (["--episodes=-1"], "`episodes` must not be negative. Got -1."),
        (["--episodes=3", "--batch_size=2"], "fill batches of 2"),
        (["--policies=dexflex"], "must look like dexflex=<folder>,raw=<folder>. Got 'dexflex'"),
        (["--policies=telepathy=x"], "Unknown interface 'telepathy'"),
        (["--policies=raw=x,raw=y"], "`policies` holds raw twice"),
        (["--policies=raw=/nowhere", "--methods=raw"], "No checkpoint at /nowhere"),
        (["--backbone=x", "--policies=raw=y"], "Give one of --operator, --backbone, or our policies"),
        (["--backbone=/nowhere"], "No checkpoint at /nowhere"),
        (["--operator", "--policies=raw=y"], "Give one of --operator, --backbone"),
        (["--operator", "--source=squeeze"], "`source` must be one of motion, pressing. Got 'squeeze'"),
        (["--source=pressing"], "Give --operator=true as well"),
        (["--conditions=typical+novice"], "a person has one level"),
        (["--operator", "--draft=measured"], "Give one of --operator, --backbone"),
        (["--draft=felt"], "`draft` must be measured or commanded. Got 'felt'"),
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
    assert script.shipped("PlaceHammer-v0").parts[-3:] == ("policies", "checkpoints", "place_hammer")


def test_rows_are_labelled_by_who_acts(script, policy_checkpoint):
    ours = {"methods": "raw", "policy": policy_checkpoint}
    assert script.build(script.Config(**ours)).label == ""
    assert script.build(script.Config(**ours, draft="measured")).label == ""
    assert script.build(script.Config(**ours, draft="commanded")).label == "commanded"
    assert script.build(script.Config(methods="raw", operator=True)).label == "operator"
    pressing = script.build(script.Config(methods="joint,raw", operator=True, source="pressing"))
    assert pressing.label == "operator-pressing"
    assert pressing.players["PlaceHammer-v0"].source == "pressing"
    assert script.build(script.Config(**ours, label="glove")).label == "glove"
    assert script.build(script.Config(methods="raw", backbone=policy_checkpoint)).label == "dexflex_flow"


def test_one_policy_serves_all_methods_and_own_ones_come_first(script, policy_checkpoint):
    config = script.Config(policy=policy_checkpoint, draft="commanded", policies="raw=elsewhere")
    players = script.players(config, "PlaceHammer-v0")
    assert [players.checkpoint(name) for name in ("joint", "press")] == [policy_checkpoint] * 2
    assert players.checkpoint("raw") == Path("elsewhere")
    assert players.draft == "commanded"
    assert script.players(script.Config(), "PourCup-v0").checkpoint("raw") == script.shipped("PourCup-v0")


def test_the_demo_suggests_the_command_that_extends_it(script, monkeypatch):
    monkeypatch.setattr(script.sys, "executable", str(Path.cwd() / ".venv/bin/python"))
    assert script.next_command(["--seed=7", "--demo=true"]) == (
        ".venv/bin/python eval/compare_interfaces.py --seed=7 --episodes=100"
    )
