import itertools
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.replay import ReplayController, Replays, load_demonstrations
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.recording.schema import columns

ROOT = Path(__file__).parents[2]
STATE = np.full((1, 23), 0.3, np.float32)
MEASURED = np.repeat(np.arange(3, dtype=np.float32)[:, None] / 8, 12, 1)
"""Fingertips before each of the three steps, which have the number of the step."""


@pytest.fixture
def actions():
    """Three steps in which every joint moves by 0.02 rad, with the fingertips of those joints."""
    joints = 0.3 + 0.02 * np.arange(1, 4)[:, None].repeat(23, 1)
    tips = fingertips(LEAP, torch.as_tensor(joints[:, 7:])).reshape(3, 12).numpy()
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
        "features": {"action": {"names": columns(LEAP, robot_joints(LEAP))["action"].names}},
    }
    (tmp_path / "meta/recording.json").write_text(json.dumps(record))
    (tmp_path / "meta/info.json").write_text(json.dumps(info))
    write(tmp_path, actions)
    return tmp_path


def write(root, actions):
    table = {"episode_index": [0, 1, 1], "action": list(actions), "observation.fingertips": list(MEASURED)}
    pq.write_table(pa.table(table), root / "data/chunk-000/file-000.parquet")


def play(actions, interface, steps):
    controller = ReplayController(LEAP, actions, interface)
    controller.reset([0])
    return controller, np.concatenate([controller.act({"agent_pos": STATE}, "task") for _ in range(steps)])


def test_joint_replays_the_recorded_targets_and_then_holds_the_last(actions):
    _, played = play(actions, "joint", 5)
    np.testing.assert_allclose(played[:3], actions[:, :23], atol=1e-6)
    np.testing.assert_array_equal(played[3:], played[2:3].repeat(2, 0))


def test_raw_asks_for_the_recorded_fingertips_from_wherever_the_hand_is_measured(actions):
    controller = ReplayController(LEAP, actions, "raw")
    controller.reset([0])
    for k, state in enumerate((STATE, STATE + 0.1, STATE - 0.05)):
        played = controller.act({"agent_pos": state}, "task")
        np.testing.assert_allclose(played[:, :7], actions[[k], :7], atol=1e-6)
        here = fingertips(LEAP, torch.as_tensor(state[:, 7:], dtype=torch.float64))
        motion = controller._interface.motion
        assert motion is not None
        np.testing.assert_allclose((here + motion).reshape(-1), actions[k, 23:], atol=1e-7)


def test_raw_reproduces_the_fingertips_that_were_recorded():
    """Of a real demonstration, in its own posture: `raw` leads the tips to where they were commanded."""
    table = pq.read_table(next((ROOT / "datasets/place_hammer").glob("data/*/*.parquet")))
    first = table["episode_index"].to_numpy() == 0
    recorded, states = (np.stack(table[key].to_numpy()[first]) for key in ("action", "observation.state"))
    controller = ReplayController(LEAP, recorded, "raw")
    controller.reset([0])
    played = np.concatenate([controller.act({"agent_pos": state[None]}, "task") for state in states])
    np.testing.assert_allclose(played[:, :7], recorded[:, :7], atol=1e-6)
    tips = fingertips(LEAP, torch.from_numpy(played[:, 7:]).double()).numpy()
    off = np.linalg.norm(tips - recorded[:, 23:].reshape(-1, 4, 3), axis=-1)
    assert np.median(off) < 3e-4  # The posture tie leaves some out.
    assert off.max() < 2.5e-3


def test_a_draft_looks_ahead_and_meets_every_error_once(actions, monkeypatch):
    controller = ReplayController(LEAP, actions, "raw", CommandErrors.of(noise=0.004))
    controller.reset([3])
    drafts = []
    raw = controller._interface.inner
    raw_step = raw.step
    monkeypatch.setattr(raw, "step", lambda batch, draft: drafts.append(draft) or raw_step(batch, draft))
    for _ in range(5):
        controller.act({"agent_pos": STATE}, "task")
    assert drafts[0].shape == (1, 8, 4, 3)
    for first, second in itertools.pairwise(drafts):  # What was planned is what comes.
        torch.testing.assert_close(first[:, 1:], second[:, :-1], atol=1e-12, rtol=0)
    here = fingertips(LEAP, torch.as_tensor(STATE[:, 7:], dtype=torch.float64))
    errors = (here + drafts[4])[0, 1:].flatten(1) - torch.from_numpy(actions[2, 23:])
    assert 0.003 < errors.abs().max() < 0.004 + 1e-6  # Of steps that all lead to the last fingertips.
    assert torch.diff(errors, dim=0).abs().amax(1).min() > 1e-4


def test_a_controller_replays_with_touch(actions):
    controller = ReplayController(LEAP, actions, "dexflex")
    controller.reset([0])
    tips = fingertips(LEAP, torch.as_tensor(STATE[:, 7:], dtype=torch.float64))
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


def test_measured_fingertips_are_those_of_the_next_step_and_the_last_step_repeats_its_own(dataset, actions):
    demonstrations = load_demonstrations(dataset)
    measured, commanded = demonstrations.played("measured"), demonstrations.played("commanded")
    np.testing.assert_array_equal(measured[4][:, 23:], MEASURED[:1])
    np.testing.assert_array_equal(measured[7][:, 23:], MEASURED[[2, 2]])
    np.testing.assert_array_equal(commanded[7], actions[1:])
    for seed, rows in ((4, actions[:1]), (7, actions[1:])):
        np.testing.assert_array_equal(measured[seed][:, :23], rows[:, :23])


def test_a_folder_without_a_recording_is_refused(tmp_path):
    with pytest.raises(DexFlexError, match=r"no dataset of dexflex-record: .*recording.json not found"):
        load_demonstrations(tmp_path)


def test_a_dataset_of_another_rate_is_refused(dataset):
    info = json.loads((dataset / "meta/info.json").read_text())
    (dataset / "meta/info.json").write_text(json.dumps(info | {"fps": 30}))
    with pytest.raises(DexFlexError, match="30 fps"):
        load_demonstrations(dataset)


def test_replays_are_players_of_the_recorded_seeds(dataset, actions):
    players = Replays(dataset)
    players.check(["raw", "joint"])
    player = players("joint", NO_ERRORS)
    player.reset([7])
    np.testing.assert_allclose(player.act({"agent_pos": STATE}, "task")[0], actions[1, :23], atol=1e-6)
    player.reset([4])
    np.testing.assert_allclose(player.act({"agent_pos": STATE}, "task")[0], actions[0, :23], atol=1e-6)


def test_fingertips_that_no_recording_holds_are_refused(dataset):
    with pytest.raises(DexFlexError, match=r"`draft` must be measured or commanded\. Got 'felt'"):
        Replays(dataset, "felt")


def test_the_script_names_rows_by_their_draft(dataset, load_script, monkeypatch, tmp_path):
    from lerobot_dexflex.evaluation import comparison

    ran = []
    monkeypatch.setattr(comparison, "compare", lambda made, workers: ran.append(made) or _Stop.here())
    script = load_script("replay_dataset")
    for draft in ("measured", "commanded"):
        with pytest.raises(_Stop):
            script.main([f"--root={dataset}", f"--draft={draft}", f"--output={tmp_path / 'out'}"])
    assert [made.named("raw") for made in ran] == ["replay_measured/raw", "replay_commanded/raw"]
    assert script.main([f"--root={dataset}", "--draft=felt"]) == 1


class _Stop(Exception):  # noqa: N818
    """Ends a script where its episodes would begin."""

    @classmethod
    def here(cls):
        raise cls


def test_the_recorded_actions_decide_the_version(dataset, actions):
    before = Replays(dataset).version("raw", "PlaceHammer-v0")
    assert Replays(dataset).version("raw", "PlaceHammer-v0") == before
    assert Replays(dataset).version("joint", "PlaceHammer-v0").name != before.name
    commanded = Replays(dataset, "commanded").version("raw", "PlaceHammer-v0")
    assert (commanded.code, commanded.weights) == (before.code, before.weights)
    assert commanded.name != before.name
    write(dataset, actions + np.float32(0.001))
    assert Replays(dataset).version("raw", "PlaceHammer-v0").name != before.name
