import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_policy_dexflex.drafts import smoothed, without_squeeze
from lerobot_policy_dexflex.measured_tips import NEXT_TIPS


def noise(policy, rows=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(rows, policy.config.chunk_size, policy.plan.size, generator=generator)


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
def fitted(synthetic_dataset, tiny, samples):
    """A policy that has fitted the 16 samples, and its losses."""
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
    from lerobot.policies import make_policy

    from lerobot_policy_dexflex import DexflexFlowConfig

    torch.manual_seed(0)
    config = DexflexFlowConfig(
        **tiny, interface="raw", cache_dataset=False, dropout=0.0, arm_noise=0.01, smoothing=1
    )
    meta = LeRobotDatasetMetadata("lerobot-dexflex/synthetic", root=synthetic_dataset)
    policy = make_policy(config, ds_meta=meta)
    return policy, train(policy, samples, 150)


@pytest.fixture(scope="module")
def trained(fitted, tmp_path_factory):
    """The fitted policy under interfaces that execute different parts of its plans."""
    from lerobot.configs import PreTrainedConfig

    policy, _ = fitted
    folder = tmp_path_factory.mktemp("fitted")
    policy.save_pretrained(folder)

    def under(interface, *more):
        overrides = [f"--interface={interface}", *more]
        config = PreTrainedConfig.from_pretrained(folder, cli_overrides=overrides)
        return type(policy).from_pretrained(folder, config=config)

    return {"raw": policy, "joint": under("joint"), "commanded": under("raw", "--draft=commanded")}


def test_the_loss_falls_to_a_fraction_when_a_few_samples_are_fitted(fitted):
    _, losses = fitted
    assert np.mean(losses[-20:]) < 0.3 * losses[0]


def test_an_untrained_policy_plans_the_mean_because_its_last_step_lands_on_the_clean_chunk(
    build, observation
):
    # The network's head starts at 0, the mean; 8 Euler steps with v = (0 - x) / (1 - t) end there exactly.
    policy = build(interface="raw").eval()
    policy.scale.mean.normal_()
    mean = smoothed(policy.scale.mean[None], policy.config.smoothing).expand(
        len(observation["observation.state"]), -1, -1
    )
    torch.testing.assert_close(policy.predict_plan(observation, noise(policy)), mean)


def test_images_alone_learn_where_the_arm_goes(build, samples):
    policy = build(interface="raw", brightness=0.0)
    arm = samples["action"][:, -1, :7]
    reached = (arm - policy.normalization.state.mean[:7]) / policy.normalization.state.std[:7]

    def error(joints):
        shown = {**samples, "observation.state": joints}
        seen = policy.average.arm_seen(policy.average.encode(policy._observe(shown)).images)
        return (seen - reached)[~samples["action_is_pad"][:, -1]].square().mean().item()

    before = error(samples["observation.state"])
    train(policy, samples, 60)
    after = error(samples["observation.state"])
    assert after < 0.3 * before
    assert error(torch.zeros_like(samples["observation.state"])) == pytest.approx(after)


def test_the_second_loss_has_its_weight(build, samples):
    torch.manual_seed(0)
    with_images = build(interface="raw", sight_weight=2.0).eval()
    without = build(interface="raw", sight_weight=0.0).eval()
    without.load_state_dict(with_images.state_dict())
    torch.manual_seed(1)
    loss, parts = with_images.forward(samples)
    torch.manual_seed(1)
    alone, _ = without.forward(samples)
    assert parts["sight_loss"] > 0
    assert loss.item() == pytest.approx(alone.item() + 2 * parts["sight_loss"], rel=1e-5)


def demonstrated(samples, part):
    hand = {
        "joint": samples["action"][..., 7:23],
        "commanded": samples["action"][..., 23:],
        "raw": samples[NEXT_TIPS],
    }
    return torch.cat([samples["action"][..., :7], hand[part]], -1)


@pytest.mark.parametrize("interface", ["joint", "raw", "commanded"])
def test_fitted_chunks_lie_close_to_the_demonstrated_ones(trained, samples, interface):
    policy = trained[interface]
    part = "measured" if interface == "raw" else interface
    columns, valid = policy.plan.columns(part), ~samples["action_is_pad"]
    predicted = policy.predict_plan(samples, noise(policy, 16))[..., columns]
    mean, std = policy.scale.mean[:, columns], policy.scale.std[:, columns]
    error, ignorant = (
        ((plan - demonstrated(samples, interface)) / std)[valid].abs().mean() for plan in (predicted, mean)
    )
    assert error < 0.6 * ignorant


def test_every_interface_executes_its_part_of_the_same_plan(trained, observation):
    whole = trained["raw"].predict_plan(observation, noise(trained["raw"]))
    parts = {"joint": range(7, 23), "commanded": range(23, 35), "raw": range(35, 47)}
    for interface, columns in parts.items():
        policy = trained[interface]
        assert torch.equal(policy.predict_plan(observation, noise(policy)), whole)
        chunk = policy.predict_action_chunk(observation, noise(policy))
        planned = whole[..., [*range(7), *columns]]
        if interface == "raw":
            touching = observation["observation.tactile"].unflatten(-1, (4, -1)).sum(-1) > CONTACT_FORCE
            tips = without_squeeze(planned[..., 7:], observation["observation.fingertips"], touching)
            planned = torch.cat([planned[..., :7], tips], -1)
        assert torch.equal(chunk, planned)


def test_select_action_returns_joint_targets_and_executes_each_chunk_sixteen_times(trained, observation):
    policy = trained["joint"]
    policy.reset()
    chunk = policy.predict_action_chunk(observation, noise(policy))
    for k in range(16):
        assert torch.equal(policy.select_action(observation, noise(policy)), chunk[:, k])
    replanned = policy.select_action(observation, noise(policy, seed=1))
    assert torch.equal(replanned, policy.predict_action_chunk(observation, noise(policy, seed=1))[:, 0])


def test_raw_execution_asks_for_exactly_the_planned_fingertips_from_the_measured_ones(trained, observation):
    policy = trained["raw"]
    measured = fingertips(LEAP, observation["observation.state"][:, 7:].double())
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
    policy = trained[interface]

    def act(rows):
        policy.reset()
        seen = {key: value[rows] for key, value in observation.items()}
        return torch.stack([policy.select_action(seen, noise(policy)[rows]) for _ in range(18)])

    together = act(slice(0, 4))
    alone = torch.cat([act(slice(i, i + 1)) for i in range(4)], 1)
    torch.testing.assert_close(together, alone, rtol=0, atol=2e-5)


@pytest.mark.parametrize("interface", ["joint", "raw"])
def test_a_reloaded_policy_acts_bit_for_bit_alike(trained, observation, interface, tmp_path):
    policy = trained[interface]
    policy.save_pretrained(tmp_path)
    again = type(policy).from_pretrained(tmp_path)
    assert again.config.learns == policy.config.learns
    for instance in (policy, again):
        instance.reset()
    for _ in range(9):
        expected = policy.select_action(observation, noise(policy))
        assert torch.equal(again.select_action(observation, noise(policy)), expected)
    assert all(torch.equal(a, b) for a, b in zip(again.parameters(), policy.parameters(), strict=True))


def test_an_interface_whose_part_was_not_learned_is_refused_with_those_that_fit(build, tmp_path):
    from lerobot.configs import PreTrainedConfig

    policy = build(interface="raw", learns=["measured"])
    policy.save_pretrained(tmp_path)
    switched = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--interface=press:2"])
    assert type(policy).from_pretrained(tmp_path, config=switched).execution.interface.name == "press:2"
    for refused, message in (
        ("--interface=joint", r"'joint' executes joint targets, but .* --policy.interface=raw\|press"),
        ("--draft=commanded", r"'raw' executes commanded fingertips, but .* Choose --policy.draft=measured"),
    ):
        config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=[refused])
        with pytest.raises(DexFlexError, match=message):
            type(policy).from_pretrained(tmp_path, config=config)


def test_a_checkpoint_cannot_be_told_to_have_learned_something_else(build, tmp_path):
    from lerobot.configs import PreTrainedConfig

    policy = build(interface="raw")
    policy.save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--learns=[measured]"])
    with pytest.raises(DexFlexError, match=r"(?s)cannot be loaded.*leave --policy.learns and the network"):
        type(policy).from_pretrained(tmp_path, config=config)


def test_demonstrations_of_motion_alone_train_a_policy_of_measured_fingertips(build, samples):
    motion = {**samples, "action": samples["action"].clone()}
    motion["action"][..., 7:] = float("nan")
    policy = build(interface="raw", learns=["measured"])
    assert policy.plan.size == 7 + 12
    losses = train(policy, motion, 3)
    assert np.isfinite(losses).all()
    torch.manual_seed(0)
    torch.testing.assert_close(policy.forward(motion)[0], _seeded(policy, samples))


def _seeded(policy, batch):
    torch.manual_seed(0)
    return policy.forward(batch)[0]


def test_measured_fingertips_are_needed_only_where_they_are_learned(build, samples):
    without = {key: value for key, value in samples.items() if key != NEXT_TIPS}
    policy = build(interface="raw", learns=["joint", "commanded"])
    assert torch.isfinite(policy.forward(without)[0])
    with pytest.raises(DexFlexError, match=r"lacks 'observation.next_fingertips'"):
        build(interface="raw").forward(without)


def test_dropout_acts_in_training_alone(build, samples):
    policy = build(
        interface="raw", dropout=0.5, touch_dropout=0.0, brightness=0.0, arm_noise=0.0, hand_noise=0.0
    )
    train(policy, samples, 3)  # Gates of the blocks start at 0: nothing would be hidden.
    network, average = policy.network, policy.average
    assert torch.equal(_seeded(policy, samples), _seeded(policy, samples))
    observed = policy._observe(samples)
    x, t = torch.randn(1, 16, 24, policy.plan.size), torch.full((1, 16), 0.5)
    policy.train()
    first, second = (network.clean(x, t, network.encode(observed)) for _ in range(2))
    assert not torch.equal(first, second)
    policy.eval()
    first, second = (average.clean(x, t, average.encode(observed)) for _ in range(2))
    assert torch.equal(first, second)


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
    assert change == pytest.approx(LEAP.joint_speeds.min() * CONTROL_PERIOD, abs=1e-6)


def test_observations_take_the_statistics_of_the_dataset_and_each_fingertip_has_one_scale(build):
    policy = build(interface="raw")
    assert policy.normalization.state.std.unique().numel() > 4
    assert policy.normalization.fingertips.std.unique().numel() <= 4


def test_noise_of_another_shape_is_refused(build, observation):
    policy = build().eval()
    with pytest.raises(DexFlexError, match=r"`noise` must have shape \(4, 24, 47\). Got \(4, 23\)"):
        policy.predict_action_chunk(observation, torch.zeros(4, 23))


@pytest.mark.parametrize("interface", ["joint", "raw", "press", "dexflex"])
def test_mixed_precision_is_for_the_plan_alone(build, controller_folder, observation, interface):
    policy = build(interface=interface, controller=str(controller_folder)).eval()
    with torch.autocast("cpu"):
        targets = torch.stack([policy.select_action(observation, noise(policy)) for _ in range(17)])
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
