from typing import Any

import gymnasium
import numpy as np
import pytest
from draccus.utils import ParsingError
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from lerobot.envs import make_env
from lerobot.envs.utils import NEW_ROLLOUT_OPTION, env_to_policy_features

from lerobot_dexflex.envs.registration import TASKS
from lerobot_policy_dexflex import DexflexEnvConfig


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize(
    ("hand", "of_hand", "taxels", "tips"), [("leap", 16, 240, 12), ("sharpa", 22, 300, 15)]
)
def test_features_are_named_as_in_the_dataset(task, hand, of_hand, taxels, tips):
    features = env_to_policy_features(DexflexEnvConfig(task=task, hand=hand))
    joints = of_hand if task == "Reach-v0" else 7 + of_hand
    assert {key: tuple(feature.shape) for key, feature in features.items()} == {
        "action": (joints,),
        "observation.state": (joints,),
        "observation.tactile": (taxels,),
        "observation.fingertips": (tips,),
        "observation.gravity": (3,),
        "observation.images.front": (3, 96, 96),
        "observation.images.wrist": (3, 96, 96),
    }


@pytest.mark.parametrize(
    ("options", "images"),
    [
        ({"cameras": ["wrist"]}, {"wrist": 96}),
        ({"image_size": 128}, {"front": 128, "wrist": 128}),
        ({"image_size": 64, "cameras": ["front"]}, {"front": 64}),
        ({"cameras": []}, {}),
    ],
)
def test_features_are_what_the_environment_offers_under_its_options(options, images):
    config = DexflexEnvConfig(options=options)
    features = env_to_policy_features(config)
    seen = {key: ft.shape for key, ft in features.items() if key.startswith("observation.images.")}
    assert seen == {f"observation.images.{name}": (3, size, size) for name, size in images.items()}
    vector = config.create_envs(1)["dexflex"][0]
    offered = vector.single_observation_space
    assert isinstance(offered, gymnasium.spaces.Dict)
    pixels = offered.spaces.get("pixels", gymnasium.spaces.Dict())
    assert isinstance(pixels, gymnasium.spaces.Dict)
    assert {name: space.shape for name, space in pixels.items()} == {
        name: (size, size, 3) for name, size in images.items()
    }
    vector.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cameras": ["top"]}, r"`cameras` .* must be a list of front, wrist. Got \['top'\]"),
        ({"cameras": "front"}, r"must be a list of front, wrist. Got 'front'"),
        ({"cameras": 3}, r"must be a list of front, wrist. Got 3"),
        ({"image_size": "96"}, r"`image_size` .* must be a number of pixels. Got '96'"),
        ({"image_size": 0}, r"must be a number of pixels. Got 0"),
        (
            {"camera": ["front"]},
            r"PlaceHammer-v0 has no camera. Valid options: cameras, disturbance, image_size",
        ),
    ],
)
def test_options_that_no_environment_has_are_refused(options, message):
    with pytest.raises(ParsingError, match=message):
        DexflexEnvConfig(options=options)


def test_options_of_one_task_are_valid_for_it_alone():
    assert DexflexEnvConfig(task="Reach-v0", options={"goals": 2}).gym_kwargs["goals"] == 2
    with pytest.raises(ParsingError, match="PourCup-v0 has no goals"):
        DexflexEnvConfig(task="PourCup-v0", options={"goals": 2})


def test_an_unknown_task_is_refused_with_the_valid_ones():
    with pytest.raises(ParsingError, match=rf"'PlaceHamer-v0'.*--env.task: {', '.join(TASKS)}"):
        DexflexEnvConfig(task="PlaceHamer-v0")


def test_the_time_limit_is_the_tasks_own_unless_told():
    assert DexflexEnvConfig().gym_kwargs["max_episode_steps"] == TASKS["PlaceHammer-v0"].max_episode_steps
    config = DexflexEnvConfig(episode_length=7, options={"render_size": 64})
    others = {"render_mode": "rgb_array", "render_size": 64, "hand": "leap"}
    assert config.gym_kwargs == others | {"max_episode_steps": 7}
    with pytest.raises(ParsingError, match=r"at least 1. Got 0"):
        DexflexEnvConfig(episode_length=0)


def test_a_policy_whose_post_processor_makes_joint_targets_has_an_action_of_another_size():
    assert env_to_policy_features(DexflexEnvConfig(action_size=19))["action"].shape == (19,)
    for task, hand, valid in (
        ("PourCup-v0", "leap", "23, 19, 35"),
        ("Reach-v0", "leap", "16, 12, 28"),
        ("PourCup-v0", "sharpa", "29, 22, 44"),
    ):
        with pytest.raises(ParsingError, match=f"`action_size` of {task} must be {valid} or 0. Got 7"):
            DexflexEnvConfig(task=task, hand=hand, action_size=7)


def test_the_environment_has_the_hand_that_is_named():
    vector: Any = DexflexEnvConfig(task="Reach-v0", hand="sharpa", options={"cameras": []}).create_envs(1)
    assert vector["dexflex"][0].call("hand")[0].name == "sharpa"
    with pytest.raises(ParsingError, match=r"--env.hand: There is no hand 'leapt'. Choose from .*'leap'"):
        DexflexEnvConfig(hand="leapt")


@pytest.mark.parametrize("asynchronous", [False, True])
def test_the_task_is_made_and_a_finished_episode_freezes(asynchronous):
    config = DexflexEnvConfig(episode_length=2)
    vector = make_env(config, n_envs=2, use_async_envs=asynchronous)["dexflex"][0]
    assert isinstance(vector, SyncVectorEnv | AsyncVectorEnv)
    try:
        observation, info = vector.reset(seed=[1, 2], options={NEW_ROLLOUT_OPTION: True})
        assert observation["pixels"]["front"].shape == (2, 96, 96, 3)
        assert not info["is_success"].any()
        assert list(vector.call("task")) == ["PlaceHammer-v0"] * 2
        assert observation["frame_index"].tolist() == [[0], [0]]
        action = observation["agent_pos"]
        assert not vector.step(action)[3].any()
        last, _, _, truncated, _ = vector.step(action)
        assert truncated.all()
        for _ in range(2):
            frozen, reward, *_ = vector.step(action)
            np.testing.assert_array_equal(frozen["agent_pos"], last["agent_pos"])
            assert frozen["frame_index"].tolist() == [[2], [2]]
            assert not reward.any()
        anew, _ = vector.reset(options={NEW_ROLLOUT_OPTION: True})
        assert anew["frame_index"].tolist() == [[0], [0]]
    finally:
        vector.close()


def test_the_vector_environment_does_not_reset_within_a_step():
    vector = DexflexEnvConfig().create_envs(1)["dexflex"][0]
    assert vector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert "lerobot_dexflex/PlaceHammer-v0" in gymnasium.registry
    vector.close()
