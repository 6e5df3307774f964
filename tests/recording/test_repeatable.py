"""A recording is decided by its recipe: not by workers, interruptions, or what the process did before."""

import json

import numpy as np
import torch

from lerobot_dexflex.hand.model import JOINTS
from lerobot_dexflex.recording import RecordConfig, attempt, record
from lerobot_dexflex.recording.attempt import Attempt, save_attempt
from lerobot_dexflex.recording.dataset import assemble
from lerobot_dexflex.recording.schema import columns

DECIDED = ("data", "videos", "meta/episodes", "meta/info.json", "meta/stats.json", "meta/tasks.parquet")
STEPS = 60


def decided(root):
    """Return the content of every file that the recipe decides."""
    found = [file for path in DECIDED for file in (root / path, *(root / path).rglob("*"))]
    return {file.relative_to(root).as_posix(): file.read_bytes() for file in found if file.is_file()}


def busy_attempt(index):
    """An attempt whose pictures move, so that an encoder has something to decide."""
    rng = np.random.default_rng(index)
    rows = np.arange(STEPS)[:, None, None, None] + np.arange(96)[:, None, None]
    wave = 127 + 80 * np.sin(rows / 7) + rng.normal(0, 12, (STEPS, 96, 96, 3))
    pictures = wave.clip(0, 255).astype(np.uint8)
    images = {f"observation.images.{camera}": pictures for camera in ("front", "wrist")}
    sizes = {key: len(column.names) for key, column in columns(JOINTS).items()}
    numbers = {key: rng.normal(size=(STEPS, size)).astype(np.float32) for key, size in sizes.items()}
    return Attempt(index, index, True, STEPS, 1.0, images | numbers)


def test_the_same_attempts_give_the_same_files_every_time(counting_task, tmp_path):
    attempts = [busy_attempt(k) for k in range(2)]
    origin = dict.fromkeys(("command", "commit", "code", "controller"), "x") | {"versions": {}}
    found, rng = [], np.random.default_rng(0)
    for k in range(4):
        config = RecordConfig(task=counting_task, episodes=2, root=tmp_path / f"{k}")
        staging = tmp_path / f"{k}.partial"
        staging.mkdir()
        for one in attempts:
            save_attempt(one, staging)
        litter = [
            rng.bytes(int(rng.integers(1000, 60_000))) for _ in range(200)
        ]  # Memory is never as it was.
        assemble(config, staging, attempts, origin)
        del litter
        found.append(decided(config.root))
    assert len(found[0]) == 7
    assert all(other == found[0] for other in found[1:])


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
    assert record.record(config("workers", 2), [])
    original = attempt.run_attempt

    def interrupted(task, seed, index, **options):
        if index == 1:
            raise KeyboardInterrupt
        return original(task, seed, index, **options)

    with monkeypatch.context() as patch:
        patch.setattr(record, "run_attempt", interrupted)
        assert not record.record(config("continued", 0), [])
    assert record.record(config("continued", 1), [])
    here = decided(tmp_path / "here")
    assert len(here) == 7
    assert decided(tmp_path / "workers") == here
    assert decided(tmp_path / "continued") == here
