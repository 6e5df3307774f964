import shutil

import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_dexflex.controller import HistoryBuffer
from lerobot_dexflex.corpus.schema import FORMAT
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import finger_frames
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.training.corpus_data import CorpusData


@pytest.fixture(scope="module", params=[LEAP, SHARPA], ids=lambda hand: hand.name)
def hand(request):
    return request.param


@pytest.fixture(scope="module")
def data(corpora, hand):
    return CorpusData(corpora[hand.name], "train")


def test_all_shards_are_read_and_episodes_stay_apart(data, hand):
    assert data.layout.hands == (hand,)
    assert len(data) == 2 * 6 * 48
    assert data.columns["tactile"].dtype == torch.float16
    assert torch.equal(data.columns["episode"], torch.arange(12).repeat_interleave(48))


def test_history_looks_back_within_the_episode(data, hand):
    rows = torch.tensor([48, 50, 80])  # Steps 0, 2 and 32 of the second episode.
    history, joints = data.history(rows), data.columns["joints"]
    assert torch.equal(history.joints[0], joints[[48] * 4])
    assert torch.equal(history.joints[1], joints[[50, 49, 48, 48]])
    assert torch.equal(history.joints[2], joints[[80, 79, 77, 73]])
    touch = data.columns["tactile"][80].float().view(-1, 60).sum(-1)
    assert torch.allclose(history.slow_loads[2, 0], touch)
    assert history.tactile.shape == (3, 4, hand.n_fingers, 10, 6)


def test_history_equals_what_the_buffer_gathers_at_run_time(data, hand):
    buffer = HistoryBuffer(hand)
    for row in range(48, 96):
        columns = data.columns
        live = buffer.observe(
            {
                "observation.state": columns["joints"][row][None],
                "observation.fingertips": columns["fingertips"][row].flatten()[None],
                "observation.gravity": columns["gravity"][row][None],
                "observation.tactile": columns["tactile"][row][None].float(),
            }
        )
        stored = data.history(torch.tensor([row]))
        for name, a, b in zip(live._fields, live, stored, strict=True):
            assert torch.allclose(a.float(), b.float(), atol=1e-6), (row, name)
        assert torch.equal(buffer.drafts, data.drafts_before(torch.tensor([row])))
        buffer.remember(data.draft(torch.tensor([row])))


def test_transitions_end_in_their_episode_and_execute_what_was_wanted(data):
    rows, columns = data.transition_rows(), data.columns
    assert torch.equal(columns["step"][rows + 8], columns["step"][rows] + 8)
    assert columns["step"][rows].max() == 48 - 1 - 8
    executed = data.executed(rows)
    for ahead in (0, 7):
        expected = columns["wanted"][rows + ahead] - columns["fingertips"][rows]
        assert torch.equal(executed[:, ahead], expected)
    # The first step that is executed is the draft's: the same definition.
    torch.testing.assert_close(executed[:, 0], data.draft(rows)[:, 0], rtol=0, atol=1e-5)


def test_nothing_is_learnt_where_the_object_was_lost_before(data):
    lost, step, rows = data.columns["lost"], data.columns["step"], data.rows()
    usable = torch.tensor([k for k in range(len(data)) if step[k] == 0 or not lost[k - 1]])
    assert torch.equal(rows, usable)
    assert 0 < len(rows) < len(data)


def test_local_forces_turned_back_are_the_palms(data, hand):
    rows = torch.arange(0, len(data), 7)
    local = data.local_forces(rows)
    torch.testing.assert_close(local, data.columns["loads"][rows][..., None] * torch.tensor([0.6, 0.0, 0.8]))
    rotation = finger_frames(hand, data.columns["joints"][rows]).distal_rotation
    palm = (rotation @ local[..., None]).squeeze(-1)
    torch.testing.assert_close(palm, data.columns["forces"][rows])


def test_test_split_is_never_read(corpus):
    with pytest.raises(DexFlexError, match="train, tune"):
        CorpusData(corpus, "test")


@pytest.mark.parametrize("split", ["train", "tune"])
def test_a_corpus_that_mixes_hands_is_refused_by_their_names(corpora, tmp_path, split):
    mixed = shutil.copytree(corpora["leap"], tmp_path / "mixed")
    shutil.copy(corpora["sharpa"] / "train/00000.safetensors", mixed / split / "00007.safetensors")
    message = (
        rf"mixes hands: .*train.00000\.safetensors is of 'leap', .*{split}.00007\.safetensors is of 'sharpa'"
    )
    with pytest.raises(DexFlexError, match=message):
        CorpusData(mixed, "train")


def test_missing_and_damaged_corpora_are_refused(corpus, tmp_path):
    with pytest.raises(DexFlexError, match="no shards"):
        CorpusData(tmp_path, "train")
    shard = load_file(corpus / "train/00000.safetensors")
    (tmp_path / "train").mkdir()
    path = tmp_path / "train/00000.safetensors"
    header = {"format": FORMAT, "hand": "leap", "episodes": "[]", "totals": "{}"}
    save_file({k: v for k, v in shard.items() if k != "forces"}, path, header)
    with pytest.raises(DexFlexError, match="forces"):
        CorpusData(tmp_path, "train")
    path.write_bytes(b"nothing")
    with pytest.raises(DexFlexError, match="no readable shard"):
        CorpusData(tmp_path, "train")
