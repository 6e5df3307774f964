import pytest
import torch

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.training.bank import BankConfig, ProposalBank
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import FitConfig
from lerobot_dexflex.training.score import ScoreConfig, ScoreStage, _similar


@pytest.fixture(scope="module")
def controller():
    torch.manual_seed(0)
    controller = DexFlexController().eval().requires_grad_(False)
    torch.nn.init.normal_(controller.prior.chunk_out.weight, std=0.2)
    return controller


@pytest.fixture(scope="module")
def splits(corpus):
    return CorpusData(corpus, "train"), CorpusData(corpus, "tune")


@pytest.fixture(scope="module")
def banks(controller, splits, tmp_path_factory):
    folder, config = tmp_path_factory.mktemp("bank"), BankConfig(n_pure=3, n_seeded=3, n_finger=4)
    return [
        ProposalBank.load_or_draw(folder / f"{k}.safetensors", controller, split, config, 96, 0)
        for k, split in enumerate(splits)
    ]


def test_bank_holds_the_corpus_drafts_and_their_plans_spoilt_by_the_share(banks, splits):
    bank, data = banks[0], splits[0]
    rows, every = bank.tensors["row"], torch.arange(96)
    assert bank.tensors["chunks"].shape == (96, 1 + 3 + 3 + 4, 8, 4, 3)
    assert torch.equal(bank.get("draft", every), data.draft(rows))
    assert torch.equal(bank.get("clean", every), data.plan(rows))
    assert torch.equal(bank.get("past", every), data.drafts_before(rows))
    assert torch.equal(bank.get("chunks", every)[:, 0], data.draft(rows))
    assert int(bank.spoilt.sum()) == round(0.7 * 96)
    assert torch.equal(bank.spoilt, ~data.columns["expert"][rows])
    assert torch.isin(rows, data.rows()).all()


def test_bank_is_drawn_once(controller, splits, tmp_path):
    path, config = tmp_path / "bank.safetensors", BankConfig(n_pure=1, n_seeded=1, n_finger=1)
    first = ProposalBank.load_or_draw(path, controller, splits[0], config, 8, 0)
    drawn = path.stat().st_mtime_ns
    again = ProposalBank.load_or_draw(path, controller, splits[0], config, 8, 0)
    assert path.stat().st_mtime_ns == drawn
    assert all(torch.equal(first.tensors[name], again.tensors[name]) for name in first.tensors)


def test_score_learns_to_pick_the_candidate_near_the_plan(controller, banks, learn):
    config = ScoreConfig(fit=FitConfig(batch_size=32), outcome_weight=0.1)
    stage = ScoreStage(controller, banks[0], banks[1], config)
    with torch.no_grad():
        before = stage.evaluate()
    first, last = learn(stage)
    assert last < first
    with torch.no_grad():
        after = stage.evaluate()
    assert after["clean_draft_mm"] < 0.1 < after["spoilt_draft_mm"]
    for name in ("spoilt", "clean"):
        assert after[f"{name}_best_mm"] <= after[f"{name}_picked_mm"] < before[f"{name}_picked_mm"]
        assert after[f"{name}_draft_mm"] == before[f"{name}_draft_mm"]


def test_a_candidate_that_loses_the_grasp_is_no_example(controller, banks, monkeypatch):
    """Where the outcome alone tells candidates apart, the loss asks for the one that keeps the grasp."""
    stage = ScoreStage(controller, banks[0], banks[1], ScoreConfig(fit=FitConfig(batch_size=4), tau_mm=1e6))
    batch = stage.batch()
    dream = controller.dream(batch.state, batch.chunks)
    risk = torch.ones_like(dream.grasp_loss)
    risk[:, 2] = 0
    monkeypatch.setattr(controller, "dream", lambda state, chunks: dream._replace(grasp_loss=risk))

    def loss(best):
        score = torch.zeros_like(risk)
        score[:, best] = 10
        monkeypatch.setattr(stage, "_score", lambda network, batch, latent: score)
        return stage.loss(batch)[0].item()

    assert loss(2) < 0.2
    assert loss(1) > 5


def test_hard_negatives_have_the_most_similar_drafts():
    draft = torch.tensor([0.0, 1.0, 5.0, 5.5]).view(4, 1, 1, 1).expand(4, 8, 4, 3)
    assert _similar(draft, 1).flatten().tolist() == [1, 0, 3, 2]
