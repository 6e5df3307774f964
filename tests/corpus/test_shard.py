import numpy as np
import pytest
from safetensors.numpy import save_file

from lerobot_dexflex.corpus.schema import check_rows, columns, snapshot_columns
from lerobot_dexflex.corpus.shard import Shard, concatenate, read_shard, shard_path, write_shard
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP, SHARPA


def filled(types, rows, width=5):
    rng = np.random.default_rng(rows)
    shapes = {key: (rows, *(size or width for size in c.shape)) for key, c in types.items()}
    return {key: rng.integers(0, 2, shapes[key]).astype(c.dtype) for key, c in types.items()}


def small_shard(rows=16, hand=LEAP):
    tensors = filled(columns(hand), rows) | filled(snapshot_columns(hand), 2)
    tensors["step"] = np.arange(rows, dtype=np.int16)
    tensors["episode"] = np.zeros(rows, np.int32)
    tensors["snapshot_step"] = np.array([0, 8], np.int32)
    return Shard(hand, tensors, [{"kind": 0, "commit": "a"}], {"steps": rows})


@pytest.mark.parametrize("hand", [LEAP, SHARPA], ids=lambda hand: hand.name)
def test_a_shard_survives_the_disk(tmp_path, hand):
    shard, path = small_shard(hand=hand), shard_path(tmp_path / "train", 7)
    write_shard(path, shard)
    assert path.name == "00007.safetensors"
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    found = read_shard(path)
    assert found.hand == hand
    assert found.episodes == shard.episodes
    assert found.totals == shard.totals
    for key, value in shard.tensors.items():
        assert found.tensors[key].dtype == value.dtype
        np.testing.assert_array_equal(found.tensors[key], value)


def test_joining_renumbers_episodes_rows_and_snapshots():
    joined = concatenate([small_shard(16), small_shard(20), small_shard(10)])
    check_rows(*joined[:3])
    assert joined.tensors["episode"].tolist() == [0] * 16 + [1] * 20 + [2] * 10
    assert joined.tensors["snapshot_step"].tolist() == [0, 8, 16, 24, 36, 44]
    assert joined.totals == {"steps": 46}


def test_shards_of_different_simulators_are_not_joined():
    other = small_shard()
    other.tensors["snapshot_physics"] = np.zeros((2, 6))
    with pytest.raises(DexFlexError, match="different sizes"):
        concatenate([small_shard(), other])
    with pytest.raises(DexFlexError, match="no shard to join"):
        concatenate([])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joints": np.zeros((16, 15), np.float32)}, r"`joints` must be float32 of shape \(16, 16\)"),
        ({"tactile": np.zeros((16, 240), np.float32)}, "`tactile` must be float16"),
        ({"draft": np.zeros((16, 4, 3), np.float16)}, r"`draft` must be float16 of shape \(16, 8, 4, 3\)"),
        ({"object": np.zeros((16, 6), np.float32)}, r"`object` must be float32 of shape \(16, 7\)"),
        ({"loads": np.full((16, 4), np.nan, np.float32)}, "`loads` holds NaN"),
        ({"step": np.zeros(16, np.int16)}, "`step` must count"),
        ({"episode": np.ones(16, np.int32)}, "`episode` must count"),
        ({"snapshot_step": np.array([8, 16], np.int32)}, "`snapshot_step` must increase"),
        ({"kind": np.full(16, 9, np.uint8)}, "`kind` must be below 3"),
        ({"extra": np.zeros(16)}, "unknown: ..extra"),
    ],
)
def test_a_wrong_tensor_is_refused_by_name(change, message):
    shard = small_shard()
    with pytest.raises(DexFlexError, match=message):
        check_rows(LEAP, shard.tensors | change, shard.episodes)


def test_steps_of_another_hand_are_refused_and_not_joined():
    shard = small_shard(hand=SHARPA)
    with pytest.raises(
        DexFlexError, match=r"`joints` must be float32 of shape \(16, 16\)\. Got .*\(16, 22\)"
    ):
        check_rows(LEAP, shard.tensors, shard.episodes)
    with pytest.raises(DexFlexError, match=r"different hands.*'leap', 'sharpa'"):
        concatenate([small_shard(), shard])


def test_a_missing_column_is_named():
    shard = small_shard()
    del shard.tensors["draft"]
    with pytest.raises(DexFlexError, match=r"Missing: ..draft"):
        check_rows(*shard[:3])


def test_a_damaged_file_is_refused_with_a_remedy(tmp_path):
    path = tmp_path / "00000.safetensors"
    write_shard(path, small_shard())
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DexFlexError, match="Delete it and run dexflex-corpus again"):
        read_shard(path)
    save_file({"a": np.zeros(1)}, path, {"format": "0"})
    with pytest.raises(DexFlexError, match="format '0'"):
        read_shard(path)
