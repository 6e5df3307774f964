"""Every task with every hand: what a hand changes, and that nothing else depends on it."""

import gymnasium
import numpy as np
import pytest
from env_checks import make_env, same, wiggle

from lerobot_dexflex.envs.disturbance import DISTURBANCES
from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.place_hammer import PlaceHammerEnv
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.model import tip_geoms
from lerobot_dexflex.hands import HANDS, LEAP, SHARPA

SEED = 3


@pytest.fixture(scope="module", params=TASKS)
def sharpa_env(request):
    return make_env(request.param, cameras=(), hand="sharpa")


def deepest(env: HandEnv) -> float:
    """Return the deepest contact of the robot [m], negative where it penetrates."""
    robot = np.flatnonzero(env.model.body_rootid == env.model.body("palm").rootid[0])
    depths = [c.dist for c in env.data.contact if np.isin(env.model.geom_bodyid[c.geom], robot).any()]
    return min(depths, default=0.0)


def test_another_hand_starts_without_touching_what_it_should_not(sharpa_env):
    for seed in range(SEED, SEED + 3):
        observation, info = sharpa_env.reset(seed=seed)
        assert sharpa_env.observation_space.contains(observation)
        assert deepest(sharpa_env) > -0.001
        assert info["contacts"].shape == (6,)
        assert info["contacts"][:5].any() == (sharpa_env.task == "Reach-v0")
        assert not info["is_success"]


def test_another_hand_steps_deterministically_and_snapshots_repeat_it(sharpa_env):
    sharpa_env.reset(seed=SEED)
    snapshot = sharpa_env.snapshot()
    first = wiggle(sharpa_env, 3)
    sharpa_env.restore(snapshot)
    assert same(wiggle(sharpa_env, 3), first)
    assert sharpa_env.pad_forces.shape == (5,)


@pytest.mark.parametrize("task", [task for task in TASKS if task != "Reach-v0"])
def test_the_scene_does_not_depend_on_the_hand(task):
    envs = [make_env(task, cameras=(), hand=hand) for hand in (LEAP, SHARPA)]
    for env in envs:
        env.reset(seed=SEED)
    assert envs[0].episode == envs[1].episode
    poses = [env.data.body(env.manipulated).xpos for env in envs]
    np.testing.assert_allclose(*poses, atol=1e-9)


@pytest.mark.parametrize("hand", HANDS.values(), ids=HANDS)
def test_hands_are_given_by_name_or_as_they_are(hand):
    by_name, itself = PlaceHammerEnv(cameras=(), hand=hand.name), PlaceHammerEnv(cameras=(), hand=hand)
    assert by_name.hand is itself.hand is hand
    assert by_name.joints == TASKS["PlaceHammer-v0"].joints(hand)
    assert by_name.joints[7:] == hand.joint_names
    assert by_name.action_space.shape == (7 + hand.n_joints,)
    assert isinstance(itself.action_space, gymnasium.spaces.Box)
    np.testing.assert_allclose(itself.action_space.low[7:], hand.joint_lower, atol=1e-6)


def test_an_unknown_hand_is_refused_with_the_known_ones():
    with pytest.raises(DexFlexError, match=r"no hand 'paw'. Choose from .*'leap', 'sharpa'"):
        gymnasium.make("lerobot_dexflex/Reach-v0", hand="paw")


def test_a_snapshot_of_another_hand_is_refused():
    envs = [PlaceHammerEnv(cameras=(), hand=hand) for hand in (LEAP, SHARPA)]
    for env in envs:
        env.reset(seed=SEED)
    with pytest.raises(DexFlexError, match="of the hand 'sharpa', this environment has 'leap'"):
        envs[0].restore(envs[1].snapshot())


def test_disturbances_reach_every_finger_of_the_hand():
    calm, slippery, wrong = (
        PlaceHammerEnv(cameras=(), hand=SHARPA, disturbance=name)
        for name in ("none", "slippery", "miscalibrated")
    )
    for env in (calm, slippery, wrong):
        env.reset(seed=SEED)
    tips = [calm.model.geom(name).id for name in tip_geoms(SHARPA)]
    assert len(tips) == 5
    np.testing.assert_allclose(
        slippery.model.geom_friction[tips, 0],
        DISTURBANCES["slippery"].friction * calm.model.geom_friction[tips, 0],
    )
    assert np.unique(wrong.memory["encoder_errors"]).shape == (22,)


@pytest.mark.parametrize("task", ["Reach-v0", "PourCup-v0"])
def test_the_cameras_of_the_palm_see_what_the_hand_grasps(task):
    """A point in the middle of the grasp is at the same place of both hands' images."""
    from lerobot_dexflex.hand.grasp_frame import grasp_frame

    seen = []
    for hand in (LEAP, SHARPA):
        env = make_env(task, cameras=("wrist",), hand=hand)
        env.reset(seed=SEED)
        palm, camera = env.data.body("palm"), env.data.camera("wrist")
        centre = palm.xpos + palm.xmat.reshape(3, 3) @ grasp_frame(hand).centre
        seen.append(camera.xmat.reshape(3, 3).T @ (centre - camera.xpos))
    np.testing.assert_allclose(*seen, atol=1e-6)
    assert seen[0][2] < -0.1
