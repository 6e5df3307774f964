import copy

import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig, DexFlexController, State
from lerobot_dexflex.controller.prior import Prior
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.encoder_prior import EncoderPriorConfig, EncoderPriorStage, flow_losses
from lerobot_dexflex.training.fit import FitConfig

CONFIG = ControllerConfig(prior_width=32, prior_layers=1)


def toy_states(rows):
    """States that say by their body how wide the two modes are apart."""
    wide = torch.randn(rows, 1).sign()
    zeros = [torch.zeros(rows, n) for n in (CONFIG.contact_width, CONFIG.slow_width)]
    body, fingers = wide.expand(rows, CONFIG.body_width), torch.zeros(rows, 4, CONFIG.finger_width)
    return State(body, zeros[0], fingers, zeros[1]), wide


@pytest.fixture(scope="module")
def toy_prior():
    """Learns chunks of one value: -1.5 or 1.5 in wide states, -0.5 or 0.5 in narrow ones."""
    torch.manual_seed(0)
    prior = Prior(CONFIG)
    average = copy.deepcopy(prior).requires_grad_(False)
    optimizer, steps = torch.optim.AdamW(prior.parameters(), lr=5e-3), 350
    for k in range(steps):
        optimizer.param_groups[0]["lr"] = 5e-3 * (1 - k / steps)
        state, wide = toy_states(96)
        chunk = (torch.randn(96, 1).sign() * (1 + 0.5 * wide)).expand(-1, 96).unsqueeze(1)
        last = State(*[part[72:] for part in state])
        loss = sum(flow_losses(prior, average, state, last, chunk))
        assert isinstance(loss, torch.Tensor)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay = min(0.99, (1 + k) / (10 + k))
        for a, b in zip(average.parameters(), prior.parameters(), strict=True):
            a.data.lerp_(b.data, 1 - decay)
    return average


@pytest.mark.parametrize(("nfe", "tolerance"), [(1, 0.35), (2, 0.2), (4, 0.15)])
def test_prior_learns_both_modes_and_few_steps_suffice(toy_prior, nfe, tolerance):
    torch.manual_seed(1)
    state, wide = toy_states(64)
    drawn = toy_prior.sample(torch.randn(64, 16, 96), [0.0] * 16, [nfe] * 16, toy_prior.context(state))
    level = drawn.mean(-1)
    for sign, mode in ((1, 1.5), (-1, 0.5)):
        there = level[wide[:, 0] == sign]
        assert float(there.abs().mean()) == pytest.approx(mode, abs=tolerance)
        assert 0.3 < float((there > 0).double().mean()) < 0.7


def test_seeded_draws_stay_in_the_mode_of_their_seed(toy_prior):
    torch.manual_seed(1)
    state, wide = toy_states(64)
    seed = torch.full((64, 8, 96), 1.0)
    noisy = 0.25 * torch.randn_like(seed) + 0.75 * seed
    drawn = toy_prior.sample(noisy, [0.75] * 8, [1] * 8, toy_prior.context(state)).mean(-1)
    assert (drawn > 0).double().mean() > 0.98
    assert float(drawn[wide[:, 0] == 1].mean()) == pytest.approx(1.5, abs=0.35)


@pytest.fixture
def stage(corpus):
    torch.manual_seed(0)
    config = EncoderPriorConfig(fit=FitConfig(batch_size=64), held_out_rows=32)
    train, tune = (CorpusData(corpus, split) for split in ("train", "tune"))
    return EncoderPriorStage(DexFlexController(), train, tune, config)


def test_every_parameter_of_encoder_and_prior_is_trained(stage):
    optimizer = torch.optim.AdamW(stage.network.parameters(), lr=1e-3)
    info = {}
    for _ in range(4):  # Layers that begin at zero pass gradients on after the first steps.
        optimizer.zero_grad()
        loss, info = stage.loss(stage.batch())
        loss.backward()
        optimizer.step()
    assert set(info) == {"flow", "consistency", "load", "contact"}
    without = [n for n, p in stage.network.named_parameters() if p.grad is None or not p.grad.any()]
    assert without == []


def test_scale_is_fitted_and_metrics_cover_the_comparison_without_touch(stage):
    assert not torch.allclose(stage.network.get_buffer("scale.scale"), torch.tensor(0.001))
    with torch.no_grad():
        metrics = stage.evaluate()
    names = {"best_of_1_nfe1_mm", "best_of_8_nfe4_mm", "best_of_32_nfe4_mm", "best_of_8_no_touch_mm"}
    names |= {"contact_later_auc", "contact_later_auc_no_touch", "slow_perplexity", "labels_best_of_8_mm"}
    assert names <= set(metrics)
    assert metrics["best_of_32_nfe4_mm"] <= metrics["best_of_8_nfe4_mm"] <= metrics["best_of_1_nfe4_mm"]
    assert metrics["slow_perplexity"] > 2
