"""PourCup: balls that stay where they belong and in snapshots, and a success that means poured."""

import numpy as np
import pytest
from env_checks import same, wiggle

from lerobot_dexflex.envs.pour_cup import BOWL_RADIUS, PITCHER_HEIGHT, PITCHER_RADIUS, PourCupEnv

SEED = 7


@pytest.fixture(scope="module")
def env():
    return PourCupEnv(cameras=())


def test_an_episode_starts_unsolved_with_the_flange_pointing_forward(env):
    observation, info = env.reset(seed=SEED)
    assert env.observation_space.contains(observation)
    assert info.pop("contacts").tolist() == [False, False, False, False, True]  # Table and balls.
    assert info == {
        "is_success": False,
        "progress": 0.0,
        "dropped": False,
        "holding": False,
        "balls_in_bowl": 0,
    }
    # The handle's bar runs along palm y, so gravity points along -y.
    assert observation["gravity"] @ np.array([0, -1, 0]) > 0.98


def test_the_balls_rest_in_the_pitcher_at_the_start(env):
    for seed in range(3):
        env.reset(seed=seed)
        position, rotation = env.pitcher_pose
        local = (env.ball_positions - position) @ rotation
        assert len(local) == env.episode.balls
        assert (np.linalg.norm(local[:, :2], axis=1) < PITCHER_RADIUS).all()
        assert (local[:, 2] > 0).all()
        assert (local[:, 2] < PITCHER_HEIGHT / 2).all()
        assert rotation[2, 2] > 0.999
        assert np.linalg.norm(position - (*env.episode.pitcher[:2], 0)) < 1e-3


def test_a_restored_snapshot_replays_every_ball_bit_for_bit_also_in_another_environment(env):
    env.reset(seed=SEED)
    kick = env.data.joint("pitcher").qvel
    kick[:] = (0.3, 0, 0, 0, 4.0, 0)  # So that the balls roll.
    wiggle(env, 3)
    snapshot = env.snapshot()
    expected = wiggle(env, 6, seed=1)
    balls = env.ball_positions
    other = PourCupEnv(cameras=())
    other.reset(seed=SEED + 1)
    for again in (env, other):
        again.restore(snapshot)
        assert same(wiggle(again, 6, seed=1), expected)
        assert np.array_equal(again.ball_positions, balls)


def arrange(env: PourCupEnv, in_bowl: int, on_table: int = 0, lying: bool = False) -> dict:
    """Put balls into the bowl and onto the table, the pitcher in front of the hand, and let it settle."""
    env.reset(seed=SEED)
    for k in range(in_bowl):
        layer, place = divmod(k, 6)
        angle = np.pi * place / 3
        x, y = env.episode.bowl
        start = (x + 0.03 * np.cos(angle), y + 0.03 * np.sin(angle), 0.02 + 0.02 * layer)
        env.data.joint(f"ball{k}").qpos[:3] = start
    for k in range(in_bowl, in_bowl + on_table):
        env.data.joint(f"ball{k}").qpos[:3] = (0.4 + 0.03 * k, 0.35, 0.0076)
    if lying:
        env.data.joint("pitcher").qpos[:] = (0.65, 0.2, 0.044, np.sqrt(0.5), np.sqrt(0.5), 0, 0)
    info = {}
    for _ in range(30):
        *_, done, _, info = env.step(env.command)
        if done:
            break
    return info


def test_enough_balls_in_the_bowl_and_the_pitcher_let_go_is_a_success_after_half_a_second(env):
    env.reset(seed=SEED)
    info = arrange(env, in_bowl=int(np.ceil(0.8 * env.episode.balls)))
    assert info["is_success"]
    assert info["progress"] == 1
    assert env.data.time >= 0.5


def test_one_ball_too_few_is_no_success(env):
    env.reset(seed=SEED)
    few = int(np.ceil(0.8 * env.episode.balls)) - 1
    info = arrange(env, in_bowl=few)
    assert info["balls_in_bowl"] == few
    assert not info["is_success"]
    assert not info["dropped"]


def test_spilling_more_than_a_fifth_of_the_balls_ends_the_episode(env):
    env.reset(seed=SEED)
    allowed = env.episode.balls - int(np.ceil(0.8 * env.episode.balls))
    assert not arrange(env, in_bowl=0, on_table=allowed)["dropped"]
    info = arrange(env, in_bowl=0, on_table=allowed + 1)
    assert info["dropped"]
    assert not info["is_success"]


def test_a_pitcher_lying_on_the_table_ends_the_episode(env):
    env.reset(seed=SEED)
    info = arrange(env, in_bowl=env.episode.balls, lying=True)
    assert info["dropped"]
    assert not info["is_success"]


def test_the_scene_is_that_of_its_episode(env):
    env.reset(seed=SEED)
    episode, model = env.episode, env.model
    assert model.body("pitcher").mass[0] == pytest.approx(episode.mass)
    assert model.body("ball0").mass[0] == pytest.approx(episode.ball_mass)
    assert model.geom("if_tip").friction[0] == episode.tip_friction
    assert np.array_equal(model.body("bowl").pos[:2], episode.bowl)
    assert sum(model.body(k).name.startswith("ball") for k in range(model.nbody)) == episode.balls
    # The bowl is round and closed: its walls' upper edges lie on the rim.
    walls = [env.data.geom(f"bowl_wall{k}") for k in range(16)]
    tops = [w.xpos + w.xmat.reshape(3, 3)[:, 2] * model.geom("bowl_wall0").size[2] for w in walls]
    assert np.allclose(np.linalg.norm(np.array(tops)[:, :2] - episode.bowl, axis=1), BOWL_RADIUS, atol=1e-4)
