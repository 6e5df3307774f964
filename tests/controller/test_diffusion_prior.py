from dataclasses import replace

import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig, State
from lerobot_dexflex.controller.diffusion_prior import STEPS, DiffusionPrior
from lerobot_dexflex.errors import DexFlexError

CONFIG = ControllerConfig(prior_width=32, prior_heads=2)


def states(rows, config=CONFIG):
    generator, tokens = torch.Generator().manual_seed(0), (config.n_fingers, config.finger_width)
    shapes = [(config.body_width,), (config.contact_width,), tokens, (config.slow_width,)]
    return State(*(torch.randn(rows, *shape, generator=generator) for shape in shapes))


def normal(*shape, seed=1):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture
def prior():
    torch.manual_seed(0)
    prior = DiffusionPrior(CONFIG)
    with torch.no_grad():
        for value in prior.parameters():
            value.add_(0.05 * torch.randn_like(value))
    return prior.eval().requires_grad_(False)


def test_noise_grows_from_none_to_nearly_all(prior):
    assert prior.signal[0] == 1
    assert prior.signal[STEPS] < 1e-3
    assert (prior.signal.diff() < 0).all()
    x_0 = normal(2, 3, 4, 24)
    level = torch.tensor([[0, 25, STEPS]]).expand(2, -1)
    noisy = prior.corrupt(x_0, level, torch.zeros_like(x_0))
    assert torch.equal(noisy[:, 0], x_0[:, 0])
    torch.testing.assert_close(noisy[:, 2], 0.01 * x_0[:, 2])


@pytest.mark.parametrize("steps", [1, 8, STEPS])
def test_with_a_perfect_denoiser_every_number_of_steps_ends_at_its_chunk(prior, monkeypatch, steps):
    chunk = normal(2, 1, 4, 24, seed=5)
    monkeypatch.setattr(prior, "denoise", lambda x, level, context: chunk)
    found = prior.sample(normal(2, 1, 4, 24), normal(2, 4, 24, seed=2), 0.0, steps, prior.context(states(2)))
    torch.testing.assert_close(found, chunk)


def test_without_guidance_the_draft_is_ignored_and_with_much_of_it_the_result_is_the_draft(prior):
    context, noise = prior.context(states(2)), normal(2, 3, 4, 24)
    first, second = normal(2, 4, 24), normal(2, 4, 24, seed=4)
    free = [prior.sample(noise, draft, 0.0, 8, context) for draft in (first, second)]
    assert torch.equal(*free)
    distances = [
        (prior.sample(noise, first, guidance, 8, context) - first[:, None]).norm()
        for guidance in (0.0, 1.0, 10.0, 100.0, 1e6)
    ]
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 1e-2


def test_weak_guidance_is_a_gradient_step_on_the_distance_to_the_draft(prior, monkeypatch):
    clean, draft, guidance = normal(1, 1, 4, 24, seed=5), normal(1, 4, 24, seed=6), 1e-3
    monkeypatch.setattr(prior, "denoise", lambda x, level, context: clean)
    found = prior.sample(normal(1, 1, 4, 24), draft, guidance, 1, prior.context(states(1)))
    # One step from pure noise: 1 - signal is 1, and the gradient of |x - draft|^2 / 2 is x - draft.
    torch.testing.assert_close(found, clean - guidance * (clean - draft), rtol=0, atol=1e-5)


def test_it_learns_chunks_that_depend_on_the_state():
    torch.manual_seed(0)
    prior, state = DiffusionPrior(replace(CONFIG, prior_layers=1)), states(2)
    chunks = torch.stack([torch.full((4, 24), 1.0), torch.full((4, 24), -1.0)])
    optimizer = torch.optim.AdamW(prior.parameters(), 1e-2)
    losses = []
    for _ in range(40):
        loss = prior.loss(chunks, state, draws=4)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0]
    with torch.no_grad():
        found = prior.sample(normal(2, 4, 4, 24), torch.zeros(2, 4, 24), 0.0, 8, prior.context(state))
    assert (found - chunks[:, None]).abs().mean() < 0.2


def test_inverse_dynamics_know_nothing_of_single_contacts(hand):
    config = replace(CONFIG, hand=hand.name)
    prior, state, chunk = DiffusionPrior(config).eval(), states(2, config), normal(2, hand.n_fingers, 24)
    lead = prior.lead(state, chunk)
    assert lead.shape == (2, hand.n_joints)
    other = state._replace(contact=state.contact + 1, fingers=state.fingers + 1)
    assert torch.equal(prior.lead(other, chunk), lead)
    assert not torch.equal(prior.lead(state._replace(body=state.body.flip(0)), chunk), lead)


def test_weights_are_saved_into_the_folder_and_found_again(prior, tmp_path):
    with pytest.raises(DexFlexError, match="train the stage 'dexgen'"):
        DiffusionPrior.load(tmp_path, CONFIG)
    CONFIG.save(tmp_path / "config.json")
    prior.save(tmp_path)
    again = DiffusionPrior.load(tmp_path, CONFIG)
    assert all(torch.equal(a, b) for a, b in zip(again.parameters(), prior.parameters(), strict=True))
    assert not any(value.requires_grad for value in again.parameters())
    with pytest.raises(DexFlexError, match="does not hold the weights"):
        DiffusionPrior.load(tmp_path, ControllerConfig(prior_width=64))
