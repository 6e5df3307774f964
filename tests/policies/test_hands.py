"""A policy of another hand: trained on its dataset, executed on its robot, refused elsewhere by name."""

import numpy as np
import pytest
import torch
from draccus.utils import ParsingError
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies import make_policy
from lerobot.policies.factory import make_pre_post_processors

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.policies import LeRobotPolicies
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_policy_dexflex import DexflexAdapterConfig, DexflexEnvConfig, DexflexFlowConfig
from lerobot_policy_dexflex.interface_steps import InterfaceProcessorStep
from lerobot_policy_dexflex.measured_tips import add_measured_tips

REPO = "lerobot-dexflex/synthetic"


@pytest.fixture(scope="module")
def dataset(make_dataset, tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("datasets") / "sharpa", hand=SHARPA)


@pytest.fixture
def meta(dataset):
    return LeRobotDatasetMetadata(REPO, root=dataset)


@pytest.fixture
def policy(meta, tiny):
    torch.manual_seed(0)
    config = DexflexFlowConfig(**tiny, cache_dataset=False, interface="raw", hand="sharpa")
    return make_policy(config, ds_meta=meta)


def samples(dataset):
    windows = {"action": [k / 20 for k in range(24)]}
    items = LeRobotDataset(REPO, root=dataset, delta_timestamps=windows, video_backend="pyav")
    add_measured_tips(items.meta)
    return torch.utils.data.default_collate([items[row] for row in (0, 12, 30, 50)])


def test_it_learns_plans_of_all_joints_and_fingertips(policy, dataset):
    batch = samples(dataset)
    assert policy.plan.size == 7 + SHARPA.n_joints + 2 * 3 * SHARPA.n_fingers
    optimizer = torch.optim.Adam(policy.get_optim_params(), lr=2e-3)
    losses = []
    for _ in range(12):
        loss, _ = policy.train().forward(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-3:]) < 0.8 * np.mean(losses[:3])


def test_raw_leads_all_five_fingertips_where_they_are_planned(policy, dataset):
    batch = {key: value for key, value in samples(dataset).items() if key.startswith("observation.")}
    joints = torch.tensor(SHARPA.nominal_joints).expand(4, -1)
    batch["observation.state"] = torch.cat([torch.zeros(4, 7), joints], 1)
    wanted = fingertips(SHARPA, joints + 0.03).flatten(1)
    chunk = torch.cat([torch.zeros(4, 7), wanted], 1)[:, None].expand(-1, 24, -1)
    policy.reset()
    policy.execution.begin(chunk)
    targets = batch["observation.state"]
    for _ in range(3):
        targets = policy.execution.step(batch)
        batch["observation.state"] = targets
    assert targets.shape == (4, 7 + SHARPA.n_joints)
    torch.testing.assert_close(fingertips(SHARPA, targets[:, 7:]).flatten(1), wanted, atol=1e-3, rtol=0)


def test_datasets_environments_and_checkpoints_of_another_hand_are_refused(meta, policy, tiny, tmp_path):
    config = DexflexFlowConfig(**tiny, cache_dataset=False)
    with pytest.raises(DexFlexError, match=r"robot_type is 'sharpa_xarm7'.*Give --policy.hand=sharpa"):
        make_policy(config, ds_meta=meta)
    policy.save_pretrained(tmp_path)
    for processor in make_pre_post_processors(policy.config):
        processor.save_pretrained(tmp_path)
    with pytest.raises(DexFlexError, match=r"for the hand 'sharpa', not 'leap'. Give --hand=sharpa"):
        LeRobotPolicies(LEAP, tmp_path).check(["raw"])
    LeRobotPolicies(SHARPA, tmp_path).check(["raw"])
    environment = DexflexEnvConfig(task="PlaceHammer-v0")
    with pytest.raises(DexFlexError, match=r"drives 29 joints, but .* \(23,\). It fits .* --env.hand=sharpa"):
        make_policy(policy.config, env_cfg=environment)


@pytest.mark.parametrize("config", [DexflexFlowConfig, DexflexAdapterConfig])
def test_a_hand_that_there_is_none_is_refused(config):
    with pytest.raises(ParsingError, match=r"--policy.hand: There is no hand 'claw'. Choose from"):
        config(device="cpu", hand="claw")


def test_an_interface_in_a_pipeline_serves_the_hand_that_it_is_told():
    step = InterfaceProcessorStep("raw", hand="sharpa")
    joints = torch.tensor(SHARPA.nominal_joints)[None]
    wanted = fingertips(SHARPA, joints + 0.01).flatten(1)
    action = torch.cat([torch.zeros(1, 7), wanted], 1)
    observation = {"observation.state": torch.cat([torch.zeros(1, 7), joints], 1)}
    done = step({"observation": observation, "action": action})  # pyright: ignore[reportArgumentType]
    got = fingertips(SHARPA, done["action"][:, 7:]).flatten(1)
    torch.testing.assert_close(got, wanted, atol=1e-3, rtol=0)
    assert step.get_config()["hand"] == "sharpa"
