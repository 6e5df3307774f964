import json
import shutil

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.replay import ReplayController, load_demonstrations
from lerobot_dexflex.experts.command import Command, fingertips_of
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.recording import RecordConfig, attempt, record, staging


@pytest.fixture(scope="session")
def LeRobotDataset():  # noqa: N802
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset


def numbers(dataset):
    """Return all numeric columns of a dataset."""
    table = dataset.hf_dataset.with_format("numpy")[:]
    return {key: np.stack(values) for key, values in table.items()}


def config(task, root, **changes):
    return RecordConfig(**{"task": task, "episodes": 4, "root": root, "workers": 0} | changes)


def load(LeRobotDataset, root):
    return LeRobotDataset(f"lerobot-dexflex/{root.name}", root=root, video_backend="pyav")


def test_a_recording_keeps_successes_only_and_counts_the_failures(counting_task, tmp_path, LeRobotDataset):
    root = tmp_path / "count"
    assert record.record(config(counting_task, root), ["--task=Count-v0"])
    dataset = load(LeRobotDataset, root)
    # Seeds 2 and 3 fail, so four successes need six attempts.
    found = json.loads((root / "meta/recording.json").read_text())
    assert found["episode_seeds"] == [0, 1, 4, 5]
    assert found["expert"] == {"successes": 4, "attempts": 6}
    assert [a["success"] for a in found["attempts"]] == [True, True, False, False, True, True]
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (4, 36, 20)
    assert dataset.meta.robot_type == "leap_xarm7"
    assert not (tmp_path / "count.partial").exists()


def test_frame_k_holds_the_observation_before_the_step_and_the_label(counting_task, tmp_path, LeRobotDataset):
    root = tmp_path / "count"
    record.record(config(counting_task, root, seed=1, episodes=2), [])
    dataset = load(LeRobotDataset, root)
    # Seed 1 succeeds, 2 and 3 fail: the second episode is attempt 3 with seed 4; its step 5 is frame 14.
    frame = dataset[14]
    np.testing.assert_array_equal(frame["observation.state"], np.full(23, 4 + 5 / 16, np.float32))
    np.testing.assert_array_equal(frame["observation.tactile"], np.arange(240, dtype=np.float32))
    np.testing.assert_array_equal(frame["observation.gravity"], [0, 0, -1])
    noise = np.random.default_rng((1, 3)).normal(size=(9, 23))
    np.testing.assert_allclose(frame["action"][:23], noise[5], atol=2.0**-15)
    np.testing.assert_allclose(frame["action"][23:], fingertips_of(LEAP, noise[5, 7:]).ravel(), atol=2.0**-18)
    np.testing.assert_array_equal(frame["operator.draft"], np.full(12, 5 / 128, np.float32))
    np.testing.assert_array_equal(frame["contact.loads"], [0.5, 1.0, 1.5, 2.0])
    assert frame["task"] == "Count to nine."
    for k in range(18):
        gray = 10 * (k % 9) + 5 * (1 if k < 9 else 4)
        for camera in ("front", "wrist"):
            image = dataset[k][f"observation.images.{camera}"]
            np.testing.assert_allclose(255 * image, gray, atol=2)


def follow(env, rng):
    """Command the fingertips of the joints as they are measured, which change by 1/16 rad per step."""
    for k in range(9):
        joints = np.full(23, k / 16)
        yield Command(joints, joints, np.tile(fingertips_of(LEAP, joints[7:]), (8, 1, 1)))


MEASURED = np.stack([fingertips_of(LEAP, np.full(16, k / 16)).ravel() for k in range(9)])
"""Fingertips at every step of seed 0."""


def test_joint_executes_and_records_the_operators_joints_bit_for_bit(counting_task, monkeypatch):
    executed, make = [], gymnasium.make

    def listening(*arguments, **options):
        env = make(*arguments, **options)
        step = env.unwrapped.step
        env.unwrapped.step = lambda action: executed.append(action) or step(action)
        return env

    monkeypatch.setattr(attempt.gymnasium, "make", listening)
    attempt.run_attempt(LEAP, counting_task, 0, 0)
    joints = np.random.default_rng((0, 0)).normal(size=(9, 23))
    np.testing.assert_array_equal(executed, joints + 0.1)


def test_policies_are_offered_no_privileged_column(counting_task, tmp_path, LeRobotDataset):
    from lerobot.utils.feature_utils import dataset_to_policy_features

    root = tmp_path / "count"
    record.record(config(counting_task, root, episodes=1), [])
    features = load(LeRobotDataset, root).meta.features
    assert {"operator.draft", "contact.loads"} <= features.keys()
    assert {key for key in dataset_to_policy_features(features) if "image" not in key} == {
        "action",
        *(f"observation.{name}" for name in ("state", "tactile", "fingertips", "gravity")),
    }


@pytest.mark.parametrize("source", ["motion", "pressing"])
def test_a_person_per_attempt_leads_the_hand_and_the_draft_is_kept_clean(
    counting_task, tmp_path, monkeypatch, LeRobotDataset, source
):
    monkeypatch.setattr(attempt, "make_expert", lambda task: follow)
    root = tmp_path / "count"
    record.record(config(counting_task, root, episodes=2, glove="novice", interface="raw", source=source), [])
    found = numbers(load(LeRobotDataset, root))
    np.testing.assert_allclose(found["operator.draft"], np.tile(MEASURED, (2, 1)), atol=2.0**-18)
    first, second = found["action"][:9, 23:], found["action"][9:, 23:]
    assert 0.002 < np.abs(first - MEASURED).max() < 0.1  # Late by 3 steps at 1/16 rad each.
    assert np.abs(first - second).max() > 0.001  # Seeds 0 and 1 are two people.
    card = (root / "README.md").read_text()
    assert {"motion": "hold no squeeze", "pressing": "command into the object"}[source] in card
    assert "its glove spoilt them: `novice`" in card
    assert "another person in the glove" in card
    with pytest.raises(DexFlexError, match=r"glove: 'novice' there, 'typical' now"):
        record.record(
            config(counting_task, root, episodes=2, glove="typical", interface="raw", source=source)
        )


def test_the_gloves_noise_is_in_the_labels_and_on_the_card_and_no_other_recording_is_continued(
    counting_task, tmp_path, monkeypatch, LeRobotDataset
):
    monkeypatch.setattr(attempt, "make_expert", lambda task: follow)
    root = tmp_path / "count"
    record.record(config(counting_task, root, episodes=1, glove="noise_4mm", interface="raw"), [])
    actions = numbers(load(LeRobotDataset, root))["action"]
    offset = actions[:, 23:] - MEASURED
    assert 0.003 < np.abs(offset).max() < 0.0045  # The IK may miss by half a millimetre.
    assert np.abs(offset.mean()) < 0.001
    executed = np.stack([fingertips_of(LEAP, joints).ravel() for joints in actions[:, 7:23]])
    np.testing.assert_allclose(actions[:, 23:], executed, atol=1e-5)
    assert "its glove spoilt them: `noise_4mm`" in (root / "README.md").read_text()
    with pytest.raises(DexFlexError, match=r"glove: 'noise_4mm' there, 'clean' now"):
        record.record(config(counting_task, root, episodes=1, interface="raw"), [])


def test_an_interface_decides_what_is_executed_and_recorded(counting_task, tmp_path, LeRobotDataset):
    """At a tiny gain the hand stays where it is measured, however the operator and its glove move."""
    root = tmp_path / "count"
    record.record(config(counting_task, root, episodes=1, glove="noise_4mm", interface="raw@0.001"), [])
    actions = numbers(load(LeRobotDataset, root))["action"]
    np.testing.assert_allclose(actions[:, 23:], MEASURED, atol=3e-3)  # What the IK misses at such a pace.
    assert np.abs(actions[:, :7]).max() > 0.5  # The arm does what the expert says.
    card = (root / "README.md").read_text()
    assert "passed through the interface `raw@0.001`; labels and execution are" in card
    with pytest.raises(DexFlexError, match=r"interface: 'raw@0.001' there, 'joint' now"):
        record.record(config(counting_task, root, episodes=1, glove="noise_4mm"), [])


def test_a_learned_interface_names_its_controller_and_does_not_mix_two(
    counting_task, tmp_path, monkeypatch, LeRobotDataset
):
    root = tmp_path / "count"
    staging.open_staging(config(counting_task, root, interface="dexflex"))
    monkeypatch.setattr(RecordConfig, "controller_digest", property(lambda self: "another"))
    with pytest.raises(DexFlexError, match="was recorded with another controller"):
        record.record(config(counting_task, root, interface="dexflex"), [])


def test_a_recipe_from_before_an_option_means_its_default():
    known = RecordConfig().to_dict()
    assert RecordConfig.identity(
        {k: v for k, v in known.items() if k not in ("glove", "source", "interface")}
    ) == RecordConfig.identity(known)


def test_every_element_is_named(counting_task, tmp_path):
    root = tmp_path / "count"
    record.record(config(counting_task, root, episodes=1), [])
    features = json.loads((root / "meta/info.json").read_text())["features"]
    for key, size in {"state": 23, "tactile": 240, "fingertips": 12, "gravity": 3}.items():
        assert len(set(features[f"observation.{key}"]["names"])) == size
        assert features[f"observation.{key}"]["shape"] == [size]
    names = features["action"]["names"]
    assert len(names) == 35
    assert names[:8] == [*(f"joint{k}.pos" for k in range(1, 8)), "if_mcp.pos"]
    assert names[23:26] == ["if_tip.x", "if_tip.y", "if_tip.z"]
    assert names[-1] == "th_tip.z"
    assert features["observation.images.front"]["info"]["video.codec"] == "h264"


def test_tables_are_compressed_in_one_group_and_lerobot_reads_them(counting_task, tmp_path, LeRobotDataset):
    root = tmp_path / "count"
    record.record(config(counting_task, root), [])
    for folder in ("data", "meta/episodes"):
        found = pq.ParquetFile(root / folder / "chunk-000/file-000.parquet").metadata
        assert found.num_row_groups == 1
        group = found.row_group(0)
        assert {group.column(k).compression for k in range(group.num_columns)} == {"ZSTD"}
    dataset = load(LeRobotDataset, root)
    assert [row["length"] for row in dataset.meta.episodes] == [9] * 4
    assert dataset[35]["episode_index"] == 3
    features = json.loads((root / "meta/info.json").read_text())["features"]
    assert features["observation.images.wrist"]["info"]["video.g"] == 40


def test_statistics_are_those_of_the_numbers(counting_task, tmp_path, LeRobotDataset):
    root = tmp_path / "count"
    record.record(config(counting_task, root), [])
    dataset = load(LeRobotDataset, root)
    for key in ("observation.state", "observation.tactile", "action"):
        values = numbers(dataset)[key].astype(np.float64)
        stats = dataset.meta.stats[key]
        np.testing.assert_allclose(stats["mean"], values.mean(0), atol=1e-5)
        np.testing.assert_allclose(stats["std"], values.std(0), atol=1e-5)
        np.testing.assert_allclose(stats["min"], values.min(0), atol=1e-6)
        np.testing.assert_allclose(stats["max"], values.max(0), atol=1e-6)


def test_an_interrupted_recording_is_loadable_and_continues_to_the_same_data(
    counting_task, tmp_path, monkeypatch, LeRobotDataset
):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    record.record(config(counting_task, whole), [])

    original = attempt.run_attempt

    def interrupted(hand, task, seed, index, **options):
        if index == 4:
            raise KeyboardInterrupt
        return original(hand, task, seed, index, **options)

    monkeypatch.setattr(record, "run_attempt", interrupted)
    assert not record.record(config(counting_task, broken), [])
    assert load(LeRobotDataset, broken).num_episodes == 2
    assert "Unfinished" in (broken / "README.md").read_text()

    recorded = []
    monkeypatch.setattr(
        record,
        "run_attempt",
        lambda hand, task, seed, k, **options: recorded.append(k) or original(hand, task, seed, k),
    )
    assert record.record(config(counting_task, broken), [])
    assert recorded == [4, 5]
    one, other = numbers(load(LeRobotDataset, whole)), numbers(load(LeRobotDataset, broken))
    assert one.keys() == other.keys()
    for key in one:
        np.testing.assert_array_equal(one[key], other[key])
    for video in whole.glob("videos/**/*.mp4"):
        assert video.read_bytes() == (broken / video.relative_to(whole)).read_bytes()
    assert "Unfinished" not in (broken / "README.md").read_text()


def test_a_finished_recording_is_left_alone(counting_task, tmp_path, capsys):
    root = tmp_path / "count"
    record.record(config(counting_task, root, episodes=1), [])
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
    assert record.record(config(counting_task, root, episodes=1), [])
    assert "Nothing to record" in capsys.readouterr().out
    with pytest.raises(DexFlexError, match=r"finished recording of 1 episodes.*changed to\s*2"):
        record.record(config(counting_task, root, episodes=2), [])
    with pytest.raises(DexFlexError, match="seed: 0 there, 7 now"):
        record.record(config(counting_task, root, episodes=1, seed=7), [])
    assert before == {path: path.stat().st_mtime_ns for path in root.rglob("*")}


def test_a_folder_of_something_else_is_refused_and_kept(counting_task, tmp_path):
    root = tmp_path / "thesis"
    root.mkdir()
    (root / "chapter.txt").write_text("years of work")
    with pytest.raises(DexFlexError, match="no recording of dexflex-record"):
        record.record(config(counting_task, root), [])
    assert (root / "chapter.txt").read_text() == "years of work"
    shutil.move(root, tmp_path / "other.partial")
    with pytest.raises(DexFlexError, match="no staging folder"):
        record.record(config(counting_task, tmp_path / "other"), [])
    assert (tmp_path / "other.partial/chapter.txt").read_text() == "years of work"


def test_attempts_of_other_code_are_not_mixed(counting_task, tmp_path, monkeypatch):
    def interrupted(hand, task, seed, index, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(record, "run_attempt", interrupted)
    assert not record.record(config(counting_task, tmp_path / "count"), [])
    monkeypatch.setattr("lerobot_dexflex.recording.staging.code_digest", lambda modules: "changed")
    with pytest.raises(DexFlexError, match="other code"):
        record.record(config(counting_task, tmp_path / "count"), [])


def test_an_expert_that_keeps_failing_ends_in_an_error_with_the_episodes_kept(
    counting_task, tmp_path, LeRobotDataset
):
    root = tmp_path / "count"
    with pytest.raises(DexFlexError, match="only 2 times in 4 attempts"):
        record.record(config(counting_task, root, max_attempts=4), [])
    assert load(LeRobotDataset, root).num_episodes == 2
    assert record.record(config(counting_task, root, max_attempts=6), [])
    assert load(LeRobotDataset, root).num_episodes == 4


def test_the_recipe_in_the_dataset_records_it_again(counting_task, tmp_path):
    import draccus

    root = tmp_path / "count"
    original = config(counting_task, root, episodes=1, seed=5)
    record.record(original, [])
    assert draccus.parse(RecordConfig, config_path=root / "recipe.yaml", args=[]) == original
    front_matter = yaml.safe_load((root / "README.md").read_text().split("---")[1])
    assert front_matter["license"] == "apache-2.0"
    assert front_matter["task_categories"] == ["robotics"]
    assert "LeRobot" in front_matter["tags"]
    assert "1 of 1 attempts succeeded" in (root / "README.md").read_text()


def test_a_recording_of_another_hand_has_its_columns_its_name_and_a_card_that_says_so(
    counting_task, tmp_path, LeRobotDataset
):
    root = tmp_path / "count"
    assert record.record(config(counting_task, root, hand="sharpa", episodes=1), [])
    dataset = load(LeRobotDataset, root)
    assert dataset.meta.robot_type == "sharpa_xarm7"
    shapes = {key: dataset[0][key].shape for key in ("action", "observation.tactile", "contact.loads")}
    assert shapes == {"action": (29 + 15,), "observation.tactile": (300,), "contact.loads": (5,)}
    assert dataset.meta.features["action"]["names"][7] == "index_MCP_FE.pos"
    joints = np.random.default_rng((0, 0)).normal(size=(9, 29))[0, 7:]
    np.testing.assert_allclose(
        dataset[0]["action"][29:], fingertips_of(SHARPA, joints).ravel(), atol=2.0**-18
    )
    assert "on a tactile SHARPA hand on an xArm7" in (root / "README.md").read_text()
    with pytest.raises(DexFlexError, match="hand"):
        record.record(config(counting_task, root, episodes=1), [])
    demonstrations = load_demonstrations(root)
    assert demonstrations.hand is SHARPA
    assert demonstrations.played("measured")[0].shape == (9, 29 + 15)
    state = {"agent_pos": np.array([[*np.zeros(7), *SHARPA.nominal_joints]])}
    controller = ReplayController(SHARPA, demonstrations.actions[0], "joint")
    controller.reset([0])
    targets = controller.act(state, "")
    assert targets.shape == (1, 29)
    np.testing.assert_array_equal(targets[:, :7], demonstrations.actions[0][:1, :7])
