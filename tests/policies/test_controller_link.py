import json
import shutil
import warnings

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from safetensors.torch import load_file

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.errors import DexFlexError

LEARNED = ["dexgen", "dexflex"]


@pytest.fixture
def policy(build, controller_folder):
    def make(interface, **settings):
        return build(interface=interface, controller=str(controller_folder), **settings)

    return make


def weights(policy):
    """All weights of the interface's controller."""
    parts = {"controller": policy.execution.interface.controller}
    if policy.config.interface == "dexgen":
        parts["prior"] = policy.execution.interface.prior
    return {f"{p}.{k}": v.clone() for p, part in parts.items() for k, v in part.state_dict().items()}


@pytest.mark.parametrize("interface", LEARNED)
def test_a_training_step_leaves_the_controller_bit_for_bit_as_it_was(policy, samples, interface):
    trained = policy(interface).train()
    before, own = weights(trained), [value.clone() for value in trained.network.parameters()]
    optimizer = torch.optim.AdamW(trained.get_optim_params(), 1e-2)
    loss, _ = trained.forward(samples)
    loss.backward()
    optimizer.step()
    trained.update()
    assert any(not torch.equal(a, b) for a, b in zip(own, trained.network.parameters(), strict=True))
    assert all(torch.equal(value, before[name]) for name, value in weights(trained).items())
    assert not any(value.requires_grad for value in trained.execution.interface.controller.parameters())
    assert not trained.execution.interface.controller.training


@pytest.mark.parametrize("interface", LEARNED)
def test_the_controller_is_neither_optimised_nor_saved_but_named_with_its_content(
    policy, build, controller_folder, tmp_path, interface
):
    ours, raw = policy(interface), build(interface="raw")
    assert set(ours.state_dict()) == set(raw.state_dict())
    assert len(list(ours.get_optim_params())) == len(list(raw.get_optim_params()))
    ours.save_pretrained(tmp_path)
    assert set(load_file(tmp_path / "model.safetensors")) == set(load_file(_saved(raw, tmp_path / "raw")))
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["controller"] == str(controller_folder)
    assert config["controller_digest"].startswith(f"{interface}:")


def _saved(policy, folder):
    policy.save_pretrained(folder)
    return folder / "model.safetensors"


@pytest.mark.parametrize("interface", LEARNED)
def test_the_policy_acts_through_the_controller_and_its_rows_act_as_alone(policy, observation, interface):
    acting = policy(interface).eval()
    noise = torch.randn(4, 24, acting.plan.size, generator=torch.Generator().manual_seed(0))

    def act(rows):
        acting.reset()
        seen = {key: value[rows] for key, value in observation.items()}
        return torch.stack([acting.select_action(seen, noise[rows]) for _ in range(3)])

    together = act(slice(0, 4))
    assert together.shape == (3, 4, 23)
    assert acting.execution.interface.explanation.intervention.shape == (4,)
    alone = torch.cat([act(slice(i, i + 1)) for i in range(4)], 1)
    torch.testing.assert_close(together, alone, rtol=0, atol=1e-4)


def test_a_checkpoint_of_drafts_is_switched_to_the_controller_at_evaluation(
    build, controller_folder, tmp_path
):
    raw = build(interface="raw")
    raw.save_pretrained(tmp_path)
    overrides = ["--interface=dexflex", f"--controller={controller_folder}"]
    config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=overrides)
    assert type(raw).from_pretrained(tmp_path, config=config).execution.interface.name == "dexflex"


def test_a_controller_of_other_content_is_reported_and_the_same_is_not(policy, controller_folder, tmp_path):
    folder = shutil.copytree(controller_folder, tmp_path / "controller")
    ours = policy("dexflex")
    ours.config.controller = str(folder)
    ours.save_pretrained(tmp_path / "policy")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        type(ours).from_pretrained(tmp_path / "policy")
    other = DexFlexController.from_pretrained(folder)
    other.decoder.out.bias.data.add_(1)
    other.save_pretrained(folder)
    with pytest.warns(UserWarning, match=r"is not the one that this policy was saved with \(dexflex:\w+\)"):
        type(ours).from_pretrained(tmp_path / "policy")


def test_a_missing_controller_ends_in_one_message_with_the_command_that_trains_it(build, tmp_path):
    with pytest.raises(DexFlexError, match=r"No controller for 'leap' at .*train it: dexflex-train"):
        build(interface="dexflex", controller=str(tmp_path / "nowhere"))
