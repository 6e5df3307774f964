import json
import re

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces.commanded_hand import LARGEST_STEP
from lerobot_policy_dexflex.measured_tips import NEXT_TIPS, learned_action


def noise(policy, rows=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(rows, 16, len(policy.normalization.columns), generator=generator)


def train(policy, samples, steps, lr=3e-3):
    policy.train()
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr)
    losses = []
    for _ in range(steps):
        loss, _ = policy.forward(samples)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
        losses.append(loss.item())
    policy.eval()
    return losses


@pytest.fixture(scope="module")
def trained(synthetic_dataset, tiny, samples):
    """Policies of both action spaces that have fitted the 16 samples."""
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
    from lerobot.policies import make_policy

    from lerobot_policy_dexflex import DexflexFlowConfig

    policies = {}
    for interface in ("joint", "raw"):
        torch.manual_seed(0)
        config = DexflexFlowConfig(**tiny, interface=interface, cache_dataset=False)
        meta = LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=synthetic_dataset)
        policy = make_policy(config, ds_meta=meta)
        policies[interface] = policy, train(policy, samples, 100)
    return policies


@pytest.mark.parametrize("interface", ["joint", "raw"])
def test_the_loss_falls_to_a_fraction_when_a_few_samples_are_fitted(trained, interface):
    _, losses = trained[interface]
    assert np.mean(losses[-20:]) < 0.15 * losses[0]


def test_an_untrained_policy_predicts_the_mean_action_because_its_last_step_lands_on_the_clean_chunk(
    build, observation
):
    # The network's head starts at 0, the mean; 8 Euler steps with v = (0 - x) / (1 - t) end there exactly.
    policy = build().eval()
    mean = policy.normalization.action.mean.expand(4, 16, -1)
    torch.testing.assert_close(policy.predict_action_chunk(observation, noise(policy)), mean)


@pytest.mark.parametrize("interface", ["joint", "raw"])
def test_fitted_chunks_lie_close_to_the_demonstrated_ones(trained, samples, interface):
    policy, _ = trained[interface]
    predicted = policy.predict_action_chunk(samples, noise(policy, 16))
    action = learned_action(samples) if interface == "raw" else samples["action"]
    target = action[..., policy.normalization.columns]
    valid = ~samples["action_is_pad"]
    error = (predicted - target).abs()[valid] / policy.normalization.action.std
    assert error.mean() < 0.35  # An ignorant prediction, the mean, is off by about 0.8 standard deviations.


def test_the_draft_checkpoint_learns_arm_joints_and_fingertips_the_other_all_joints(trained):
    assert trained["joint"][0].normalization.columns == list(range(23))
    assert trained["raw"][0].normalization.columns == [*range(7), *range(23, 35)]
    assert [(p.config.action_space, p.config.draft) for p, _ in trained.values()] == [
        ("joint", ""),
        ("draft", "measured"),
    ]


def test_select_action_returns_joint_targets_and_executes_each_chunk_eight_times(trained, observation):
    policy, _ = trained["joint"]
    policy.reset()
    chunk = policy.predict_action_chunk(observation, noise(policy))
    for k in range(8):
        assert torch.equal(policy.select_action(observation, noise(policy)), chunk[:, k])
    replanned = policy.select_action(observation, noise(policy, seed=1))
    assert torch.equal(replanned, policy.predict_action_chunk(observation, noise(policy, seed=1))[:, 0])


def test_raw_execution_asks_for_exactly_the_planned_fingertips_from_the_measured_ones(trained, observation):
    policy, _ = trained["raw"]
    measured = fingertips(observation["observation.state"][:, 7:].double())
    policy.reset()
    chunk = policy.predict_action_chunk(observation, noise(policy))
    for k in range(8):
        targets = policy.select_action(observation, noise(policy))
        assert targets.shape == (4, 23)
        assert torch.equal(targets[:, :7], chunk[:, k, :7])
        planned = chunk[:, k, 7:].double().view(4, 4, 3)
        motion = policy.execution.interface.motion
        torch.testing.assert_close(measured + motion, planned, rtol=0, atol=1e-9)


@pytest.mark.parametrize("interface", ["joint", "raw"])
def test_a_batch_acts_as_its_rows_do_alone(trained, observation, interface):
    policy, _ = trained[interface]

    def act(rows):
        policy.reset()
        seen = {key: value[rows] for key, value in observation.items()}
        return torch.stack([policy.select_action(seen, noise(policy)[rows]) for _ in range(10)])

    together = act(slice(0, 4))
    alone = torch.cat([act(slice(i, i + 1)) for i in range(4)], 1)
    torch.testing.assert_close(together, alone, rtol=0, atol=2e-5)


@pytest.mark.parametrize("interface", ["joint", "raw"])
def test_a_reloaded_policy_acts_bit_for_bit_alike(trained, observation, interface, tmp_path):
    policy, _ = trained[interface]
    policy.save_pretrained(tmp_path)
    again = type(policy).from_pretrained(tmp_path)
    assert again.config.action_space == policy.config.action_space
    for instance in (policy, again):
        instance.reset()
    for _ in range(9):
        expected = policy.select_action(observation, noise(policy))
        assert torch.equal(again.select_action(observation, noise(policy)), expected)
    assert all(torch.equal(a, b) for a, b in zip(again.parameters(), policy.parameters(), strict=True))


def test_the_interface_is_switched_at_evaluation_within_its_action_space(trained, tmp_path):
    from lerobot.configs import PreTrainedConfig

    policy, _ = trained["raw"]
    policy.save_pretrained(tmp_path)
    switched = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--interface=press:2"])
    assert type(policy).from_pretrained(tmp_path, config=switched).execution.interface.name == "press:2"
    refused = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--interface=joint"])
    with pytest.raises(DexFlexError) as error:
        type(policy).from_pretrained(tmp_path, config=refused)
    choices = re.search(r"learned 'draft'\. Choose --policy\.interface=(\S+), or load", str(error.value))
    assert choices is not None
    assert {"raw", "press", "dexflex"} <= set(choices[1].split("|"))
    assert "joint" not in choices[1].split("|")


def test_a_checkpoint_of_drafts_from_before_the_choice_is_refused_until_it_tells_its_draft(trained, tmp_path):
    from lerobot.configs import PreTrainedConfig

    policy, _ = trained["raw"]
    policy.save_pretrained(tmp_path)
    file = tmp_path / "config.json"
    settings = json.loads(file.read_text())
    assert settings["draft"] == "measured"
    file.write_text(json.dumps({key: value for key, value in settings.items() if key != "draft"}))
    with pytest.raises(DexFlexError, match=r"from before .*config.json, or add --policy.draft=commanded"):
        type(policy).from_pretrained(tmp_path)
    told = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--draft=commanded"])
    assert type(policy).from_pretrained(tmp_path, config=told).config.draft == "commanded"
    file.write_text(json.dumps(settings | {"draft": "commanded"}))
    assert type(policy).from_pretrained(tmp_path).config.draft == "commanded"


def test_a_policy_of_joint_targets_refuses_to_choose_fingertips(build):
    with pytest.raises(
        DexFlexError, match=r"'joint' learns joint targets. Leave out --policy.draft=measured"
    ):
        build(interface="joint", draft="measured")


def test_commanded_fingertips_are_learned_from_the_dataset_as_it_is(build, samples):
    policy = build(interface="raw", draft="commanded")
    assert torch.isfinite(policy.forward({k: v for k, v in samples.items() if k != NEXT_TIPS})[0])
    with pytest.raises(DexFlexError, match=r"lacks 'observation.next_fingertips'"):
        build(interface="raw").forward({k: v for k, v in samples.items() if k != NEXT_TIPS})


def test_evaluation_uses_the_running_average_and_training_the_weights(build, samples, observation):
    policy = build()
    train(policy, samples, 5)
    average = [value.clone() for value in policy.average.parameters()]
    before = policy.predict_action_chunk(observation, noise(policy))
    with torch.no_grad():
        for value in policy.network.parameters():
            value.add_(1.0)
    assert torch.equal(policy.predict_action_chunk(observation, noise(policy)), before)
    assert all(torch.equal(a, b) for a, b in zip(average, policy.average.parameters(), strict=True))
    # The sixth update keeps (1 + 6) / (10 + 6) of the average.
    policy.update()
    moved = torch.lerp(next(policy.network.parameters()), average[0], 7 / 16)
    torch.testing.assert_close(next(policy.average.parameters()), moved)


def test_the_optimiser_gets_the_weights_and_never_the_average(build, samples):
    policy = build()
    policy.forward(samples)[0].backward()
    optimised = {id(value) for value in policy.get_optim_params()}
    assert not optimised & {id(value) for value in policy.average.parameters()}
    assert all(value.grad is None for value in policy.average.parameters())


def test_padded_actions_do_not_count(build, samples):
    policy = build(noise_draws=1).eval()
    spoiled = {**samples, "action": samples["action"].clone()}
    spoiled["action"][samples["action_is_pad"]] += 100
    assert samples["action_is_pad"].any()
    # At the start the network answers 0 whatever the action, so only the masked targets could differ.
    losses = []
    for batch in (samples, spoiled):
        torch.manual_seed(3)
        losses.append(policy.forward(batch)[0])
    assert torch.equal(*losses)


def test_a_loss_per_sample_is_returned_on_request(build, samples):
    assert build().forward(samples, reduction="none")[0].shape == (16,)


def test_the_policy_never_sees_the_previous_command(build, observation):
    policy = build(interface="raw").eval()
    chunk = policy.predict_action_chunk(observation, noise(policy))
    for _ in range(3):
        policy.select_action(observation, noise(policy, seed=5))
    assert torch.equal(policy.predict_action_chunk(observation, noise(policy)), chunk)


def test_the_first_command_of_an_episode_starts_at_the_measured_hand(build, observation):
    policy = build(interface="raw").eval()
    far = {**observation, "observation.state": observation["observation.state"] + 0.8}
    targets = policy.select_action(far, noise(policy))
    change = (targets - far["observation.state"])[:, 7:].abs().max()
    assert change == pytest.approx(LARGEST_STEP, abs=1e-6)


def test_statistics_of_the_dataset_are_kept_and_fingertips_share_one_scale(build):
    policy = build(interface="raw")
    std = policy.normalization.action.std
    assert policy.normalization.fingertips.std.unique().numel() <= 4
    assert all(std[7 + 3 * f : 10 + 3 * f].unique().numel() == 1 for f in range(4))
    values = torch.randn(5, 16, 19)
    normalizer = policy.normalization.action
    torch.testing.assert_close(normalizer.inverse(normalizer(values)), values)


def test_noise_of_another_shape_is_refused(build, observation):
    policy = build().eval()
    with pytest.raises(DexFlexError, match=r"`noise` must have shape \(4, 16, 23\). Got \(4, 23\)"):
        policy.predict_action_chunk(observation, torch.zeros(4, 23))


@pytest.mark.parametrize("interface", ["joint", "raw", "press", "dexflex"])
def test_mixed_precision_is_for_the_plan_alone(build, controller_folder, observation, interface):
    policy = build(interface=interface, controller=str(controller_folder)).eval()
    with torch.autocast("cpu"):
        targets = torch.stack([policy.select_action(observation, noise(policy)) for _ in range(9)])
    assert targets.dtype == torch.float32
    targets.numpy()
    # The same plan, executed without mixed precision, moves the joints to the same place.
    with torch.autocast("cpu"):
        chunk = policy.predict_action_chunk(observation, noise(policy))
    policy.reset()
    policy.execution.begin(chunk.float())
    for k in range(8):
        assert torch.equal(policy.execution.step(observation), targets[k])


def test_training_under_mixed_precision_gives_a_finite_loss(build, samples):
    policy = build(interface="raw").train()
    with torch.autocast("cpu"):
        loss, _ = policy.forward(samples)
    loss.backward()
    assert torch.isfinite(loss)
    assert all(
        torch.isfinite(value.grad).all() for value in policy.network.parameters() if value.grad is not None
    )


@pytest.mark.parametrize("damage", ["half", "empty", "missing", "other network", "a layer less", "nan"])
def test_weights_that_are_not_whole_are_refused(build, tmp_path, damage):
    policy = build()
    policy.save_pretrained(tmp_path)
    file = tmp_path / "model.safetensors"
    whole, weights = file.read_bytes(), load_file(file)
    first = "network.action_out.weight"
    if damage == "half":
        file.write_bytes(whole[: len(whole) // 2])
    elif damage == "empty":
        file.write_bytes(b"")
    elif damage == "missing":
        file.unlink()
    elif damage == "other network":
        save_file(weights | {first: weights[first][:, :-1].contiguous()}, file)
    elif damage == "a layer less":
        save_file({key: value for key, value in weights.items() if key != first}, file)
    else:
        save_file(weights | {first: weights[first] * float("nan")}, file)
    message = "not finite, in network.action_out.weight" if damage == "nan" else "cannot be loaded"
    with pytest.raises(DexFlexError, match=rf"model.safetensors .*{message}"):
        type(policy).from_pretrained(tmp_path)
