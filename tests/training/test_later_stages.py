import pytest
import torch

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.hand.kinematics import solve_fingertips
from lerobot_dexflex.training.bank import BankConfig, ProposalBank
from lerobot_dexflex.training.corpus_data import CorpusData, ReplayData
from lerobot_dexflex.training.decoder import DecoderConfig, DecoderStage, choose_chunks
from lerobot_dexflex.training.fit import FitConfig
from lerobot_dexflex.training.score import ScoreConfig, ScoreStage, _similar
from lerobot_dexflex.training.world_model import WorldModelConfig, WorldModelStage, recorded


@pytest.fixture(scope="module")
def controller(corpus):
    torch.manual_seed(0)
    controller = DexFlexController().eval().requires_grad_(False)
    torch.nn.init.normal_(controller.prior.chunk_out.weight, std=0.2)
    return controller


@pytest.fixture(scope="module")
def splits(corpus):
    return CorpusData(corpus, "train"), CorpusData(corpus, "tune")


@pytest.fixture(scope="module")
def banks(controller, splits, tmp_path_factory):
    folder, config = tmp_path_factory.mktemp("bank"), BankConfig(n_pure=3, n_seeded=3)
    return [
        ProposalBank.load_or_draw(folder / f"{k}.safetensors", controller, split, config, 96, 0)
        for k, split in enumerate(splits)
    ]


def learn(stage, steps=25, lr=2e-3):
    """Train on one batch; returns first and last loss."""
    batch = stage.batch()
    optimizer = torch.optim.AdamW(stage.network.parameters(), lr=lr)
    losses = []
    for _ in range(steps):
        torch.manual_seed(0)
        loss, info = stage.loss(batch)
        assert all(torch.isfinite(v) for v in info.values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    stage.average.load_state_dict(stage.network.state_dict())
    stage.network.eval().requires_grad_(False)
    return losses[0], losses[-1]


def test_world_model_learns_a_batch_and_reports_every_source(controller, splits, corpus):
    train, tune = ((s, ReplayData(corpus, n, s)) for s, n in zip(splits, ("train", "tune"), strict=True))
    config = WorldModelConfig(fit=FitConfig(batch_size=48), held_out_rows=32)
    stage = WorldModelStage(controller, train, tune, config)
    first, last = learn(stage)
    assert last < 0.8 * first
    with torch.no_grad():
        metrics = stage.evaluate()
    sources = {"search", "operator", "acquisition", "loop", "failed", "replay_expert", "replay_seeded"}
    assert {f"{name}_vs_copy" for name in sources} <= set(metrics)
    assert {"contact_loss_auc", "contact_loss_auc_no_touch", "grasp_loss_auc"} <= set(metrics)


def test_world_model_works_without_replays(controller, splits, corpus, tmp_path):
    none = ReplayData(tmp_path, "train", splits[0])
    stage = WorldModelStage(
        controller, (splits[0], none), (splits[1], none), WorldModelConfig(held_out_rows=16)
    )
    assert len(stage.batch().chunk) == 256


def test_contact_is_lost_where_a_loaded_finger_ends_unloaded(splits):
    data = splits[0]
    rows = data.transition_rows()
    batch, loads = recorded(data, rows), data.columns["loads"]
    ending = torch.stack([loads[rows + 7], loads[rows + 8]]).amin(0)
    assert torch.equal(batch.contact_loss, (loads[rows] > 0.05) & (ending <= 0.05))
    assert batch.contact_loss.any()
    assert torch.equal(batch.grasp_loss, data.ahead("lost", rows).any(1))


def test_bank_holds_drafts_as_given_and_imagined_ones(banks, splits):
    bank, columns = banks[0], splits[0].columns
    rows, proxy, kind = bank.tensors["row"], bank.tensors["proxy"], columns["kind"]
    assert bank.tensors["chunks"].shape == (96, 7, 8, 4, 3)
    assert proxy[(kind[rows] == 0) | (kind[rows] == 2)].all()
    given = ~proxy
    assert given.any()
    assert torch.equal(bank.tensors["draft"][given][:, 0], columns["draft"][rows[given]])
    assert (columns["step"][rows] > 0).all()
    index = torch.arange(96)
    assert torch.allclose(bank.get("chunks", index)[:, 0], bank.get("draft", index), atol=2e-6)


def test_bank_is_drawn_once(controller, splits, tmp_path):
    path, config = tmp_path / "bank.safetensors", BankConfig(n_pure=1, n_seeded=1)
    first = ProposalBank.load_or_draw(path, controller, splits[0], config, 8, 0)
    drawn = path.stat().st_mtime_ns
    again = ProposalBank.load_or_draw(path, controller, splits[0], config, 8, 0)
    assert path.stat().st_mtime_ns == drawn
    assert all(torch.equal(first.tensors[name], again.tensors[name]) for name in first.tensors)


def test_score_learns_to_pick_the_candidate_near_the_label(controller, banks):
    config = ScoreConfig(fit=FitConfig(batch_size=32), outcome_weight=0.1)
    stage = ScoreStage(controller, banks[0], banks[1], config)
    with torch.no_grad():
        before = stage.evaluate()
    first, last = learn(stage)
    assert last < first
    with torch.no_grad():
        after = stage.evaluate()
    for name in ("given", "proxy"):
        assert after[f"{name}_best_mm"] <= after[f"{name}_picked_mm"]
        assert after[f"{name}_regret_mm"] == pytest.approx(
            after[f"{name}_picked_mm"] - after[f"{name}_best_mm"], abs=1e-6
        )
        assert after[f"{name}_draft_mm"] == before[f"{name}_draft_mm"]


def test_hard_negatives_have_the_most_similar_drafts():
    draft = torch.tensor([0.0, 1.0, 5.0, 5.5]).view(4, 1, 1, 1).expand(4, 8, 4, 3)
    assert _similar(draft, 1).flatten().tolist() == [1, 0, 3, 2]


def test_decoder_learns_what_inverse_kinematics_leaves(controller, banks, splits):
    train, tune = zip(splits, banks, strict=True)
    stage = DecoderStage(controller, train, tune, DecoderConfig(fit=FitConfig(batch_size=64), clean_share=0))
    assert stage.evaluate()["given_after_mrad"] == stage.evaluate()["given_before_mrad"]
    first, last = learn(stage)
    assert last < 0.7 * first


def test_residual_is_the_labels_command_minus_raw_inverse_kinematics(controller, banks, splits):
    data, bank = splits[0], banks[0]
    chosen = choose_chunks(controller, data, bank, clean=True)
    columns, rows = data.columns, bank.tensors["row"]
    target = (columns["command"][rows] + bank.tensors["clean"][:, 0]).double()
    raw = solve_fingertips(target, columns["joint_targets"][rows - 1].double())
    expected = (columns["label_joints"][rows] - raw).clamp(-0.15, 0.15)
    assert torch.allclose(chosen.residual, expected.float(), atol=1e-6)
