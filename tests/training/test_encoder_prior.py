import copy

import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig, DexFlexController, State
from lerobot_dexflex.controller.decoder import Forces
from lerobot_dexflex.controller.prior import LAST_TIME, Prior
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.encoder_prior import (
    EncoderPriorConfig,
    EncoderPriorStage,
    flow_losses,
    flow_times,
    force_losses,
    force_metrics,
)
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
        chunk = (torch.randn(96, 1).sign() * (1 + 0.5 * wide)).view(96, 1, 1, 1).expand(-1, -1, 4, 24)
        last = State(*[part[72:] for part in state])
        loss = sum(flow_losses(prior, average, state, last, chunk, *flow_times(4, 96, 72, 0.5, 0.4)))
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
    drawn = toy_prior.sample(torch.randn(64, 16, 4, 24), torch.zeros(16, 4), nfe, toy_prior.context(state))
    level = drawn.mean((-1, -2))
    for sign, mode in ((1, 1.5), (-1, 0.5)):
        there = level[wide[:, 0] == sign]
        assert float(there.abs().mean()) == pytest.approx(mode, abs=tolerance)
        assert 0.3 < float((there > 0).double().mean()) < 0.7


def test_seeded_draws_stay_in_the_mode_of_their_seed(toy_prior):
    torch.manual_seed(1)
    state, wide = toy_states(64)
    seed = torch.full((64, 8, 4, 24), 1.0)
    noisy = 0.25 * torch.randn_like(seed) + 0.75 * seed
    drawn = toy_prior.sample(noisy, torch.full((8, 4), 0.75), 1, toy_prior.context(state)).mean((-1, -2))
    assert (drawn > 0).double().mean() > 0.98
    assert float(drawn[wide[:, 0] == 1].mean()) == pytest.approx(1.5, abs=0.35)


def test_a_finger_drawn_anew_joins_the_mode_of_the_others(toy_prior):
    torch.manual_seed(1)
    state, wide = toy_states(64)
    mode = (1 + 0.5 * wide).view(64, 1, 1, 1) * torch.tensor([1.0, -1.0]).view(1, 2, 1, 1)
    own = torch.eye(4, dtype=torch.bool)[[0, 3]]
    begin = torch.where(own[..., None], torch.randn(64, 2, 4, 24), mode)
    drawn = toy_prior.sample(begin, (~own).float(), 2, toy_prior.context(state))[:, own].mean(-1)
    assert (drawn.sign() == torch.tensor([1.0, -1.0])).double().mean() > 0.9


def test_flow_times_fill_their_bounds():
    torch.manual_seed(0)
    t, size = flow_times(4, 4000, 3000, own_share=0.5, clean_share=0.4)
    assert t.shape == size.shape == (4000, 1, 4)
    clean = t == 1
    assert (size[clean] == 0).all()
    assert (size[:3000] == 0).all()
    assert (size[3000:][~clean[3000:]] > 0).all()
    assert t.min() >= 0
    assert t[:3000][~clean[:3000]].max() <= LAST_TIME
    assert (t + size).max() <= 1 + 1e-6
    assert float(clean.double().mean()) == pytest.approx(0.5 * 0.4, abs=0.02)
    common = (t == t[..., :1]).all(-1) & ~clean.all(-1)
    assert float(common.double().mean()) == pytest.approx(0.5, abs=0.03)
    assert (size == size[..., :1])[common].all()
    whole, steps = flow_times(4, 500, 400, own_share=0.0, clean_share=0.4)
    assert (whole == whole[..., :1]).all()
    assert (steps == steps[..., :1]).all()


def test_fingers_that_are_shown_as_they_are_have_no_loss(monkeypatch):
    torch.manual_seed(0)
    prior, (state, _) = Prior(CONFIG), toy_states(8)
    last = State(*[part[8:] for part in state])
    t = torch.tensor([1.0, 0.2, 1.0, 1.0]).expand(8, 1, 4)
    chunk = torch.randn(8, 1, 4, 24)
    output = prior.velocity
    for finger, matters in ((0, False), (1, True)):
        bent = torch.zeros(4)[:, None]
        bent[finger] = 3.0
        losses = []
        for bend in (0.0, bent):
            torch.manual_seed(1)
            monkeypatch.setattr(prior, "velocity", lambda *given, bend=bend: output(*given) + bend)
            flow, consistency = flow_losses(prior, prior, state, last, chunk, t, torch.zeros(8, 1, 4))
            assert consistency == 0
            losses.append(flow.item())
        assert (losses[0] != losses[1]) == matters


def test_errors_of_forces_on_a_known_example():
    target = torch.tensor([[[2.0, 0, 0], [0, 0, 4.0], [0, 0, 0], [0, 0, 0.01]]])
    found = torch.tensor([[[3.0, 0, 0], [0, 4.0, 0], [7.0, 0, 0], [9.0, 0, 0]]])  # The last two do not press.
    metrics = force_metrics(Forces(found, torch.tensor([[2.0, -1.0, 1.0, -3.0]])), target)
    assert metrics == {
        "force_size_error": pytest.approx(0.5),  # 1 N and 0 N.
        "force_direction_deg": pytest.approx(45),  # 0 and 90 degrees.
        "force_unexplained": pytest.approx((1 + 32) / 10),
        "pressing_auc": 0.75,
    }
    force, entropy = force_losses(Forces(target + 0.0, torch.tensor([[9.0, 9.0, -9.0, -9.0]])), target, 2.0)
    assert force == 0
    assert entropy < 1e-3


def test_a_batch_in_which_no_finger_presses_has_finite_losses_and_gradients():
    vector = torch.ones(2, 4, 3, requires_grad=True)
    pressing = torch.zeros(2, 4, requires_grad=True)
    force, entropy = force_losses(Forces(vector, pressing), torch.zeros(2, 4, 3), 2.0)
    (force + entropy).backward()
    assert force == 0
    assert vector.grad is not None
    assert vector.grad.eq(0).all()


@pytest.fixture
def stage(corpus):
    torch.manual_seed(0)
    config = EncoderPriorConfig(fit=FitConfig(batch_size=64), held_out_rows=32)
    train, tune = (CorpusData(corpus, split) for split in ("train", "tune"))
    return EncoderPriorStage(DexFlexController(), train, tune, config)


def test_every_parameter_of_encoder_prior_and_decoder_is_trained(stage):
    optimizer = torch.optim.AdamW(stage.network.parameters(), lr=1e-3)
    info = {}
    for _ in range(4):  # Layers that begin at zero pass gradients on after the first steps.
        optimizer.zero_grad()
        loss, info = stage.loss(stage.batch())
        loss.backward()
        optimizer.step()
    assert set(info) == {"flow", "consistency", "force", "pressing", "load", "contact", "slow"}
    without = [n for n, p in stage.network.named_parameters() if p.grad is None or not p.grad.any()]
    assert without == []


def test_the_decoder_sees_plans_and_by_their_share_drafts(stage):
    torch.manual_seed(0)
    batch = stage.batch()
    differs = (batch.executed != batch.chunk).flatten(1).any(1)
    assert 0 < differs.sum() < 0.35 * len(differs)  # About half of the drafts are spoilt.


def test_forces_and_loads_are_learnt_and_hold_on_other_objects(stage):
    with torch.no_grad():
        before = stage.evaluate()
    optimizer = torch.optim.AdamW(stage.network.parameters(), lr=2e-3)
    for _ in range(60):
        loss = stage.loss(stage.batch())[0]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    stage.average.load_state_dict(stage.network.state_dict())
    with torch.no_grad():
        after = stage.evaluate()
    for name in ("force_size_error", "force_direction_deg", "force_unexplained", "log_load_error"):
        assert after[name] < 0.5 * before[name], name
    assert after["log_load_error"] < 0.5 * after["log_load_error_no_touch"]
    assert after["pressing_auc"] > 0.9


def test_scale_is_fitted_and_metrics_cover_the_comparison_without_touch(stage):
    assert not torch.allclose(stage.network.get_buffer("scale.scale"), torch.tensor(0.001))
    with torch.no_grad():
        metrics = stage.evaluate()
    names = {"one_finger_mm", "one_finger_still_mm", "standing_still_mm", "slow_perplexity"}
    names |= {"contact_later_auc", "contact_later_auc_no_touch", "force_unexplained_no_touch"}
    assert names <= set(metrics)
    assert metrics["best_of_32_nfe4_mm"] <= metrics["best_of_1_nfe4_mm"]
    assert metrics["slow_perplexity"] > 2
