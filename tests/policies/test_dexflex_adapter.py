"""Any chunking policy of LeRobot below any interface."""

import shutil

import numpy as np
import pytest
import torch
from draccus.utils import ParsingError
from lerobot.configs import FeatureType, PolicyFeature

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.policies import AdaptedPolicies
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP


@pytest.mark.parametrize("interface", ["joint", "raw", "press", "dexgen", "dexflex"])
def test_one_checkpoint_serves_every_interface(adapter, observation, interface):
    policy = adapter(interface=interface)
    before = {key: value.clone() for key, value in policy.state_dict().items()}
    targets = torch.stack([policy.select_action(observation) for _ in range(9)])  # Into the second chunk.
    assert targets.shape == (9, 4, 23)
    assert torch.isfinite(targets).all()
    assert all(torch.equal(value, before[key]) for key, value in policy.state_dict().items())


def test_the_plan_is_the_backbones_in_raw_units(adapter, backbone, observation):
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    act = ACTPolicy.from_pretrained(backbone)
    before, after = make_pre_post_processors(act.config, str(backbone))
    planned = after(act.predict_action_chunk(before(dict(observation))))
    joint, raw = adapter(interface="joint"), adapter(interface="raw")
    torch.testing.assert_close(joint.predict_action_chunk(observation), planned[..., :23])
    tips = raw.predict_action_chunk(observation)
    torch.testing.assert_close(tips, planned[..., [*range(7), *range(23, 35)]])
    torch.testing.assert_close(joint.select_action(observation), planned[:, 0, :23])
    targets = raw.select_action(observation)
    torch.testing.assert_close(targets[:, :7], planned[:, 0, :7])
    # The IK moves the fingertips toward the plan; this untrained plan may be out of reach.
    start = fingertips(LEAP, observation["observation.state"][:, 7:].double()).flatten(1)
    reached = fingertips(LEAP, targets[:, 7:].double()).flatten(1)
    assert ((reached - tips[:, 0, 7:]).norm(dim=1) < (start - tips[:, 0, 7:]).norm(dim=1)).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"backbone_path": ""}, "has no backbone"),
        ({"backbone_path": "no/such-folder/anywhere"}, "is no policy of LeRobot"),
        ({"n_action_steps": 20}, "at most the backbone's chunk of 12"),
    ],
)
def test_what_cannot_be_a_backbone_is_refused(adapter, settings, message):
    with pytest.raises(DexFlexError, match=message):
        adapter(**settings)


def test_the_draft_says_what_the_backbone_learned_and_changes_no_action(adapter, observation):
    commanded, measured = adapter(interface="raw"), adapter(interface="raw", draft="measured")
    assert (commanded.config.draft, measured.config.draft) == ("commanded", "measured")
    assert torch.equal(commanded.select_action(observation), measured.select_action(observation))
    with pytest.raises(ParsingError, match=r"`draft` must be measured or commanded\. Got 'felt'"):
        adapter(interface="raw", draft="felt")


def test_it_refuses_to_be_trained(adapter):
    with pytest.raises(DexFlexError, match="Train its backbone"):
        adapter().config.get_optimizer_preset()


def test_a_training_step_says_that_the_backbone_is_trained(adapter, observation):
    with pytest.raises(DexFlexError, match="Train its backbone"):
        adapter().forward(observation)


def test_comparisons_load_it_by_its_backbone_alone(backbone):
    policies = AdaptedPolicies(LEAP, backbone)
    policies.check(["raw", "press"])
    raw, ours = (policies.version(name, "PourCup-v0") for name in ("raw", "press"))
    assert raw.weights == ours.weights
    assert raw.code != ours.code
    controller = policies("raw@0.25")
    images = np.random.default_rng(0).integers(0, 255, (2, 1, 96, 96, 3), np.uint8)
    seen = {
        "pixels": {"front": images[0], "wrist": images[1]},
        "agent_pos": np.full((1, 23), 0.3, np.float32),
        "tactile": np.zeros((1, 240), np.float32),
        "fingertips": np.full((1, 12), 0.05, np.float32),
        "gravity": np.array([[0, 0, -1]], np.float32),
    }
    controller.reset([5])
    first = controller.act(seen, "task")
    assert first.shape == (1, 23)
    assert controller.motion is not None
    assert controller.motion.row(0).magnitude() == pytest.approx(0.75, abs=1e-3)
    controller.reset([5])
    np.testing.assert_array_equal(controller.act(seen, "task"), first)


def test_a_comparison_without_the_backbones_checkpoint_is_refused(tmp_path):
    with pytest.raises(DexFlexError, match=r"config\.json, model\.safetensors.* not found.*--backbone="):
        AdaptedPolicies(LEAP, tmp_path).check(["raw"])


@pytest.mark.parametrize("interface", ["joint", "raw", "dexflex"])
def test_mixed_precision_is_for_the_backbone_alone(adapter, observation, interface):
    policy = adapter(interface=interface)
    with torch.autocast("cpu"):
        chunk = policy.predict_action_chunk(observation)
        targets = torch.stack([policy.select_action(observation) for _ in range(8)])
    assert targets.dtype == torch.float32
    targets.numpy()
    policy.reset()
    policy.execution.begin(chunk)
    for target in targets:
        assert torch.equal(policy.execution.step(observation), target)


def test_an_environment_that_does_not_fit_the_backbone_is_refused(adapter, observation):
    def features(**changes):
        kept = adapter().config.input_features | changes
        return {key: feature for key, feature in kept.items() if feature is not None}

    wrist = "observation.images.wrist"
    large = PolicyFeature(FeatureType.VISUAL, (3, 128, 128))
    with pytest.raises(DexFlexError, match=f"reads {wrist}, which the environment does not offer"):
        adapter(input_features=features(**{wrist: None}))
    with pytest.raises(DexFlexError, match=rf"{wrist} of shape \(3, 96, 96\), but .* shape \(3, 128, 128\)"):
        adapter(input_features=features(**{wrist: large}))
    with pytest.raises(DexFlexError, match=r"reads observation.state. Got: observation.*--env.type=dexflex"):
        adapter(input_features=features(**{"observation.state": None}))
    with pytest.raises(DexFlexError, match=f"reads {wrist}, which the environment does not offer"):
        adapter().select_action({key: value for key, value in observation.items() if key != wrist})


def test_a_backbone_with_half_a_file_is_refused_by_name(backbone, adapter, tmp_path):
    folder = shutil.copytree(backbone, tmp_path / "act")
    file = folder / "policy_preprocessor.json"
    file.write_text(file.read_text()[:40])
    with pytest.raises(DexFlexError, match=r"policy_preprocessor.json is damaged"):
        adapter(backbone_path=str(folder))
