"""A session that is killed, and one that goes on: with real keys in a real terminal."""

import os
import pty
import re
import select
import subprocess
import sys
import time

import numpy as np
import pyarrow.parquet as pq
import pytest
from moving_hand import bent, record
from scripted_keys import ScriptedKeys

from lerobot_dexflex.recording.attempt import load_attempt
from lerobot_dexflex.streams.files import RecordWriter
from lerobot_dexflex.teleop.config import TeleopConfig
from lerobot_dexflex.teleop.operate import operate
from lerobot_dexflex.teleop.stream_config import StreamConfig

PATIENCE = 90.0
"""For a process to start on a busy machine, and for each answer [s]."""


class Terminal:
    """A session in a terminal of its own: keys go in, what it says comes out."""

    def __init__(self, arguments):
        self._main, terminal = pty.openpty()
        command = [sys.executable, "-m", "lerobot_dexflex.teleop.cli", *arguments]
        self.process = subprocess.Popen(command, stdin=terminal, stdout=terminal, stderr=terminal)
        os.close(terminal)
        self.said = ""

    def press(self, key):
        os.write(self._main, key.encode())

    def wait_for(self, text):
        until = time.monotonic() + PATIENCE
        seen = len(self.said)
        while not re.search(text, self.said[seen:]):
            assert time.monotonic() < until, self.said
            if select.select([self._main], [], [], 0.1)[0]:
                self.said += os.read(self._main, 4096).decode(errors="replace")

    def kill(self):
        self.process.kill()
        self.process.wait()
        os.close(self._main)


@pytest.fixture
def stream(tmp_path):
    """An open hand that is still, and then bends and moves, for three minutes."""
    path = tmp_path / "hand.jsonl"
    with RecordWriter(path) as writer:
        for t in np.arange(0.0, 180.0, 0.05):
            moved = np.sin(max(0.0, t - 2.0))
            writer.append(record(t, bent(0.2 * abs(moved)), (0.3, 0.1, 1.0 + 0.05 * moved)))
    return path


def test_a_session_that_is_killed_loses_no_finished_episode(tmp_path, stream):
    root = tmp_path / "live"
    options = ["--source=replay", f"--stream.file={stream}", "--interface=raw", "--view=none", "--episodes=3"]
    terminal = Terminal([f"--root={root}", *options])
    try:
        terminal.wait_for("Calibrated")
        terminal.press(" ")
        terminal.wait_for("The robot follows you")
        terminal.press("s")
        terminal.wait_for("Attempt 0 is recorded")
        time.sleep(0.5)
        terminal.press("k")
        terminal.wait_for("1 of 3 episodes")
        terminal.press("s")
        terminal.wait_for("Attempt 1 is recorded")
        time.sleep(0.3)
    finally:
        terminal.kill()
    assert not root.exists()
    saved = load_attempt(tmp_path / "live.partial/attempt_000000.npz")
    assert saved.kept
    assert saved.steps >= 5

    config = TeleopConfig(
        root=root,
        source="replay",
        stream=StreamConfig(file=stream),
        interface="raw",
        view="none",
        episodes=3,
        realtime=False,
    )
    assert operate(config, [], ScriptedKeys({5: "q"}))
    first = actions(root)
    np.testing.assert_array_equal(first[0], saved.frames["action"])
    assert len(first) == 1
    assert operate(config, [], ScriptedKeys({80: "s", 110: "k", 115: "q"}))
    again = actions(root)
    assert len(again) == 2
    np.testing.assert_array_equal(again[0], first[0])


def actions(root):
    """Return the actions of every episode of a dataset."""
    table = pq.read_table(root / "data/chunk-000/file-000.parquet")
    values, episodes = np.stack(table["action"].to_numpy()), table["episode_index"].to_numpy()
    return [values[episodes == k] for k in range(episodes.max() + 1)]
