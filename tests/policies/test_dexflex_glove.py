"""The hand as a LeRobot teleoperator, made by LeRobot's own factory and run by its own commands."""

import sys
from pathlib import Path

import numpy as np
import pytest

from lerobot_dexflex.hands import LEAP

sys.path[:0] = [str(Path(__file__).parents[1] / name) for name in ("teleop", "streams")]

START = [0.0, -0.35, 0.0, 0.95, 0.0, 1.3, 1.57, *[0.4, 0.0, 0.6, 0.4] * 3, 0.3, 0.0, 0.8, 0.3]


@pytest.fixture
def stream(tmp_path):
    """A stored stream: an open hand, still for 1.2 s, then up at 10 cm/s while the fingers bend."""
    from moving_hand import bent, record

    from lerobot_dexflex.streams.files import RecordWriter

    path = tmp_path / "hand.jsonl"
    with RecordWriter(path) as writer:
        for t in np.arange(0.0, 8.0, 0.02):
            moved = min(1.0, max(0.0, t - 1.2))
            writer.append(record(t, bent(0.4 * moved), (0.0, 0.0, 1.0 + 0.1 * moved)))
    return path


@pytest.fixture
def make(stream, tmp_path):
    """Returns a function that makes a teleoperator as LeRobot does, on a clock that does not wait."""
    from lerobot.teleoperators import make_teleoperator_from_config
    from lerobot.utils.import_utils import register_third_party_plugins

    from lerobot_dexflex.teleop.clock import SteppedClock
    from lerobot_dexflex.teleop.stream_config import StreamConfig
    from lerobot_policy_dexflex import DexflexGloveConfig

    register_third_party_plugins()

    def making(**settings):
        how = {"source": "replay", "stream": StreamConfig(file=stream), "start": START}
        how["calibration_dir"] = tmp_path
        teleop = make_teleoperator_from_config(DexflexGloveConfig(**(how | settings)))
        teleop._clock = SteppedClock()  # pyright: ignore[reportAttributeAccessIssue]
        return teleop

    return making


def run(teleop, seconds):
    """Ask for an action every 50 ms of the stepped clock; return all. Shape (steps, 23)."""
    found = []
    for _ in range(round(seconds / 0.05)):
        teleop._clock.wait(teleop._clock.now() + 0.05)
        found.append(list(teleop.get_action().values()))
    return np.array(found)


def test_its_action_is_every_joint_by_name(make):
    from lerobot_dexflex.hand.model import robot_joints

    teleop = make()
    assert (teleop.name, type(teleop).__name__) == ("dexflex_glove", "DexflexGlove")
    assert teleop.action_features == {f"{joint}.pos": float for joint in robot_joints(LEAP)}
    assert teleop.feedback_features == {}
    assert not teleop.is_connected
    teleop.connect()
    assert teleop.is_connected
    assert teleop.is_calibrated
    action = teleop.get_action()
    assert list(action) == list(teleop.action_features)
    assert all(type(value) is float for value in action.values())
    teleop.disconnect()
    assert not teleop.is_connected


def test_it_leads_from_its_start_and_holds_still_when_the_stream_ends(make):
    from lerobot_dexflex.teleop.ik import RobotIK

    teleop = make()
    teleop.connect()
    found = run(teleop, 9.0)
    np.testing.assert_allclose(found[0][:7], START[:7], atol=1e-3)
    np.testing.assert_allclose(found[0], START, atol=0.3)
    moved = RobotIK(LEAP, found[60]).palm.position - RobotIK(LEAP, START).palm.position
    np.testing.assert_allclose(moved, (0.0, 0.0, 0.1), atol=0.01)
    assert np.abs(found[60] - found[0])[7:].max() > 0.1
    np.testing.assert_array_equal(found[-1], found[-15])
    teleop.disconnect()


def test_without_waiting_the_robot_stays_until_an_open_hand_was_seen(make):
    teleop = make()
    teleop.connect(calibrate=False)
    assert not teleop.is_calibrated
    found = run(teleop, 0.9)
    np.testing.assert_array_equal(found, np.tile(START, (len(found), 1)))
    run(teleop, 0.3)
    assert teleop.is_calibrated
    teleop.disconnect()


def test_who_shows_no_open_hand_is_told_and_disconnected(make):
    from lerobot_dexflex.errors import DexFlexError

    teleop = make(patience=0.5)
    with pytest.raises(DexFlexError, match=r"replay showed no open hand in 0.5 s.*--teleop.patience"):
        teleop.connect()
    assert not teleop.is_connected


def test_it_must_be_connected_once(make):
    from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

    teleop = make()
    for call in (teleop.get_action, teleop.calibrate, teleop.disconnect):
        with pytest.raises(DeviceNotConnectedError):
            call()
    teleop.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        teleop.connect()
    teleop.disconnect()


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("source=psychic", "`source` must be one of rokoko, openxr, mediapipe, replay. Got 'psychic'"),
        ("source=replay", "--teleop.source=replay needs --teleop.stream.file"),
        ("stream.hand=third", "`hand` must be right or left. Got 'third'"),
        ("start=[1, 2]", "`start` must be 23 joints"),
        ("scale=0", "`scale` must be positive"),
    ],
)
def test_bad_settings_are_told_through_lerobots_parser(argument, message, monkeypatch, capsys):
    import draccus
    import fake_robot
    from lerobot.scripts.lerobot_teleoperate import TeleoperateConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    words = [
        f"--robot.type={fake_robot.FakeRobot.name}",
        "--teleop.type=dexflex_glove",
        f"--teleop.{argument}",
    ]
    with pytest.raises(BaseException) as failed:  # noqa: PT011
        draccus.parse(TeleoperateConfig, args=words)
    told = "".join(str(error) for error in (failed.value, failed.value.__cause__)) + capsys.readouterr().err
    assert message in told


def lerobot(monkeypatch, folder, main, *words):
    """Run a LeRobot command with the fake robot and our teleoperator; return what the robot was sent."""
    import fake_robot

    monkeypatch.setattr(fake_robot.FakeRobot, "sent", [])
    robot = [f"--robot.type={fake_robot.FakeRobot.name}", f"--robot.calibration_dir={folder}"]
    teleop = ["--teleop.type=dexflex_glove", f"--teleop.calibration_dir={folder}"]
    monkeypatch.setattr(sys, "argv", ["lerobot", *robot, *teleop, *words])
    main()
    return np.array([list(action.values()) for action in fake_robot.FakeRobot.sent])


def words(stream):
    start = f"--teleop.start={START}"
    return ["--teleop.source=replay", f"--teleop.stream.file={stream}", start]


def test_lerobot_teleoperate_leads_a_robot_with_it(stream, tmp_path, monkeypatch):
    from lerobot.scripts.lerobot_teleoperate import main

    sent = lerobot(monkeypatch, tmp_path, main, *words(stream), "--teleop_time_s=1", "--fps=30")
    assert 10 < len(sent) <= 31
    np.testing.assert_allclose(sent[0], START, atol=0.3)
    assert np.abs(sent[-1] - sent[0])[:7].max() > 0.03


def test_lerobot_record_records_it(stream, tmp_path, monkeypatch):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.scripts.lerobot_record import main

    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    dataset = [
        "--dataset.repo_id=me/led",
        f"--dataset.root={tmp_path / 'led'}",
        "--dataset.single_task=Follow.",
        "--dataset.num_episodes=1",
        "--dataset.episode_time_s=1",
        "--dataset.fps=20",
        "--dataset.push_to_hub=false",
        "--play_sounds=false",
    ]
    sent = lerobot(monkeypatch, tmp_path, main, *words(stream), *dataset)
    recorded = LeRobotDataset("me/led", root=tmp_path / "led")
    assert recorded.features["action"]["names"] == [
        f"{name}" for name in recorded.features["action"]["names"]
    ]
    assert recorded.features["action"]["names"][:1] == ["joint1.pos"]
    actions = np.stack(recorded.hf_dataset.with_format("numpy")["action"])
    np.testing.assert_allclose(actions, sent, atol=1e-6)
