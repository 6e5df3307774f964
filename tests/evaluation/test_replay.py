import itertools
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.replay import ReplayController, Replays, load_demonstrations
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hand.model import JOINTS
from lerobot_dexflex.recording.schema import columns

STATE = np.full((1, 23), 0.3, np.float32)


@pytest.fixture
def actions():
    """Three steps in which every joint moves by 0.02 rad, with the fingertips of those joints."""
    joints = 0.3 + 0.02 * np.arange(1, 4)[:, None].repeat(23, 1)
    tips = fingertips(torch.as_tensor(joints[:, 7:])).reshape(3, 12).numpy()
    return np.concatenate([joints, tips], axis=1).astype(np.float32)


@pytest.fixture
def dataset(tmp_path, actions):
    (tmp_path / "meta").mkdir()
    (tmp_path / "data/chunk-000").mkdir(parents=True)
    record = {
        "episode_seeds": [4, 7],
        "expert": {"successes": 2, "attempts": 3},
        "recipe": {"task": "PlaceHammer-v0"},
    }
    info = {
        "fps": 20,
        "robot_type": "leap_xarm7",
        "features": {"action": {"names": columns(JOINTS)["action"].names}},
    }
    (tmp_path / "meta/recording.json").write_text(json.dumps(record))
    (tmp_path / "meta/info.json").write_text(json.dumps(info))
    table = {"episode_index": [0, 1, 1], "action": list(actions)}
    pq.write_table(pa.table(table), tmp_path / "data/chunk-000/file-000.parquet")
    return tmp_path


def play(actions, interface, steps):
    controller = ReplayController(actions, interface)
    controller.reset([0])
    return controller, np.concatenate([controller.act({"agent_pos": STATE}, "task") for _ in range(steps)])


def test_joint_replays_the_recorded_targets_and_then_holds_the_last(actions):
    _, played = play(actions, "joint", 5)
    np.testing.assert_allclose(played[:3], actions[:, :23], atol=1e-6)
    np.testing.assert_array_equal(played[3:], played[2:3].repeat(2, 0))


def test_raw_moves_the_commanded_fingertips_onto_the_recorded_ones(actions):
    controller, played = play(actions, "raw", 3)
    command = controller._interface.command
    assert command is not None
    np.testing.assert_allclose(command[0].reshape(-1), actions[2, 23:], atol=1e-7)
    np.testing.assert_allclose(played[:, :7], actions[:, :7], atol=1e-6)
    reached = fingertips(torch.as_tensor(played[-1:, 7:])).reshape(-1)
    np.testing.assert_allclose(reached, actions[2, 23:], atol=5e-4)


def test_a_draft_looks_ahead_and_meets_every_error_once(actions, monkeypatch):
    controller = ReplayController(actions, "raw", CommandErrors.of(jitter=0.004))
    controller.reset([3])
    drafts = []
    raw = controller._interface.inner
    raw_step = raw.step
    monkeypatch.setattr(raw, "step", lambda batch, draft: drafts.append(draft) or raw_step(batch, draft))
    for _ in range(5):
        controller.act({"agent_pos": STATE}, "task")
    assert drafts[0].shape == (1, 8, 4, 3)
    for first, second in itertools.pairwise(drafts):  # What was planned is what comes.
        torch.testing.assert_close(first[:, 2:], second[:, 1:-1], atol=1e-12, rtol=0)
    rng = np.random.default_rng(3)
    errors = [rng.uniform(-0.004, 0.004, (4, 3)) for _ in range(5)]
    command = controller._interface.command
    assert command is not None
    np.testing.assert_allclose(command[0].numpy() - actions[2, 23:].reshape(4, 3), errors[4], atol=1e-7)


def test_a_controller_replays_with_touch(actions):
    controller = ReplayController(actions, "dexflex")
    controller.reset([0])
    tips = fingertips(torch.as_tensor(STATE[:, 7:], dtype=torch.float64))
    seen = {
        "agent_pos": STATE,
        "tactile": np.zeros((1, 240), np.float32),
        "fingertips": tips.reshape(1, 12).numpy().astype(np.float32),
        "gravity": np.array([[0.0, 0.0, -1.0]], np.float32),
    }
    assert controller.act(seen, "task").shape == (1, 23)
    assert np.isfinite(controller.act(seen, "task")).all()


def test_episodes_are_read_with_their_seeds_and_the_experts_record(dataset, actions):
    demonstrations = load_demonstrations(dataset)
    assert demonstrations.seeds == (4, 7)
    assert demonstrations.expert == (2, 3)
    np.testing.assert_array_equal(demonstrations.actions[0], actions[:1])
    np.testing.assert_array_equal(demonstrations.actions[1], actions[1:])


def test_a_folder_without_a_recording_is_refused(tmp_path):
    with pytest.raises(DexFlexError, match=r"no dataset of dexflex-record: .*recording.json not found"):
        load_demonstrations(tmp_path)


def test_a_dataset_of_another_rate_is_refused(dataset):
    info = json.loads((dataset / "meta/info.json").read_text())
    (dataset / "meta/info.json").write_text(json.dumps(info | {"fps": 30}))
    with pytest.raises(DexFlexError, match="30 fps"):
        load_demonstrations(dataset)


def test_noise_shakes_the_commanded_fingertips_within_its_width_and_repeats_by_seed(actions):
    def commands(seed):
        controller = ReplayController(actions, "raw", CommandErrors.of(jitter=0.004))
        controller.reset([seed])
        played = []
        for _ in range(3):
            controller.act({"agent_pos": STATE}, "task")
            command = controller._interface.command
            assert command is not None
            played.append(command[0].reshape(-1).numpy())
        return np.array(played)

    error = commands(0) - actions[:, 23:]
    assert 0.002 < np.abs(error).max() <= 0.004 + 1e-6
    np.testing.assert_array_equal(commands(0), commands(0))
    assert not np.array_equal(commands(0), commands(1))


def test_replays_are_players_of_the_recorded_seeds(dataset, actions):
    players = Replays(dataset)
    players.check(["raw", "joint"])
    player = players("joint", NO_ERRORS)
    player.reset([7])
    np.testing.assert_allclose(player.act({"agent_pos": STATE}, "task")[0], actions[1, :23], atol=1e-6)
    player.reset([4])
    np.testing.assert_allclose(player.act({"agent_pos": STATE}, "task")[0], actions[0, :23], atol=1e-6)


def test_the_recorded_actions_decide_the_version(dataset, actions):
    before = Replays(dataset).version("raw", "PlaceHammer-v0")
    assert Replays(dataset).version("raw", "PlaceHammer-v0") == before
    assert Replays(dataset).version("joint", "PlaceHammer-v0").name != before.name
    table = {"episode_index": [0, 1, 1], "action": list(actions + np.float32(0.001))}
    pq.write_table(pa.table(table), dataset / "data/chunk-000/file-000.parquet")
    assert Replays(dataset).version("raw", "PlaceHammer-v0").name != before.name
