import os
import signal
import subprocess
import sys
import time
from typing import Any

import pytest

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.recording import RecordConfig
from lerobot_dexflex.recording.cli import main
from lerobot_dexflex.recording.record import record


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("--task=Hammer", f"Unknown task 'Hammer'. Valid tasks: {', '.join(TASKS)}"),
        ("--task=Reach-v0", "No expert for task 'Reach-v0'"),
        ("--episodes=0", "`episodes` must be at least 1. Got 0"),
        ("--episodes=many", "many"),
        ("--workers=-1", "`workers` must not be negative. Got -1"),
        ("--max_attempts=3", "`max_attempts` (3) must not be below `episodes` (50)"),
        ("--repo_id=hammer", "`repo_id` must look like 'user/dataset'. Got 'hammer'"),
        ("--video.crf=99", "`video.crf` must be in [0, 51]. Got 99"),
        ("--glove=shaky", "'shaky' is no command error. Valid: delay_<steps>"),
        ("--glove=typical+novice", "names typical and novice; a person has one level"),
        ("--source=squeeze", "`source` must be one of motion, pressing. Got 'squeeze'"),
        ("--source=pressing", "the interface 'joint' reads none"),
        ("--interface=telepathy", "Unknown interface 'telepathy'"),
        ("--config_path=missing.yaml", "missing.yaml"),
    ],
)
def test_bad_input_gets_one_clear_error_and_writes_nothing(argument, message, tmp_path, capsys):
    assert main([f"--root={tmp_path / 'x'}", argument]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert not list(tmp_path.iterdir())


def test_an_unknown_flag_is_refused(capsys):
    assert main(["--episode=3"]) == 1
    assert "--episode=3" in capsys.readouterr().err


@pytest.mark.parametrize(
    "recipe",
    [
        "",
        "episodes",
        "[1, 2]",
        "task: [PlaceHammer-v0",
        "task: {a: 1}",
        "episodes: ten",
        "episodes: 2.5",
        "seed: []",
        "glove: [noise_2mm]",
        "glove: much",
        "source: 2",
        "push: perhaps",
        "video: 5",
        "video: {crf: low}",
        "unknown: 1",
        "root: /",
    ],
)
def test_a_recipe_with_wrong_values_gets_one_clear_error(recipe, tmp_path, capsys):
    file = tmp_path / "recipe.yaml"
    file.write_text(recipe)
    status = main([f"--config_path={file}", "--task=Reach-v0", "--repo_id=a/b"])
    assert status == 1
    error = capsys.readouterr().err
    assert "rror: " in error
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.yaml"]


def test_flags_override_the_recipe_file(tmp_path, counting_task):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(f"task: {counting_task}\nepisodes: 5\nworkers: 0\nroot: {tmp_path / 'unused'}\n")
    assert main([f"--config_path={recipe}", "--episodes=1", f"--root={tmp_path / 'count'}"]) == 0
    assert (tmp_path / "count/meta/info.json").is_file()
    assert not (tmp_path / "unused").exists()


def test_a_recorded_dataset_opens_in_lerobots_visualiser_offline(tmp_path, counting_task, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.scripts.lerobot_dataset_viz import main as visualise

    root = tmp_path / "count"
    record(RecordConfig(task=counting_task, episodes=2, root=root, workers=0), [])
    arguments = f"--repo-id lerobot-dexflex/count --root {root} --episode-index 1 --save 1 --num-workers 0"
    monkeypatch.setattr(sys, "argv", ["viz", *arguments.split(), "--output-dir", str(tmp_path / "viz")])
    visualise()
    assert (tmp_path / "viz/lerobot-dexflex_count_episode_1.rrd").stat().st_size > 10_000


def test_ctrl_c_keeps_the_finished_episodes_of_real_workers_loadable(tmp_path):
    root, staging = tmp_path / "hammer", tmp_path / "hammer.partial"
    command = [sys.executable, "-m", "lerobot_dexflex.recording.cli", "--task=PlaceHammer-v0", "--episodes=9"]
    process = subprocess.Popen(
        [*command, f"--root={root}", "--workers=1"],
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A test suite in the background of a shell ignores Ctrl-C, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 400  # Twenty seconds on an idle core.
    while not list(staging.glob("attempt_*.npz")):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "no attempt was finished"
        time.sleep(0.1)
    # A terminal sends Ctrl-C to the whole group, workers included.
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert "Run the same command again to continue." in output
    assert "Traceback" not in errors

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("lerobot-dexflex/hammer", root=root, video_backend="pyav")
    assert 1 <= dataset.num_episodes == len(list(staging.glob("attempt_*.npz"))) < 9
    frame: Any = dataset[len(dataset) - 1]
    assert frame["observation.images.wrist"].shape == (3, 96, 96)
