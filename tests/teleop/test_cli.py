import os

import pytest

from lerobot_dexflex.recording.recipe import SIMULATED
from lerobot_dexflex.teleop.cli import main
from lerobot_dexflex.teleop.config import TeleopConfig
from lerobot_dexflex.teleop.stream_config import StreamConfig


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task=Hammer"], "Unknown task 'Hammer'. Valid tasks: AssembleTable-v0"),
        (["--task=Reach-v0"], "No expert for task 'Reach-v0'"),
        (
            ["--task=Reach-v0", "--source=rokoko"],
            "Reach-v0 has no arm to lead. Valid tasks: AssembleTable-v0, BrushSweep-v0, "
            "FlipToast-v0, HammerNail-v0, PlaceHammer-v0, PourCup-v0, ScrewNut-v0, Screwdriver-v0, "
            "SpatulaServe-v0.",
        ),
        (["--source=psychic"], "`source` must be one of rokoko, openxr, mediapipe, replay, simulated. Got"),
        (["--interface=telepathy"], "Unknown interface 'telepathy'"),
        (["--interface=dexflex", "--controller=nowhere/at_all"], "nowhere/at_all"),
        (["--view=window"], "`view` must be one of rerun, none. Got 'window'"),
        (["--view=none", "--view_folder=x"], "`view_folder` is for --view=rerun"),
        (["--source=replay"], "--source=replay needs --stream.file=<stored stream>"),
        (["--source=replay", "--stream.file=none.jsonl", "--hands_free"], "none.jsonl cannot be read"),
        (["--source=rokoko", "--realtime=false"], "`realtime` must be true for rokoko"),
        (["--source=rokoko", "--stream.hand=third"], "`hand` must be right or left. Got 'third'"),
        (["--source=openxr", "--stream.labels=selfie"], "--source=openxr does not read --stream.labels"),
        (["--stream.port=5"], "--source=simulated does not read --stream.port. It reads: none."),
        (["--scale=0"], "`scale` must be positive. Got 0.0"),
        (["--thumb_scale=-1"], "`thumb_scale` must be positive. Got -1.0"),
        (["--heading=1000"], "`heading` must be in [-360, 360] degrees. Got 1000.0"),
        (["--time_limit=-2"], "`time_limit` must not be negative; 0 sets none. Got -2.0"),
        (["--simulated.glove=shaky"], "'shaky' is no command error"),
        (["--simulated.source=squeeze"], "`source` must be one of motion, pressing"),
        (["--interface=joint", "--simulated.source=pressing"], "the interface 'joint' reads none"),
        (["--episodes=0"], "`episodes` must be at least 1. Got 0"),
        (["--repo_id=hammer"], "`repo_id` must look like 'user/dataset'"),
        (["--video.crf=99"], "`video.crf` must be in [0, 51]. Got 99"),
        (["--sauce=rokoko"], "--sauce=rokoko"),
    ],
)
def test_bad_input_gets_one_clear_error_and_writes_nothing(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["--root=live", *arguments]) == 1
    error = capsys.readouterr().err
    assert "rror: " in error
    assert message in error
    assert list(tmp_path.iterdir()) == []


def test_keys_need_a_terminal(tmp_path, capsys, monkeypatch):
    with open(os.devnull) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert main([f"--root={tmp_path / 'live'}", "--source=rokoko", "--stream.port=0"]) == 1
    assert "no terminal to press keys in" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_port_that_is_taken_is_told(tmp_path, capsys):
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        port = taken.getsockname()[1]
        arguments = ["--source=rokoko", f"--stream.port={port}", "--hands_free", "--view=none"]
        assert main([f"--root={tmp_path / 'live'}", *arguments]) == 1
    assert f"Cannot listen at UDP port {port}" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_nobody_else_than_a_person_needs_keys():
    assert TeleopConfig(source=SIMULATED).hands_free
    assert not TeleopConfig(source="rokoko").hands_free


def test_the_recipe_holds_plain_values_and_makes_the_same_configuration(tmp_path):
    import draccus
    import yaml

    config = TeleopConfig(source="replay", stream=StreamConfig(file=tmp_path / "x"), root=tmp_path, scale=0.5)
    (tmp_path / "recipe.yaml").write_text(yaml.safe_dump(config.to_dict()))
    assert draccus.parse(TeleopConfig, config_path=tmp_path / "recipe.yaml", args=[]) == config
