import numpy as np
import pytest

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.corpus.schema import OPERATED, SNAPSHOT_INTERVAL, check_rows
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.envs.reach import ReachEpisode
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts.reach.operator import Guidance, Operator
from lerobot_dexflex.hand import kernels

HALF, SINGLE = 1e-5, 1e-7
"""What float16 displacements [m] and float32 positions [m] lose."""


def test_a_recorded_episode_obeys_the_schema_and_rebuilds_its_simulator(hand, seed, recorded, episode, world):
    shard = recorded.shard
    assert shard.hand == hand
    check_rows(*shard[:3])
    assert len(shard.tensors["step"]) == 40
    assert shard.tensors["snapshot_step"].tolist() == [0, 8, 16, 24, 32]
    assert (shard.tensors["gravity"][0] != shard.tensors["gravity"][-1]).any()
    metadata = shard.episodes[0]
    assert (metadata["seed"], metadata["kind"], metadata["rows"]) == (seed, OPERATED, 40)
    assert ReachEpisode.from_dict(metadata["episode"]) == episode
    assert World.from_dict(metadata["world"]) == world


def test_a_row_holds_the_state_before_the_step_and_what_is_wanted_in_it(recorded):
    rows = recorded.shard.tensors
    for k, (guidance, draft, now) in enumerate(zip(*recorded[1:4], strict=True)):
        np.testing.assert_allclose(rows["plan"][k], guidance.tips - now.tips, atol=HALF)
        np.testing.assert_allclose(rows["draft"][k], draft, atol=HALF)
        np.testing.assert_allclose(rows["forces"][k], guidance.forces, atol=1e-6)
        np.testing.assert_allclose(rows["loads"][k], now.loads, rtol=1e-6)
        np.testing.assert_allclose(rows["object"][k], [*now.position, *now.quaternion], atol=SINGLE)
    assert np.abs(rows["forces"]).max() > 1.0
    grips = np.array([guidance.grip for guidance in recorded.guidances])
    assert np.abs(grips - rows["forces"]).max() > 0.1  # What is right is recorded, not what is exerted.


def test_wanted_is_where_the_tips_are_plus_the_executed_motion(recorded):
    rows, spoilt = recorded.shard.tensors, recorded.spoilt
    np.testing.assert_array_equal(rows["expert"], ~spoilt)
    for k, (guidance, draft, now) in enumerate(zip(*recorded[1:4], strict=True)):
        motion = draft[0] if spoilt[k] else guidance.tips[0] - now.tips
        np.testing.assert_allclose(rows["wanted"][k], now.tips + motion, atol=SINGLE)
    own = np.array([guidance.tips[0] for guidance in recorded.guidances])
    np.testing.assert_array_equal(np.abs(rows["wanted"] - own).max((1, 2)) > 1e-5, spoilt)


def test_the_operators_own_joints_are_executed_or_the_draft_with_its_grip(hand, recorded):
    for k, (guidance, draft, now) in enumerate(zip(*recorded[1:4], strict=True)):
        executed = recorded.shard.tensors["joint_targets"][k]
        if not recorded.spoilt[k]:
            np.testing.assert_array_equal(executed, guidance.joints.astype(np.float32))
            continue
        torques = kernels.contact_torques(hand.tables, now.joints, guidance.points, guidance.grip)
        assert (np.abs(torques) < hand.grip_torques).all()  # The grip's bound is not reached here.
        posture = kernels.solve_fingertips(hand.tables, now.tips + draft[0], now.joints)
        led = np.clip(posture + torques / hand.position_gains, hand.joint_lower, hand.joint_upper)
        np.testing.assert_allclose(executed, led, atol=1e-6)


def test_executed_joints_reproduce_the_episode_bit_for_bit_from_every_snapshot(hand, recorded):
    rows, metadata, n = recorded.shard.tensors, recorded.shard.episodes[0], hand.n_joints
    env, starts = CorpusEnv(hand), rows["snapshot_step"].tolist()
    env.start(ReachEpisode.from_dict(metadata["episode"]), World.from_dict(metadata["world"]))
    for k in reversed(range(len(starts))):  # Backward: nothing may depend on what was before.
        env.rewind(starts[k], rows["snapshot_physics"][k], rows["snapshot_command"][k])
        for step in range(starts[k], starts[k] + SNAPSHOT_INTERVAL):
            np.testing.assert_array_equal(env.data.qpos[:n], recorded.states[step].joints)
            np.testing.assert_array_equal(env.data.qpos[n : n + 3], recorded.states[step].position)
            env.advance(rows["joint_targets"][step])
        if k + 1 < len(starts):
            np.testing.assert_array_equal(env.physics_state(), rows["snapshot_physics"][k + 1])
            np.testing.assert_array_equal(env.command, rows["snapshot_command"][k + 1])


def test_a_snapshot_of_another_simulator_is_refused(hand, episode):
    env = CorpusEnv(hand)
    env.start(episode, World())
    with pytest.raises(DexFlexError, match="generate the corpus again"):
        env.rewind(0, np.zeros(3), np.zeros(hand.n_joints))


def test_a_lifted_finger_is_not_to_press_and_the_others_are(hand, episode):
    run = RunningEpisode(CorpusEnv(hand), episode, World(), OPERATED, {})
    operator = Operator(run.senses, np.random.default_rng(0))
    lifted = []
    for k in range(60):
        if k % 10 == 9 and not operator.gaiting:
            operator.try_gait()
        guidance = operator.guide(run.now)
        lifted.append(operator.fingers.mode > 0)
        run.step(guidance, guidance.tips - run.now.tips, spoilt=False)
    forces, up = np.linalg.norm(run.finish().tensors["forces"], axis=-1), np.array(lifted)
    assert up.any(1).sum() > 3
    assert not forces[up].any()
    assert (forces.sum(1) > 1.0).all()


def test_a_held_object_is_not_lost_and_a_released_one_is(hand, episode):
    run = RunningEpisode(CorpusEnv(hand), episode, World(), OPERATED, {})
    guidance = Operator(run.senses, np.random.default_rng(0)).guide(run.now)
    run.step(guidance, guidance.tips - run.now.tips, spoilt=False)
    assert run.lost_steps == 0
    nothing, inward = np.zeros((hand.n_fingers, 3)), run.now.inward
    for _ in range(12):
        tips = np.tile(run.now.tips - 0.003 * inward, (8, 1, 1))
        joints = kernels.solve_fingertips(hand.tables, tips[0], run.now.joints)
        opened = Guidance(tips, nothing, nothing, run.now.tips, joints)
        run.step(opened, tips - run.now.tips, spoilt=False)
    lost = run.finish().tensors["lost"]
    assert not lost[0]
    assert lost[-1]
    assert run.lost_steps > 0
