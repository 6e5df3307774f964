import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType
from lerobot.envs.utils import env_to_policy_features
from lerobot.policies.factory import make_pre_post_processors

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.command_errors import CommandErrors
from lerobot_dexflex.evaluation.policies import LeRobotPolicies, ObservedInterface
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces import commanded_hand, make_interface
from lerobot_policy_dexflex.configuration_dexflex_flow import DexflexFlowConfig
from lerobot_policy_dexflex.configuration_env import DexflexEnvConfig
from lerobot_policy_dexflex.modeling_dexflex_flow import DexflexFlowPolicy


@pytest.fixture(scope="module")
def policies(tmp_path_factory):
    """Checkpoints of both action spaces with random weights."""
    folder = tmp_path_factory.mktemp("checkpoints")
    features = env_to_policy_features(DexflexEnvConfig())
    statistics = {"mean": 0.0, "std": 0.3, "min": -0.5, "max": 0.5}
    sizes = {"action": 35, "observation.state": 23, "observation.fingertips": 12}
    stats = {key: {s: torch.full((n,), v) for s, v in statistics.items()} for key, n in sizes.items()}
    for space, interface in (("joint", "joint"), ("draft", "raw")):
        config = DexflexFlowConfig(interface=interface, device="cpu", dim=32, n_layers=1)
        config.input_features = {k: f for k, f in features.items() if f.type is not FeatureType.ACTION}
        config.output_features = {k: f for k, f in features.items() if f.type is FeatureType.ACTION}
        policy = DexflexFlowPolicy(config, dataset_stats=stats)
        # Its output layer starts at zero: every untrained plan would be the mean, whatever the noise.
        torch.nn.init.normal_(policy.average.action_out.weight, std=0.3)
        policy.save_pretrained(folder / space)
        for processor in make_pre_post_processors(config):
            processor.save_pretrained(folder / space)
    return LeRobotPolicies(folder / "joint", folder / "draft")


def observation(rows):
    rng = np.random.default_rng(0)
    images = {
        name: rng.integers(0, 255, (1, 96, 96, 3), np.uint8).repeat(rows, 0) for name in ("front", "wrist")
    }
    vectors = {"agent_pos": np.full((rows, 23), 0.3), "tactile": np.zeros((rows, 240))}
    more = {"fingertips": np.full((rows, 12), 0.05), "gravity": np.tile([0.0, 0, -1], (rows, 1))}
    return {"pixels": images} | {key: value.astype(np.float32) for key, value in (vectors | more).items()}


def act(controller, seeds, steps=10):
    """Act past a second planning; shape (steps, rows, 23)."""
    controller.reset(seeds)
    return np.stack([controller.act(observation(len(seeds)), "task") for _ in range(steps)])


@pytest.mark.parametrize("interface", ["joint", "raw", "filter"])
def test_a_seed_repeats_its_episode_bit_for_bit_and_another_differs(policies, interface):
    controller = policies(interface)
    first, other, again = act(controller, [5]), act(controller, [6]), act(controller, [5])
    assert first.shape == (10, 1, 23)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first[0] - other[0]).max() > 1e-3


def test_interfaces_that_read_drafts_get_the_same_plan(policies):
    # Arm targets come straight from the plan; only the hand differs.
    raw, filtered = act(policies("raw"), [5]), act(policies("filter"), [5])
    np.testing.assert_array_equal(raw[..., :7], filtered[..., :7])
    assert np.abs(raw[..., 7:] - filtered[..., 7:]).max() > 1e-3


def test_a_row_does_not_depend_on_its_neighbours_noise(policies):
    controller = policies("raw")
    np.testing.assert_allclose(act(controller, [5, 6])[:, 0], act(controller, [5, 9])[:, 0], atol=1e-5)


def test_what_an_interface_did_to_the_draft_is_told_under_a_policy(policies, monkeypatch):
    monkeypatch.setattr(commanded_hand, "RUNAWAY", 10.0)  # These untrained plans are out of reach.
    raw, shrunk = policies("raw"), policies("shrink")
    act(raw, [5], steps=1)
    assert raw.motion.magnitude() < 1e-6
    act(shrunk, [5], steps=1)
    assert shrunk.motion.row(0).magnitude() == pytest.approx(0.5, abs=1e-3)


def test_joint_targets_have_no_draft_to_intervene_on(policies):
    controller = policies("joint")
    act(controller, [5], steps=1)
    assert controller.motion is None


def test_the_filter_changes_a_draft_by_what_it_clips_off():
    # The first draft passes the low-pass as it is; 10 mm are clipped to 6 mm on x of the index finger.
    interface = ObservedInterface(make_interface("filter"))
    draft = torch.zeros(1, 8, 4, 3)
    draft[0, 0, 0, 0] = 0.010
    interface.step({"observation.state": torch.full((1, 23), 0.3)}, draft)
    assert interface.motion is not None
    assert interface.motion.draft[0, 0, 0] == pytest.approx(0.010)
    assert interface.motion.executed[0, 0, 0] == pytest.approx(0.006)
    assert interface.motion.row(0).magnitude() == pytest.approx(0.004 / 0.010001)


def test_the_identity_names_one_checkpoint_for_all_drafts(policies):
    identity = policies.identity(["joint", "raw", "filter"])
    assert set(identity) == {"checkpoint.joint", "checkpoint.draft", "device"}
    assert policies.identity(["raw"])["checkpoint.draft"] == identity["checkpoint.draft"]
    assert identity["checkpoint.joint"] != identity["checkpoint.draft"]


def test_an_interface_can_have_a_checkpoint_of_its_own(policies):
    nowhere = Path("/nowhere")
    both = LeRobotPolicies(policies.joint, nowhere, own=(("raw", policies.draft), ("filter", policies.draft)))
    identity = both.identity(["joint", "raw", "filter"])  # The shared draft checkpoint is not needed.
    assert set(identity) == {"checkpoint.joint", "checkpoint.raw", "checkpoint.filter", "device"}
    assert identity["checkpoint.raw"] == policies.identity(["raw"])["checkpoint.draft"]
    np.testing.assert_array_equal(act(both("raw"), [5]), act(policies("raw"), [5]))
    with pytest.raises(DexFlexError, match="No draft checkpoint at /nowhere"):
        both.identity(["raw", "filter", "shrink"])
    with pytest.raises(DexFlexError, match="A checkpoint is given for filter, but compared are joint, raw"):
        both.identity(["joint", "raw"])
    with pytest.raises(DexFlexError, match="learned the action space 'joint'"):
        replace(both, own=(("raw", policies.joint),)).identity(["raw"])


@pytest.mark.parametrize("interface", ["dexgen", "dexflex"])
def test_a_controller_moves_the_hand_and_belongs_to_the_identity(policies, controller_folder, interface):
    with_controller = replace(policies, controller=str(controller_folder))
    identity = with_controller.identity(["raw", interface])
    assert set(identity) == {"checkpoint.draft", f"controller.{interface}", "device"}
    raw, ours = act(policies("raw"), [5], steps=2), act(with_controller(interface), [5], steps=2)
    np.testing.assert_array_equal(raw[..., :7], ours[..., :7])
    assert np.abs(raw[..., 7:] - ours[..., 7:]).max() > 1e-3


def test_a_comparison_without_its_controller_is_refused(policies, tmp_path):
    with pytest.raises(DexFlexError, match="No controller at"):
        replace(policies, controller=str(tmp_path)).identity(["dexflex"])


def test_the_card_of_a_checkpoint_is_not_its_identity_but_its_configuration_is(policies, tmp_path):
    (tmp_path / "model.safetensors").write_bytes((policies.draft / "model.safetensors").read_bytes())
    config = json.loads((policies.draft / "config.json").read_text())
    moved = LeRobotPolicies(tmp_path, tmp_path)
    (tmp_path / "config.json").write_text(json.dumps(config))
    before = moved.identity(["raw"])
    (tmp_path / "README.md").write_text("A card.")
    assert moved.identity(["raw"]) == before
    (tmp_path / "config.json").write_text(json.dumps(config | {"euler_steps": 2}))
    assert moved.identity(["raw"]) != before


def test_a_checkpoint_of_another_action_space_is_refused(policies):
    swapped = LeRobotPolicies(policies.draft, policies.joint)
    with pytest.raises(
        DexFlexError, match="learned the action space 'draft', but this interface executes 'joint'"
    ):
        swapped.identity(["joint"])


def test_a_missing_checkpoint_says_how_to_train_it(policies, tmp_path):
    with pytest.raises(
        DexFlexError, match=r"No draft checkpoint at .*lerobot-train .*--policy.interface=raw"
    ):
        LeRobotPolicies(policies.joint, tmp_path).identity(["joint", "raw"])


def test_noise_on_fingertips_belongs_to_the_control_step_and_spares_the_arm(policies):
    seen = []
    for width in (0.0, 0.004):
        seen.append(seen_chunks(replace(policies, errors=CommandErrors(noise=width))("raw"), [5]))
    clean, noisy = seen
    first, second = (noisy - clean)[:, 0]  # Planned at steps 0 and 8.
    assert (first[:, :7] == 0).all()
    assert 0.003 < first[:, 7:].abs().max() <= 0.004 + 1e-6
    torch.testing.assert_close(first[8:], second[: len(first) - 8], atol=1e-6, rtol=0)


def seen_chunks(controller, seeds):
    """Return the chunks that are executed in an episode: (plans, batch, steps, columns)."""
    chunks = []
    execution = controller._policy.execution
    begin = execution.begin

    def noted(chunk):
        begin(chunk)
        chunks.append(execution._chunk.clone())

    execution.begin = noted
    act(controller, seeds)
    return torch.stack(chunks)


def test_noise_moves_the_fingertips_of_planned_joints_as_those_of_drafts(policies):
    joints = torch.full((1, 16, 23), 0.3)
    draft = torch.cat([joints[..., :7], fingertips(joints[0, :, 7:]).view(1, 16, 12)], -1)
    changes = []
    for interface, plan in (("raw", draft), ("joint", joints)):
        controller = replace(policies, errors=CommandErrors(noise=0.004))(interface)
        controller.reset([5])
        noisy = controller._noise.disturbed(plan, 0)[0]
        assert torch.equal(noisy[:, :7], plan[0, :, :7])
        tips = noisy[:, 7:].view(-1, 4, 3) if interface == "raw" else fingertips(noisy[:, 7:])
        changes.append((tips - fingertips(joints[0, :, 7:])).flatten())
    asked, moved = changes
    # The tie to the posture leaves some of it out, as it does under `raw` in every step.
    assert 0.5 < (moved @ asked) / (asked @ asked) < 1
    assert torch.corrcoef(torch.stack(changes))[0, 1] > 0.8


def test_noise_is_part_of_the_settings_and_must_be_a_width(policies):
    assert (
        replace(policies, errors=CommandErrors(noise=0.004)).identity(["joint", "raw"])["command_noise"]
        == "0.004"
    )
    assert "command_noise" not in policies.identity(["raw"])
    with pytest.raises(DexFlexError, match=r"0 or more \[m\]. Got nan"):
        replace(policies, errors=CommandErrors(noise=float("nan"))).identity(["raw"])
