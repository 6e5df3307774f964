import numpy as np
import torch

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.schema import check_rows
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.hand.kinematics import solve_fingertips


def test_a_recorded_episode_obeys_the_schema(run):
    shard = run.finish()
    check_rows(shard.tensors, shard.episodes)
    assert len(shard.tensors["step"]) == 40
    assert shard.tensors["snapshot_step"].tolist() == [0, 8, 16, 24, 32]
    assert shard.episodes[0]["seed"] == 4
    assert (shard.tensors["gravity"][0] != shard.tensors["gravity"][-1]).any()


def test_rows_chain_and_say_who_was_executed(run):
    rows = run.finish().tensors
    moved = (rows["command"][:-1].astype(float) + rows["executed"][:-1]).astype(np.float32)
    np.testing.assert_array_equal(rows["command"][1:], moved)
    spoilt = np.arange(40) // 8 == 1
    np.testing.assert_array_equal(rows["expert"], ~spoilt)
    np.testing.assert_array_equal(rows["executed"][spoilt], rows["draft"][spoilt])
    np.testing.assert_array_equal(rows["executed"][~spoilt], rows["label"][~spoilt])
    np.testing.assert_array_equal(rows["joint_targets"][~spoilt], rows["label_joints"][~spoilt])
    assert (rows["joint_targets"][spoilt] != rows["label_joints"][spoilt]).any()


def test_joint_targets_are_those_of_the_raw_interface(run):
    rows = run.finish().tensors
    target = torch.from_numpy(rows["command"][9].astype(float) + rows["executed"][9])[None]
    previous = torch.from_numpy(rows["joint_targets"][8].astype(float))[None]
    np.testing.assert_allclose(solve_fingertips(target, previous)[0], rows["joint_targets"][9], atol=1e-6)


def test_a_held_object_is_not_lost_and_a_released_one_is(episode):
    run = RunningEpisode(CorpusEnv(), episode, World(), 1, {})
    assert (run.now.loads > 0.05).sum() >= 3
    run.step(np.zeros((4, 3)), np.zeros((4, 3)))
    assert run.lost_steps == 0
    for _ in range(12):
        release = -0.003 * run.now.inward
        run.step(release, release)
    assert run.lost_steps > 0
    lost = run.finish().tensors["lost"]
    assert not lost[0]
    assert lost[-1]
