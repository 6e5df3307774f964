import torch

from lerobot_dexflex.controller import ControllerConfig
from lerobot_dexflex.controller.prior import Prior


def make_prior():
    torch.manual_seed(0)
    prior = Prior(ControllerConfig(prior_width=32, prior_layers=1)).requires_grad_(False)
    for parameter in prior.parameters():
        parameter.add_(0.1 * torch.randn_like(parameter))
    return prior


def test_draws_do_not_depend_on_each_other_or_on_their_order(controller, history):
    prior, context = make_prior(), None
    context = prior.context(controller.encode(history))
    noise = torch.randn(3, 5, 96)
    start, steps = [0.0, 0.5, 0.75, 0.0, 0.5], [4, 2, 1, 4, 2]
    together = prior.sample(noise, start, steps, context)
    for i in range(5):
        alone = prior.sample(noise[:, i : i + 1], start[i : i + 1], steps[i : i + 1], context)
        assert torch.allclose(alone[:, 0], together[:, i], atol=1e-5)


def test_last_step_lands_on_the_aim(controller, history):
    prior = make_prior()
    context = prior.context(controller.encode(history))
    x = torch.randn(3, 2, 96)
    t, size = torch.full((3, 2), 0.75), torch.full((3, 2), 0.25)
    sampled = prior.sample(x, [0.75, 0.75], [1, 1], context)
    assert torch.allclose(sampled, prior.aim(x, t, size, context), atol=1e-5)
