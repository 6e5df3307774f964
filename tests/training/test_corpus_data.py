import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.corpus_data import FAILED, CorpusData, ReplayData


@pytest.fixture(scope="module")
def data(corpus):
    return CorpusData(corpus, "train")


def test_all_shards_are_read_and_episodes_stay_apart(corpus, data):
    assert len(data) == 2 * 6 * 48
    assert data.columns["tactile"].dtype == torch.float16
    assert len(data.columns["episode"].unique()) == 12


def test_history_looks_back_within_the_episode(data):
    rows = torch.tensor([48, 50, 80])  # Steps 0, 2 and 32 of the second episode.
    history, joints = data.history(rows), data.columns["joints"]
    assert torch.equal(history.joints[0], joints[[48] * 4])
    assert torch.equal(history.joints[1], joints[[50, 49, 48, 48]])
    assert torch.equal(history.joints[2], joints[[80, 79, 77, 73]])
    touch = data.columns["tactile"][80].float().view(4, 60).sum(-1)
    assert torch.allclose(history.slow_loads[2, 0], touch)
    assert history.tactile.shape == (3, 4, 4, 10, 6)


def test_history_equals_what_the_buffer_gathers_at_run_time(data):
    from lerobot_dexflex.controller import HistoryBuffer

    buffer = HistoryBuffer()
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
        assert torch.equal(buffer.drafts, data.before("draft", torch.tensor([row])))
        buffer.remember(columns["draft"][row].expand(1, 8, 4, 3))


def test_chunks_never_cross_episodes_and_expert_chunks_are_the_experts(data):
    expert, labelled = data.chunk_rows(expert=True), data.chunk_rows(expert=False)
    assert not set(expert.tolist()) & set(labelled.tolist())
    for rows in (expert, labelled):
        assert (data.columns["kind"][rows] != FAILED).all()
        assert torch.equal(data.ahead("step", rows)[:, -1], data.columns["step"][rows] + 7)
        assert (data.ahead("episode", rows) == data.columns["episode"][rows, None]).all()
    assert data.ahead("expert", expert).all()
    assert torch.equal(data.clean_chunk(expert), data.ahead("executed", expert))
    assert len(data.transition_rows()) == 12 * 40


def test_clean_chunk_undoes_what_the_label_takes_back(data):
    """An operator with a fixed target course c*: u = (c*_t - c*_{t-1}) + 0.2 (c*_{t-1} - c)."""
    generator = torch.Generator().manual_seed(0)
    course = 0.001 * torch.randn(12, 4, 3, generator=generator).cumsum(0)
    executed, label, command = [], [], course[0] + 0.003
    clean, clean_command = [], command
    for k in range(1, 9):
        move = course[k] - course[k - 1]
        label.append(move + 0.2 * (course[k - 1] - command))
        executed.append(label[-1] + 0.002 * torch.randn(4, 3, generator=generator))
        command = command + executed[-1]
        clean.append(move + 0.2 * (course[k - 1] - clean_command))
        clean_command = clean_command + clean[-1]
    data.columns["label"][96:104], data.columns["executed"][96:104] = (
        torch.stack(label),
        torch.stack(executed),
    )
    assert torch.allclose(data.clean_chunk(torch.tensor([96]))[0], torch.stack(clean), atol=1e-6)


def test_replays_begin_and_end_in_the_right_states(corpus):
    data = CorpusData(corpus, "train")
    replays = ReplayData(corpus, "train", data)
    batch = replays.batch(torch.arange(len(replays)))
    later = data.history(batch.rows + 8)
    assert torch.equal(batch.later.joints, later.joints)
    assert torch.equal(batch.later.tactile, later.tactile)
    assert torch.equal(batch.chunk, data.ahead("executed", batch.rows))
    assert torch.equal(batch.loads[:, -1], data.columns["loads"][batch.rows + 8])


def test_corpus_without_replays_is_fine(corpus, tmp_path):
    (tmp_path / "tune").symlink_to(corpus / "tune")
    assert len(ReplayData(tmp_path, "tune", CorpusData(tmp_path, "tune"))) == 0


def test_test_split_is_never_read(corpus):
    with pytest.raises(DexFlexError, match="train, tune"):
        CorpusData(corpus, "test")


def test_missing_and_damaged_corpora_are_refused(corpus, tmp_path):
    with pytest.raises(DexFlexError, match="no shards"):
        CorpusData(tmp_path, "train")
    shard = load_file(corpus / "train/00000.safetensors")
    (tmp_path / "train").mkdir()
    path = tmp_path / "train/00000.safetensors"
    save_file({k: v for k, v in shard.items() if k != "label"}, path)
    with pytest.raises(DexFlexError, match="label"):
        CorpusData(tmp_path, "train")
    path.write_bytes(b"nothing")
    with pytest.raises(DexFlexError, match="cannot be read"):
        CorpusData(tmp_path, "train")
