import json

import numpy as np
import pytest
from counting_task import count
from moving_hand import TIPS, bent, record
from scripted_keys import InterruptedKeys, ScriptedKeys

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.recording import RecordConfig
from lerobot_dexflex.recording import record as recorder
from lerobot_dexflex.streams.files import RecordWriter
from lerobot_dexflex.streams.retarget import calibrate
from lerobot_dexflex.teleop.config import SimulatedConfig, TeleopConfig
from lerobot_dexflex.teleop.ik import RobotIK
from lerobot_dexflex.teleop.operate import operate
from lerobot_dexflex.teleop.stream_config import StreamConfig

BEATS = 60
"""Of a second: 50 ticks and 20 control steps, of which half come with a tick."""


def loaded(root):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset(f"lerobot-dexflex/{root.name}", root=root, video_backend="pyav")


def numbers(dataset):
    table = dataset.hf_dataset.with_format("numpy")[:]
    return {key: np.stack(values) for key, values in table.items()}


def simulated(task, root, **changes):
    how = {"episodes": 2, "interface": "raw", "simulated": SimulatedConfig("novice"), "seed": 4}
    return TeleopConfig(task, root=root, source="simulated", realtime=False, view="none", **(how | changes))


def test_a_simulated_person_records_what_dexflex_record_records(counting_task, tmp_path, monkeypatch):
    """Bit for bit; a task of nine steps whose expert draws random numbers, behind a novice's glove."""
    monkeypatch.setattr(recorder, "make_expert", lambda task: count)
    live, other = tmp_path / "live", tmp_path / "other"
    assert operate(simulated(counting_task, live), [], ScriptedKeys({}))
    how = {"interface": "raw", "glove": "novice", "seed": 4, "workers": 0}
    assert recorder.record(RecordConfig(counting_task, episodes=2, root=other, **how), [])
    one, two = numbers(loaded(live)), numbers(loaded(other))
    assert one.keys() == two.keys()
    for key in one:
        np.testing.assert_array_equal(one[key], two[key])
    for video in live.glob("videos/**/*.mp4"):
        assert video.read_bytes() == (other / video.relative_to(live)).read_bytes()
    assert "its glove spoilt them: `novice`" in (live / "README.md").read_text()


@pytest.fixture(scope="module")
def stream(tmp_path_factory):
    """A stored stream: open and still for 1.5 s, then up at 5 cm/s while the fingers bend."""
    path = tmp_path_factory.mktemp("stream") / "hand.jsonl"
    with RecordWriter(path) as writer:
        for t in np.arange(0.0, 4.0, 0.01):
            moved = min(2.0, max(0.0, t - 1.5))
            writer.append(record(t, bent(0.3 * moved), (0.3, 0.1, 1.0 + 0.05 * moved)))
    return path


def streamed(root, stream, **changes):
    how = {"episodes": 3, "interface": "raw", "stream": StreamConfig(file=stream)}
    return TeleopConfig(root=root, source="replay", realtime=False, view="none", **(how | changes))


def test_a_hand_leads_the_robot_and_becomes_a_dataset_that_policies_train_on(tmp_path, stream, capsys):
    """Recorded from 1.4 s on for 2 s, in which the wrist goes up by 9.5 cm and the fingers bend."""
    from lerobot.configs import FeatureType
    from lerobot.utils.feature_utils import dataset_to_policy_features

    from lerobot_policy_dexflex.compatibility import check_dataset, shapes

    root, start = tmp_path / "live", round(1.3 * BEATS)
    keys = {start: ["space"], start + 6: "s", start + 6 + 2 * BEATS: "k", start + 8 + 2 * BEATS: "q"}
    assert operate(streamed(root, stream), ["--source=replay"], ScriptedKeys(keys))
    said = capsys.readouterr().out
    assert "The robot follows you." in said
    assert "Kept (not solved): 1 of 3 episodes." in said
    dataset = loaded(root)
    found = numbers(dataset)
    assert (dataset.num_episodes, dataset.num_frames) == (1, 40)
    palms = [RobotIK(LEAP, action[:23]).palm.position for action in found["action"]]
    np.testing.assert_allclose(palms[-1] - palms[0], (0.0, 0.0, 0.095), atol=0.01)
    measured = [RobotIK(LEAP, state).palm.position for state in found["observation.state"]]
    np.testing.assert_allclose(measured[-1] - measured[0], (0.0, 0.0, 0.09), atol=0.02)
    wish = calibrate(LEAP, record(0.0))(bent(0.3 * 1.9)[TIPS])
    np.testing.assert_allclose(found["operator.draft"][-1].reshape(4, 3), wish, atol=5e-3)
    off = np.linalg.norm((found["operator.draft"] - found["action"][:, 23:]).reshape(-1, 4, 3), axis=-1)
    assert np.median(off[10:]) < 2e-3  # Raw goes where the person's fingertips are.
    features = dataset_to_policy_features(dataset.meta.features)
    inputs = {key: feature for key, feature in features.items() if feature.type is not FeatureType.ACTION}
    check_dataset(LEAP, dataset.meta, shapes(inputs))
    told = json.loads((root / "meta/recording.json").read_text())
    assert (told["program"], told["complete"], told["episode_seeds"]) == ("dexflex-teleop", False, [0])
    card = (root / "README.md").read_text()
    assert "made by a person, live (`replay`), with dexflex-teleop" in card
    assert "1 of 1 attempts were kept, as the operator wished; 0 of them all\nsolved the task" in card
    assert "The operator's fingertips passed through the interface `raw`" in card


def test_every_command_from_100_ms_after_the_last_record_on_is_the_one_before(tmp_path, capsys):
    """The wrist moves all the time, and is not sent for 0.6 s from 3 s on."""
    path, root, start = tmp_path / "hand.jsonl", tmp_path / "live", round(1.3 * BEATS)
    with RecordWriter(path) as writer:
        for t in np.arange(0.0, 5.0, 0.01):
            if not 3.0 < t < 3.6:
                moved = max(0.0, t - 1.5)
                writer.append(record(t, bent(0.2 * moved), (0.3, 0.1, 1.0 + 0.04 * moved)))
    keys = {start: ["space"], start + 6: "s", round(4.5 * BEATS): "k", round(4.5 * BEATS) + 2: "q"}
    operate(streamed(root, path, interface="joint"), [], ScriptedKeys(keys))
    assert "The stream stopped: the robot holds still." in capsys.readouterr().out
    actions = numbers(loaded(root))["action"]
    times = 1.4 + 0.05 * np.arange(len(actions))  # Of the control steps.
    still = np.append(False, (actions[1:] == actions[:-1]).all(1))
    assert still[(times > 3.1 + 1e-6) & (times < 3.6 - 1e-6)].all()
    assert not still[(times > 1.7) & (times < 3.05)].any()
    assert not still[times > 3.7].any()


def test_an_interrupt_leaves_the_finished_episodes_in_the_dataset(counting_task, tmp_path):
    config = simulated(counting_task, tmp_path / "live", episodes=4, seed=0)
    with pytest.raises(KeyboardInterrupt):
        operate(config, [], InterruptedKeys({round(1.2 * BEATS): "^"}))
    assert loaded(config.root).num_episodes == 2
    operate(config, [], ScriptedKeys({1: "q"}))
    assert loaded(config.root).num_episodes == 2


def test_a_session_in_which_nothing_is_recorded_leaves_nothing(counting_task, tmp_path):
    assert operate(simulated(counting_task, tmp_path / "live"), [], ScriptedKeys({1: "q"}))
    assert list(tmp_path.iterdir()) == []


def test_a_complete_recording_is_left_alone(counting_task, tmp_path, capsys):
    config = simulated(counting_task, tmp_path / "live", episodes=1, seed=0)
    operate(config, [], ScriptedKeys({}))
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert operate(config, [], ScriptedKeys({}))
    assert "is complete: 1 episodes. Nothing to record." in capsys.readouterr().out
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}


def test_recordings_are_not_mixed(counting_task, tmp_path):
    config = simulated(counting_task, tmp_path / "live", episodes=9, seed=0)
    operate(config, [], ScriptedKeys({round(1.2 * BEATS): "q"}))
    for changes, message in (
        ({"interface": "raw@0.5"}, "interface: 'raw' there, 'raw@0.5' now"),
        ({"seed": 7}, "seed: 0 there, 7 now"),
        ({"episodes": 1}, "holds 2 episodes. `episodes` must be at least that. Got 1."),
    ):
        with pytest.raises(DexFlexError, match=message):
            operate(simulated(counting_task, config.root, **({"episodes": 9, "seed": 0} | changes)), [])
    with pytest.raises(DexFlexError, match="holds a recording of dexflex-teleop"):
        recorder.record(RecordConfig(counting_task, root=config.root, workers=0), [])
