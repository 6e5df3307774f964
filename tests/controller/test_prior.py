import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig
from lerobot_dexflex.controller.prior import Prior


@pytest.fixture(scope="module")
def prior(hand):
    torch.manual_seed(0)
    prior = Prior(ControllerConfig(hand=hand.name, prior_width=32, prior_layers=1)).requires_grad_(False)
    for parameter in prior.parameters():
        parameter.add_(0.1 * torch.randn_like(parameter))
    return prior


@pytest.fixture
def context(prior, controller, history):
    return prior.context(controller.encode(history))


def noise(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_finger_that_starts_at_one_stays_as_it_is_and_the_others_are_drawn(hand, prior, context, steps):
    n = hand.n_fingers
    x, start = noise(3, n, n, 24), torch.eye(n)
    drawn = prior.sample(x, start, steps, context)
    kept = start.bool()
    assert torch.equal(drawn[:, kept], x[:, kept])
    assert (drawn[:, ~kept] != x[:, ~kept]).any(-1).all()


def test_a_finger_that_is_drawn_anew_answers_to_those_that_stay(hand, prior, context):
    start, x = 1 - torch.eye(hand.n_fingers)[:1], noise(3, 1, hand.n_fingers, 24)
    other = x.clone()
    other[:, :, 2] += 1
    drawn, changed = (prior.sample(each, start, 2, context)[:, :, 0] for each in (x, other))
    assert (drawn - changed).abs().amax(-1).min() > 1e-3


def test_draws_do_not_depend_on_each_other_or_on_their_order(hand, prior, context):
    n = hand.n_fingers
    x, start = noise(3, 5, n, 24), torch.rand(5, n, generator=torch.Generator().manual_seed(1))
    together = prior.sample(x, start, 3, context)
    for i in range(5):
        alone = prior.sample(x[:, i : i + 1], start[i : i + 1], 3, context)
        assert torch.allclose(alone[:, 0], together[:, i], atol=1e-5)


def test_last_step_lands_on_the_aim(hand, prior, context):
    x, t = noise(3, 2, hand.n_fingers, 24), torch.linspace(0, 0.75, hand.n_fingers).expand(2, -1)
    times = t.expand(3, -1, -1)
    sampled = prior.sample(x, t, 1, context)
    assert torch.allclose(sampled, prior.aim(x, times, 1 - times, context), atol=1e-5)


def test_a_step_of_the_sampler_follows_the_velocity(hand, prior, context):
    """Of two steps from time 0 the first goes half the velocity's way, the second to where it points."""
    n = hand.n_fingers
    x, half = noise(3, 1, n, 24), torch.full((3, 1, n), 0.5)
    middle = x + 0.5 * prior.velocity(x, torch.zeros_like(half), half, context)
    sampled = prior.sample(x, torch.zeros(1, n), 2, context)
    assert torch.allclose(sampled, middle + 0.5 * prior.velocity(middle, half, half, context), atol=1e-5)
