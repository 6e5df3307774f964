"""A recording is decided by its recipe: not by workers, interruptions, or what the process did before."""

import json
import os
import subprocess
import sys

import torch

from lerobot_dexflex.recording import RecordConfig, attempt, record

DECIDED = ("data", "videos", "meta/episodes", "meta/info.json", "meta/stats.json", "meta/tasks.parquet")


def decided(root):
    """Return the content of every file that the recipe decides."""
    found = [file for path in DECIDED for file in (root / path, *(root / path).rglob("*"))]
    return {file.relative_to(root).as_posix(): file.read_bytes() for file in found if file.is_file()}


_ASSEMBLE = """\
import sys
from pathlib import Path
import av
import numpy as np
from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.recording import RecordConfig
from lerobot_dexflex.recording.attempt import Attempt, save_attempt
from lerobot_dexflex.recording.dataset import assemble
from lerobot_dexflex.recording.schema import columns, privileged_columns

film, root = Path(sys.argv[1]), Path(sys.argv[2])
staging = root.with_name(root.name + ".partial")
staging.mkdir()
with av.open(str(film)) as container:
    pictures = np.stack([f.to_ndarray(format="rgb24") for f, _ in zip(container.decode(video=0), range(120))])
attempts = []
for k in range(2):
    own = pictures[60 * k : 60 * (k + 1)]
    frames = {f"observation.images.{camera}": own for camera in ("front", "wrist")}
    for key, column in (columns(LEAP, robot_joints(LEAP)) | privileged_columns(LEAP)).items():
        frames[key] = np.random.default_rng(k).normal(size=(60, len(column.names))).astype(np.float32)
    attempts.append(Attempt(k, k, True, 60, 1.0, frames, kept=True))
    save_attempt(attempts[-1], staging)
origin = dict.fromkeys(("program", "command", "commit", "code", "controller"), "x") | {"versions": {}}
assemble(RecordConfig(episodes=2, root=root), staging, attempts, origin)
"""


def test_the_same_attempts_give_the_same_files_in_every_process(tmp_path, request):
    """glibc fills fresh memory with a byte of our choice: what reads it before writing shows itself."""
    film = (
        request.config.rootpath
        / "datasets/place_hammer/videos/observation.images.wrist/chunk-000/file-000.mp4"
    )
    found = []
    for byte in ("1", "170"):
        command = [sys.executable, "-c", _ASSEMBLE, str(film), str(tmp_path / byte)]
        environment = os.environ | {"MALLOC_PERTURB_": byte, "PYTHONHASHSEED": byte}
        subprocess.run(command, check=True, env=environment, capture_output=True)
        found.append(decided(tmp_path / byte))
    assert len(found[0]) == 7
    assert found[0] == found[1]


def test_the_keys_of_the_statistics_are_in_one_order(recorded):
    stats = json.loads((recorded / "meta/stats.json").read_text())
    assert list(stats) == sorted(stats)


def test_attempts_run_on_one_thread_whatever_the_process_has(counting_task, tmp_path, monkeypatch):
    seen = []
    original = attempt.run_attempt

    def run(*arguments, **options):
        seen.append(torch.get_num_threads())
        return original(*arguments, **options)

    monkeypatch.setattr(record, "run_attempt", run)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert record.record(RecordConfig(counting_task, episodes=1, root=tmp_path / "count", workers=0), [])
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert seen == [1]


def test_workers_and_interruptions_do_not_show_in_a_recording(tmp_path, monkeypatch):
    """The fastest real task, since workers know no other."""

    def config(name, workers):
        return RecordConfig(task="AssembleTable-v0", episodes=2, root=tmp_path / name, workers=workers)

    assert record.record(config("here", 0), [])
    original = attempt.run_attempt

    def interrupted(hand, task, seed, index, **options):
        if index == 1:
            raise KeyboardInterrupt
        return original(hand, task, seed, index, **options)

    with monkeypatch.context() as patch:
        patch.setattr(record, "run_attempt", interrupted)
        assert not record.record(config("continued", 0), [])
    assert record.record(config("continued", 2), [])
    here = decided(tmp_path / "here")
    assert len(here) == 7
    assert decided(tmp_path / "continued") == here
