import copy

import pytest
import torch
from draccus.utils import ParsingError
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from lerobot_dexflex.errors import DexFlexError
from lerobot_policy_dexflex import DexflexEnvConfig, DexflexFlowConfig
from lerobot_policy_dexflex.compatibility import check_dataset
from lerobot_policy_dexflex.modeling_dexflex_flow import DexflexFlowPolicy


@pytest.fixture
def meta(synthetic_dataset):
    return LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=synthetic_dataset)


def test_a_dataset_in_our_schema_is_accepted(meta):
    check_dataset(meta)


def test_another_robot_is_refused(meta):
    meta.info.robot_type = "so101"
    with pytest.raises(DexFlexError, match="robot_type is 'so101', but dexflex_flow drives leap_xarm7"):
        check_dataset(meta)


def test_another_rate_is_refused(meta):
    meta.info.fps = 30
    with pytest.raises(DexFlexError, match="runs at 30 fps, but the hand at 20"):
        check_dataset(meta)


def test_a_missing_observation_is_refused(meta):
    meta.info.features = {k: v for k, v in meta.features.items() if k != "observation.tactile"}
    with pytest.raises(DexFlexError, match=r"lacks 'observation.tactile' \(taxel normal forces"):
        check_dataset(meta)


@pytest.mark.parametrize("key", ["action", "observation.state"])
def test_joints_of_another_order_are_refused(meta, key):
    meta.info.features = copy.deepcopy(meta.features)
    meta.features[key]["names"] = meta.features[key]["names"][::-1]
    with pytest.raises(DexFlexError, match=rf"elements of the dataset's '{key}' must be named"):
        check_dataset(meta)


def test_a_policy_refuses_a_foreign_dataset_when_it_is_built(build, meta):
    meta.info.robot_type = "so101"
    with pytest.raises(DexFlexError, match="so101"):
        build(meta)


def test_an_environment_without_touch_is_refused(tiny):
    env = DexflexEnvConfig()
    del env.features["tactile"]
    with pytest.raises(DexFlexError, match=r"Missing: observation.tactile. Got: observation.fingertips"):
        make_policy(DexflexFlowConfig(**tiny), env_cfg=env)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"interface": "psychic"},
            r"Unknown interface 'psychic' in 'psychic'\. Valid: joint, raw, filter",
        ),
        ({"action_space": "torque"}, r"`action_space` must be one of joint, draft.*Got 'torque'"),
        ({"n_action_steps": 17}, r"between 1 and `chunk_size` \(16\)\. Got 17"),
        ({"chunk_size": 15}, r"`chunk_size` must be even. Got 15"),
        ({"dim": 33}, r"multiple of `n_heads`"),
        ({"touch_dropout": 1.5}, r"`touch_dropout` must be in \[0, 1\]"),
        ({"euler_steps": 11}, r"`euler_steps` must be at most 10"),
        ({"noise_draws": 0}, r"`noise_draws` must be at least 1"),
        ({"normalization_mapping": {"STATE": "MEAN_STD"}}, "must be IDENTITY"),
    ],
)
def test_settings_that_cannot_work_are_refused(settings, message):
    with pytest.raises(ParsingError, match=message):
        DexflexFlowConfig(device="cpu", **settings)


def test_the_hand_without_an_arm_is_driven_too(tiny):
    config = DexflexFlowConfig(**tiny, interface="raw")
    policy = make_policy(config, env_cfg=DexflexEnvConfig(task="Reach-v0")).eval()
    assert isinstance(policy, DexflexFlowPolicy)
    observation = {key: torch.zeros(2, *ft.shape) for key, ft in (config.input_features or {}).items()}
    assert policy.select_action(observation).shape == (2, 16)
    assert policy.normalization.columns == list(range(16, 28))
