"""An action interface as processor steps, below anything that says where the fingertips go."""

import json
import shutil

import pytest
import torch
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.envs.utils import close_envs
from lerobot.policies.factory import make_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.factory import make_policy_processor_pipelines
from lerobot.scripts.lerobot_eval import rollout
from lerobot_commands import begin_evaluation

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface
from lerobot_policy_dexflex import (
    DexflexAdapterConfig,
    DexflexEnvConfig,
    InterfaceProcessorStep,
    set_interface,
)
from lerobot_policy_dexflex.interface_steps import INTERFACE_STEP, OBSERVATION_STEP

ALL = ["joint", "raw", "press:2", "projection", "dexgen", "dexflex", "dexflex-notouch@0.7"]
STEPS = 3


@pytest.fixture
def pipelines(controller_folder):
    """Return a function that makes pipelines of nothing but an interface."""

    def make(interface="raw", **settings):
        pair = make_policy_processor_pipelines([], [])
        set_interface(*pair, interface=interface, controller=str(controller_folder), **settings)
        return pair

    return make


def said(observation, k=0):
    """The action of a policy: the arm stays, fingertips go 2 mm and then 1 mm further per step."""
    state = observation["observation.state"]
    tips = fingertips(LEAP, state[:, -16:].double()).flatten(1) + 0.002 + 0.001 * k
    return torch.cat([state[:, :-16], tips.float()], 1)


def act(pair, observation, steps=STEPS):
    """Joint targets of some steps at the same observation. Shape (steps, batch, joints)."""
    before, after = pair
    targets = []
    for k in range(steps):
        before(dict(observation))
        targets.append(after(said(observation, k)))
    return torch.stack(targets)


def rows(observation, chosen):
    return {key: value[chosen] for key, value in observation.items()}


@pytest.mark.parametrize("interface", ALL[1:])
def test_joint_targets_are_bit_for_bit_the_interfaces_own(
    pipelines, controller_folder, observation, interface
):
    direct = make_interface(LEAP, interface, controller_folder)
    targets = act(pipelines(interface), observation)
    assert targets.shape == (STEPS, 4, 23)
    here = fingertips(LEAP, observation["observation.state"][:, 7:].double())
    for k in range(STEPS):
        arm, wanted = said(observation, k).split([7, 12], 1)
        draft = (wanted.double().unflatten(1, (4, 3)) - here)[:, None].expand(-1, 8, -1, -1)
        assert torch.equal(targets[k], torch.cat([arm, direct.step(observation, draft).float()], 1))


@pytest.mark.parametrize("interface", ["joint", "raw", "press", "dexflex"])
def test_chunks_of_a_policy_are_executed_bit_for_bit_as_under_the_adapter(
    adapter, backbone, controller_folder, observation, interface
):
    from lerobot.policies.act.modeling_act import ACTPolicy

    policy = ACTPolicy.from_pretrained(backbone)
    before, after = make_pre_post_processors(policy.config, str(backbone))
    set_interface(before, after, interface=interface, controller=str(controller_folder))
    adapted = adapter(interface=interface, controller=str(controller_folder), n_action_steps=1)
    for _ in range(STEPS):
        targets = after(policy.predict_action_chunk(before(dict(observation))))
        assert torch.equal(targets, adapted.select_action(observation))


def test_the_steps_stand_where_units_are_raw(backbone):
    before, after = make_pre_post_processors(DexflexAdapterConfig(), str(backbone))
    for interface in ("press", "raw"):
        set_interface(before, after, interface=interface)
    first, second = (pipeline.get_config()["steps"] for pipeline in (before, after))
    assert [each["registry_name"] for each in first][-2:] == [OBSERVATION_STEP, "normalizer_processor"]
    names = [each["registry_name"] for each in second]
    assert names == ["unnormalizer_processor", INTERFACE_STEP, "device_processor"]
    assert second[1]["config"]["interface"] == "raw"


def loaded(folder, **overrides):
    before = PolicyProcessorPipeline.from_pretrained(folder, "policy_preprocessor.json")
    _, converters = make_policy_processor_pipelines([], [])
    after = PolicyProcessorPipeline.from_pretrained(
        folder,
        "policy_postprocessor.json",
        overrides={INTERFACE_STEP: overrides} if overrides else {},
        to_transition=converters.to_transition,
        to_output=converters.to_output,
    )
    return before, after


@pytest.mark.parametrize("interface", ["press:2+blocked=True", "dexflex"])
def test_saved_steps_are_loaded_by_name_and_act_alike(
    pipelines, controller_folder, observation, tmp_path, interface
):
    pair = pipelines(interface, draft="measured", link="left")
    expected = act(pair, observation)
    for pipeline in pair:
        pipeline.save_pretrained(tmp_path)
    assert {file.suffix for file in tmp_path.iterdir()} == {".json"}  # No weights.
    (saved,) = json.loads((tmp_path / "policy_postprocessor.json").read_text())["steps"]
    assert saved["registry_name"] == INTERFACE_STEP
    digest = saved["config"].pop("controller_digest")
    assert digest.startswith("dexflex:") == (interface == "dexflex")
    assert saved["config"] == {
        "interface": interface,
        "draft": "measured",
        "controller": str(controller_folder),
        "link": "left",
        "hand": "leap",
    }
    assert torch.equal(act(loaded(tmp_path), observation), expected)
    raw = act(loaded(tmp_path, interface="raw"), observation)
    assert torch.equal(raw, act(pipelines("raw"), observation))


def test_another_or_no_controller_is_refused_when_loaded(pipelines, controller_folder, observation, tmp_path):
    controller = shutil.copytree(controller_folder, tmp_path / "controller")
    pair = make_policy_processor_pipelines([], [])
    set_interface(*pair, interface="dexflex", controller=str(controller))
    for pipeline in pair:
        pipeline.save_pretrained(tmp_path)
    other = DexFlexController.from_pretrained(controller)
    other.decoder.out.bias.data.add_(1)
    other.save_pretrained(controller)
    with pytest.raises(ValueError, match=r"saved with \(dexflex:\w+\)\. Name the original with `controller`"):
        loaded(tmp_path)
    ours = loaded(tmp_path, controller=str(controller_folder))
    assert torch.equal(act(ours, observation), act(pipelines("dexflex"), observation))
    assert torch.isfinite(act(loaded(tmp_path, controller_digest=""), observation)).all()
    shutil.rmtree(controller)
    with pytest.raises(ValueError, match=r"No controller for 'leap' at .*train it: dexflex-train"):
        loaded(tmp_path)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"interface": "raww"}, r"Unknown interface 'raww'.*Valid: joint, raw, press"),
        ({"interface": "press:strength=2"}, r"Valid of 'press': force=..., release="),
        ({"draft": "felt"}, r"`draft` must be measured or commanded\. Got 'felt'"),
    ],
)
def test_an_option_that_is_none_is_refused_with_the_valid_ones(pipelines, settings, message):
    with pytest.raises(DexFlexError, match=message):
        pipelines(**settings)


@pytest.mark.parametrize("interface", ["press", "projection", "dexgen", "dexflex@0.5"])
def test_missing_touch_is_refused_by_name(pipelines, observation, interface):
    blind = {key: value for key, value in observation.items() if key != "observation.tactile"}
    with pytest.raises(DexFlexError, match=r"lacks observation.tactile.*raw and dexflex-notouch need no"):
        act(pipelines(interface), blind)
    assert torch.isfinite(act(pipelines("raw"), blind)).all()
    assert torch.isfinite(act(pipelines("dexflex:use_touch=False"), blind)).all()


@pytest.mark.parametrize(
    ("interface", "shape", "message"),
    [
        ("raw", (4, 23), r"\(4, size\).* size 19: 7 joint targets .*, then 12 .*; or 35.* Got \(4, 23\)"),
        ("raw", (3, 19), r"must have shape \(4, size\).* Got \(3, 19\)"),
        ("raw", (19,), r"Got \(19,\)"),
        ("joint", (4, 19), r"with size 23: 7 joint targets of the arm \[rad\], then 16 of the hand; or 35"),
    ],
)
def test_an_action_of_another_shape_is_refused_with_the_valid_ones(
    pipelines, observation, interface, shape, message
):
    before, after = pipelines(interface)
    before(dict(observation))
    with pytest.raises(DexFlexError, match=message):
        after(torch.zeros(shape))


def test_every_action_needs_an_observation_of_its_own(pipelines, observation):
    before, after = pipelines("raw")
    with pytest.raises(DexFlexError, match="has no observation for this action"):
        after(said(observation))
    before(dict(observation))
    after(said(observation))
    with pytest.raises(DexFlexError, match=f"Put {OBSERVATION_STEP} with link 'policy' into"):
        after(said(observation))


def test_pipelines_with_links_of_their_own_may_take_turns_within_a_step(pipelines, observation):
    other = rows(observation, [3, 2, 1, 0])
    left, right = pipelines("raw", link="left"), pipelines("raw", link="right")
    left[0](dict(observation))
    right[0](dict(other))
    assert torch.equal(left[1](said(observation)), act(pipelines("raw"), observation, 1)[0])
    assert torch.equal(right[1](said(other)), act(pipelines("raw"), other, 1)[0])


def test_a_glove_needs_one_step_and_no_batch(pipelines, observation):
    pipeline = PolicyProcessorPipeline([InterfaceProcessorStep("press")])
    one = {key: value[0] for key, value in observation.items()}
    executed = pipeline({**one, "action": said(observation)[:1]})
    assert torch.equal(executed["action"], act(pipelines("press"), rows(observation, [0]), 1)[0])


@pytest.mark.parametrize("interface", ["raw", "press", "dexflex"])
def test_rows_act_as_alone(pipelines, observation, interface):
    together = act(pipelines(interface), observation)
    alone = [act(pipelines(interface), rows(observation, [row])) for row in range(4)]
    torch.testing.assert_close(together, torch.cat(alone, 1), rtol=0, atol=1e-4)


@pytest.mark.parametrize("interface", ["raw", "press:smoothing=0.5", "dexflex"])
def test_reset_begins_anew_in_all_rows_or_in_some(pipelines, observation, interface):
    pair = pipelines(interface)
    first = act(pair, observation)
    for pipeline in pair:
        pipeline.reset()
    assert torch.equal(act(pair, observation), first)
    mask = torch.tensor([False, True, False, True])
    going_on = pipelines(interface)
    act(going_on, observation)
    (step,) = (each for each in pair[1].steps if isinstance(each, InterfaceProcessorStep))
    step.reset(mask)
    torch.testing.assert_close(act(pair, observation)[:, mask], first[:, mask], rtol=0, atol=1e-4)
    pair, index = pipelines(interface), "observation.frame_index"
    act(pair, observation)
    begun = act(pair, {**observation, index: 1.0 - mask.float()[:, None]}, 1)
    torch.testing.assert_close(begun[:, mask], first[:1, mask], rtol=0, atol=1e-4)
    assert torch.equal(begun[:, ~mask], act(going_on, observation, 1)[:, ~mask])


def test_resetting_the_pre_processor_forgets_the_observation(pipelines, observation):
    before, after = pipelines("raw")
    before(dict(observation))
    before.reset()
    with pytest.raises(DexFlexError, match="has no observation"):
        after(said(observation))


@pytest.mark.parametrize(("size", "joints"), [(35, 23), (19, 23), (28, 16), (12, 16), (6, 6)])
def test_features_tell_of_joint_targets(size, joints):
    feature = PolicyFeature(FeatureType.ACTION, (size,))
    told = InterfaceProcessorStep("raw").transform_features({PipelineFeatureType.ACTION: {"action": feature}})
    assert told[PipelineFeatureType.ACTION]["action"].shape == (joints,)


class Scripted(torch.nn.Module):
    """A policy that leads all fingertips 1 mm further in every step."""

    def reset(self):
        self.k = 0

    def select_action(self, batch):
        self.k += 1
        return said(batch, self.k)


@pytest.mark.parametrize("interface", ["raw", "dexflex"])
def test_lerobots_evaluation_runs_through_the_pipelines_and_every_episode_begins_anew(pipelines, interface):
    config = DexflexEnvConfig(task="Reach-v0", episode_length=4, options={"cameras": []})
    envs = config.create_envs(2)
    nothing = PolicyProcessorPipeline([])

    def run(pair, seeds):
        vector = envs["dexflex"][0]
        return rollout(vector, Scripted(), nothing, nothing, *pair, seeds=seeds)["action"]  # pyright: ignore

    try:
        pair = pipelines(interface)
        first, second = run(pair, [1, 2]), run(pair, [3, 4])
        assert first.shape == (2, 4, 16)
        assert not torch.equal(first, second)
        assert torch.equal(second, run(pipelines(interface), [3, 4]))
    finally:
        close_envs(envs)


def test_lerobots_command_evaluates_a_checkpoint_with_an_interface(monkeypatch, backbone, adapter, tmp_path):
    folder = shutil.copytree(backbone, tmp_path / "act")
    pair = make_pre_post_processors(DexflexAdapterConfig(), str(folder))
    set_interface(*pair, interface="press")
    for pipeline in pair:
        pipeline.save_pretrained(folder)
    arguments = [f"--policy.path={folder}", "--policy.device=cpu", "--env.task=PlaceHammer-v0"]
    targets = begin_evaluation(monkeypatch, *arguments, "--env.action_size=35")
    assert targets.shape == (1, 2, 23)
    assert torch.isfinite(targets).all()
    with pytest.raises(DexFlexError, match=f"has an interface of its own.*--policy.path={folder}"):
        adapter(backbone_path=str(folder))
