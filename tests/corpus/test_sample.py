"""The committed sample is what its card and its recipe say."""

from pathlib import Path

import draccus
import numpy as np
import pytest
import yaml

from lerobot_dexflex.corpus.config import CorpusConfig, identity
from lerobot_dexflex.corpus.schema import (
    ACQUIRED,
    COLUMNS,
    FAILED,
    OPERATED,
    REPLAY_COLUMNS,
    SEARCH,
    SNAPSHOT_COLUMNS,
)
from lerobot_dexflex.corpus.shard import read_replays, read_shard, shard_path

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "datasets/reach_corpus_sample"
CONFIGS = sorted((ROOT / "configs/corpus").glob("*.yaml"))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_configurations_parse(path):
    draccus.parse(CorpusConfig, config_path=path, args=[])


@pytest.mark.parametrize(("folder", "stage"), [(SAMPLE, "corpus"), (SAMPLE / "replays", "replays")])
def test_the_recipe_is_that_of_the_configuration(folder, stage):
    found = yaml.safe_load((folder / "recipe.yaml").read_text())
    config = draccus.parse(CorpusConfig, config_path=ROOT / "configs/corpus/sample.yaml", args=[])
    assert found["complete"]
    assert identity(found["recipe"], stage) == identity(config.to_dict(), stage)
    for split in ("train", "tune"):
        assert found["totals"][split]["shards"] == getattr(config.jobs, split)


def test_the_sample_is_small_and_has_every_kind():
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*") if path.is_file()) <= 3 * 2**20
    kinds = {int(k) for path in SAMPLE.glob("train/*.safetensors") for k in read_shard(path).tensors["kind"]}
    assert kinds == {SEARCH, OPERATED, ACQUIRED, FAILED}


@pytest.mark.parametrize("split", ["train", "tune"])
def test_replays_begin_at_kept_rows(split):
    for path in SAMPLE.glob(f"replays/{split}/*.safetensors"):
        replays = read_replays(path)
        for number in np.unique(replays["shard"]):
            shard = read_shard(shard_path(SAMPLE / split, int(number)))
            assert set(replays["row"]) <= set(shard.tensors["snapshot_step"].tolist())


def test_the_card_lists_every_column():
    card = (SAMPLE / "README.md").read_text()
    for columns in (COLUMNS, SNAPSHOT_COLUMNS, REPLAY_COLUMNS):
        for key, column in columns.items():
            shape = "x".join(str(size or "any") for size in column.shape)
            row = f"| `{key}` | {shape} | {column.dtype} | {column.unit} | {column.meaning} |"
            assert row in card, row
