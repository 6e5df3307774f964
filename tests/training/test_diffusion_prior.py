import pytest
import torch

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.dexgen import DexGenInterface
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.diffusion_prior import DexGenConfig, DexGenStage
from lerobot_dexflex.training.fit import FitConfig, fit
from lerobot_dexflex.training.train import TrainConfig, train

pytestmark = pytest.mark.usefixtures("no_curves")
FIT = FitConfig(steps=30, batch_size=16, lr=3e-3, warmup_steps=10, ema=0.9)


@pytest.fixture(scope="module")
def controller():
    torch.manual_seed(0)
    return DexFlexController().eval().requires_grad_(False)


@pytest.fixture(scope="module")
def stage(corpus, controller):
    config = DexGenConfig(fit=FIT, held_out_rows=8)
    data, tune = (CorpusData(corpus, split) for split in ("train", "tune"))
    controller.scale.fit(data.plan(data.rows()))
    return DexGenStage(controller, DiffusionPrior(controller.config), data, tune, config)


def test_the_loss_falls_and_the_encoder_stays_as_it_is(stage, controller, tmp_path):
    before = {name: value.clone() for name, value in controller.state_dict().items()}
    stage.batch()
    with torch.no_grad():
        start = stage.loss(stage.batch())[0].item()
    metrics = fit(stage, FIT, tmp_path, seed=0)
    with torch.no_grad():
        assert stage.loss(stage.batch())[0].item() < 0.9 * start
    assert all(torch.equal(value, before[name]) for name, value in controller.state_dict().items())
    assert metrics["lead_mrad"] < metrics["lead_rest_mrad"]
    assert metrics["best_of_32_mm"] <= metrics["best_of_8_mm"] <= metrics["best_of_1_mm"]


def test_overwhelming_guidance_ends_at_the_draft(stage):
    chunk = stage._tune.plan(stage._held_out)
    state = stage._controller.encode(stage._tune.history(stage._held_out))
    assert stage._errors(state, chunk, chunk, 1e6).max() < 0.01


def test_inverse_dynamics_learn_the_operators_own_commands_alone(stage):
    torch.manual_seed(0)
    batch = stage.batch()
    assert batch.own.any()
    assert not batch.own.all()
    other = batch._replace(lead=torch.where(batch.own[:, None], batch.lead, 9.0))
    changed = batch._replace(lead=torch.where(batch.own[:, None], 9.0, batch.lead))
    losses = []
    for each in (batch, other, changed):
        torch.manual_seed(1)
        losses.append(stage.loss(each)[0].item())
    assert losses[0] == losses[1] != losses[2]


def test_the_stage_puts_its_weights_beside_the_controller_that_it_started_from(corpus, controller, tmp_path):
    controller.save_pretrained(tmp_path / "start")
    config = TrainConfig(
        corpus=corpus,
        output=tmp_path / "run",
        stages=["dexgen"],
        init_from=str(tmp_path / "start"),
        dexgen=DexGenConfig(fit=FitConfig(steps=2, batch_size=8), held_out_rows=8),
    )
    folder = train(config)
    interface = DexGenInterface(LEAP, folder)
    assert "dexgen" in interface.controller.record
    assert all(
        torch.equal(a, b)
        for a, b in zip(interface.controller.parameters(), controller.parameters(), strict=True)
    )
