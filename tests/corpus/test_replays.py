import numpy as np
import pytest

from lerobot_dexflex.corpus import replays
from lerobot_dexflex.corpus.config import CorpusConfig, Jobs, Replays
from lerobot_dexflex.corpus.replays import EXPERT, PERTURBED, replay, run_replays
from lerobot_dexflex.corpus.schema import HORIZON
from lerobot_dexflex.corpus.shard import concatenate, read_replays, shard_path, write_shard
from lerobot_dexflex.errors import DexFlexError


def config(root, **shares):
    split = {"expert": 0.0, "prior": 0.0, "perturbed": 0.0, "draft_seeded": 0.0} | shares
    return CorpusConfig(
        stage="replays", output=root, jobs=Jobs(1, 0, 0), replays=Replays(per_shard=12, **split)
    )


def recorded_chunks(tensors, kept):
    rows = tensors["snapshot_step"][kept]
    return tensors["executed"][rows[:, None] + np.arange(HORIZON)].astype(float)


def test_replaying_what_was_executed_gives_the_recorded_states_bit_for_bit(run):
    # The second episode is a copy; a push, a slip and turning gravity lie within the replayed steps.
    shard = concatenate([run.finish(), run.finish()])
    kept = np.array([0, 2, 3, 5, 7, 8])
    found = replay(shard, kept, recorded_chunks(shard.tensors, kept))
    after = shard.tensors["snapshot_step"][kept][:, None] + np.arange(1, HORIZON + 1)
    for key in ("joints", "fingertips"):
        np.testing.assert_array_equal(found[key].astype(np.float32), shard.tensors[key][after])
    np.testing.assert_array_equal(found["loads"].astype(np.float32), shard.tensors["loads"][after])
    noise = found["tactile"].astype(np.float32) - shard.tensors["tactile"][after]
    assert np.abs(noise).max() < 0.04  # Two readings with 4 mN noise each.
    assert not found["lost"].any()


def test_opening_the_hand_loses_the_grasp(run):
    shard = run.finish()
    squeeze = shard.tensors["command"][0] - shard.tensors["fingertips"][0]
    outward = -squeeze / np.linalg.norm(squeeze, axis=1, keepdims=True)
    chunks = np.stack([np.zeros((HORIZON, 4, 3)), np.broadcast_to(0.004 * outward, (HORIZON, 4, 3))])
    found = replay(shard, np.array([0, 0]), chunks)
    assert found["lost"].tolist() == [False, True]
    assert found["object_motion"][0, 0] < 0.003 < found["object_motion"][1, 0]


def test_a_shard_of_replays_has_the_asked_sources(run, tmp_path):
    write_shard(shard_path(tmp_path / "train", 0), run.finish())
    run_replays(config(tmp_path, expert=0.5, perturbed=0.5), "none", "train", 0)
    found = read_replays(shard_path(tmp_path / "replays/train", 0))
    assert len(found["row"]) == 12
    assert set(found["source"]) == {EXPERT, PERTURBED}
    tensors = run.finish().tensors
    for row, source, chunk in zip(found["row"], found["source"], found["chunk"], strict=True):
        executed = tensors["executed"][row : row + HORIZON]
        assert np.array_equal(chunk, executed) == (source == EXPERT)
        assert source != EXPERT or tensors["expert"][row : row + HORIZON].all()


def test_an_untrained_controller_proposes_chunks(run, tmp_path, monkeypatch):
    import torch

    from lerobot_dexflex.controller import DexFlexController

    torch.manual_seed(0)
    controller = DexFlexController().eval()
    for parameter in controller.prior.parameters():  # Its last layer begins at zero.
        torch.nn.init.normal_(parameter, std=0.05)
    monkeypatch.setattr(replays, "_load", lambda folder: controller)
    write_shard(shard_path(tmp_path / "train", 0), run.finish())
    run_replays(config(tmp_path, prior=0.5, draft_seeded=0.5), "none", "train", 0)
    found = read_replays(shard_path(tmp_path / "replays/train", 0))
    assert len(np.unique(found["chunk"].reshape(12, -1), axis=0)) == 12
    assert np.abs(found["chunk"]).max() > 0


def test_what_is_missing_is_said(run, tmp_path):
    with pytest.raises(DexFlexError, match="Finish the corpus first"):
        run_replays(config(tmp_path, expert=1.0), "none", "train", 0)
    write_shard(shard_path(tmp_path / "train", 0), run.finish())
    with pytest.raises(DexFlexError, match="need `controller`"):
        run_replays(config(tmp_path, prior=1.0), "none", "train", 0)
