import json
from pathlib import Path

import draccus
import numpy as np
import pyarrow.parquet as pq
import pytest

from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.recording import RecordConfig
from lerobot_dexflex.recording.attempt import run_attempt

ROOT = Path(__file__).parents[1]
RECIPES = sorted(path.parents[1] / "recipe.yaml" for path in (ROOT / "datasets").glob("*/meta/info.json"))
"""Of the LeRobot datasets; corpora have tests of their own."""
APPROACH = 20
"""Steps before the first contact: what later chaos amplifies is not compared across machines."""

pytestmark = pytest.mark.parametrize("recipe", RECIPES, ids=lambda path: path.parent.name)


def parse(recipe: Path) -> RecordConfig:
    return draccus.parse(RecordConfig, config_path=recipe, args=[])


def test_the_recipe_is_that_of_the_dataset_beside_it(recipe):
    config = parse(recipe)
    record = json.loads((recipe.parent / "meta/recording.json").read_text())
    info = json.loads((recipe.parent / "meta/info.json").read_text())
    assert ROOT / config.root == recipe.parent
    assert RecordConfig.identity(config.to_dict()) == RecordConfig.identity(record["recipe"])
    assert record["complete"]
    assert record["episodes"] == config.episodes == info["total_episodes"]
    assert record["episode_seeds"] == [a["seed"] for a in record["attempts"] if a["success"]]
    assert record["expert"]["attempts"] == len(record["attempts"])


def test_the_dataset_is_small_enough_to_be_committed(recipe):
    size = sum(file.stat().st_size for file in recipe.parent.rglob("*") if file.is_file())
    assert size <= 10 * 2**20


def test_the_recipe_records_the_dataset_again(recipe):
    """Of the first demonstrations one that ends well here, too: another processor may lose a grip."""
    config = parse(recipe)
    seeds = json.loads((recipe.parent / "meta/recording.json").read_text())["episode_seeds"]
    how = {name: getattr(config, name) for name in ("glove", "interface", "controller", "source")}
    hand, first = get_hand(config.hand), config.seed
    attempts = ((k, run_attempt(hand, config.task, first, seeds[k] - first, **how)) for k in range(5))
    episode, attempt = next(found for found in attempts if found[1].success)
    table = pq.read_table(recipe.parent / "data/chunk-000/file-000.parquet")
    rows = np.flatnonzero(table["episode_index"].to_numpy() == episode)[:APPROACH]
    shipped = table.take(rows)
    for key in ("observation.state", "observation.fingertips", "action"):
        expected = np.stack(shipped[key].to_numpy())
        np.testing.assert_allclose(attempt.frames[key][:APPROACH], expected, atol=1e-3)
