import json
from pathlib import Path

import draccus
import numpy as np
import pytest
import yaml

from lerobot_dexflex.corpus import generate
from lerobot_dexflex.corpus.cli import main
from lerobot_dexflex.corpus.config import CorpusConfig, Jobs, Shares
from lerobot_dexflex.corpus.schema import KINDS, columns, snapshot_columns
from lerobot_dexflex.corpus.shard import Shard, read_header, read_shard, shard_path, write_shard
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP, get_hand
from lerobot_dexflex.runs.lock import locked

CONFIGS = sorted((Path(__file__).parents[2] / "configs/corpus").glob("*.yaml"))


def fake_job(config, commit, split, number):
    """Write four empty steps instead of simulating."""
    seed = config.object_seeds(split, number)[0]
    hand = get_hand(config.hand)
    types = columns(hand) | snapshot_columns(hand)
    rows = {key: np.zeros((4, *(size or 1 for size in c.shape)), c.dtype) for key, c in types.items()}
    rows["step"] = np.arange(4, dtype=np.int16)
    rows["snapshot_step"] = np.arange(4, dtype=np.int32)
    totals = {"steps": 4, "cpu_seconds": 0.5, "pattern_1111": 3, "pattern_0111": 1}
    shard = Shard(hand, rows, [{"seed": seed, "commit": commit}], totals)
    write_shard(shard_path(config.output / split, number), shard)


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "run_job", fake_job)
    return CorpusConfig(output=tmp_path / "corpus", workers=0, jobs=Jobs(3, 1, 1))


def test_a_corpus_has_its_shards_and_a_recipe_with_totals(config):
    assert generate.generate(config, ["--workers=0"])
    files = sorted(path.relative_to(config.output).as_posix() for path in config.output.rglob("*.*"))
    train = [f"train/{k:05d}.safetensors" for k in range(3)]
    assert files == ["recipe.yaml", "test/00000.safetensors", *train, "tune/00000.safetensors"]
    recipe = yaml.safe_load((config.output / "recipe.yaml").read_text())
    assert recipe["complete"]
    assert recipe["origin"]["command"] == "dexflex-corpus --workers=0"
    totals = recipe["totals"]["train"]
    assert (totals["steps"], totals["shards"], totals["steps_per_cpu_second"]) == (12, 3, 8.0)
    assert totals["contact_patterns"] == {"1111": 0.75, "0111": 0.25}
    assert totals["commits"] == [recipe["origin"]["commit"]]


def test_objects_of_the_splits_are_apart(config):
    generate.generate(config, [])
    seeds = {
        split: [
            read_header(path)["episodes"][0]["seed"] for path in sorted((config.output / split).iterdir())
        ]
        for split in ("train", "tune", "test")
    }
    assert seeds == {"train": [0, 8, 16], "tune": [10_000], "test": [20_000]}


def test_what_is_there_is_not_made_again_and_more_can_be_asked_for(config, monkeypatch):
    generate.generate(config, [])
    first = shard_path(config.output / "train", 0)
    stamp = first.stat().st_mtime_ns
    shard_path(config.output / "train", 1).unlink()
    made = []
    monkeypatch.setattr(generate, "run_job", lambda *job: (made.append(job[2:]), fake_job(*job)))
    config.jobs.train = 4
    assert generate.generate(config, [])
    assert made == [("train", 1), ("train", 3)]
    assert first.stat().st_mtime_ns == stamp


def test_an_interrupt_keeps_finished_shards(config, monkeypatch, capsys):
    def interrupted(config, commit, split, number):
        if number == 2:
            raise KeyboardInterrupt
        fake_job(config, commit, split, number)

    monkeypatch.setattr(generate, "run_job", interrupted)
    assert not generate.generate(config, [])
    assert "2 of 5 shards" in capsys.readouterr().out
    assert not yaml.safe_load((config.output / "recipe.yaml").read_text())["complete"]
    monkeypatch.setattr(generate, "run_job", fake_job)
    assert generate.generate(config, [])


def test_another_recipe_or_folder_is_refused_untouched(config, tmp_path):
    generate.generate(config, [])
    before = (config.output / "recipe.yaml").read_text()
    config.steps_per_object = 7
    with pytest.raises(DexFlexError, match="steps_per_object: 600 there, 7 now"):
        generate.generate(config, [])
    config.steps_per_object, config.hand = 600, "sharpa"
    with pytest.raises(DexFlexError, match="hand: leap there, sharpa now"):
        generate.generate(config, [])
    config.hand, changed = "leap", before.replace(LEAP.signature, "leap-00000000")
    (config.output / "recipe.yaml").write_text(changed)
    with pytest.raises(DexFlexError, match=f"numbers: leap-00000000 there, {LEAP.signature} now"):
        generate.generate(config, [])
    assert (config.output / "recipe.yaml").read_text() == changed != before
    config.output = tmp_path / "other"
    config.output.mkdir()
    (config.output / "thesis.tex").touch()
    with pytest.raises(DexFlexError, match="no corpus"):
        generate.generate(config, [])


@pytest.mark.parametrize("name", ["recipe.yaml", "train/00001.safetensors"])
@pytest.mark.parametrize("share", [0.0, 0.5], ids=["empty", "half"])
def test_a_damaged_file_is_named_and_the_others_stay(config, name, share):
    generate.generate(config, [])
    path = config.output / name
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    others = {file: file.read_bytes() for file in config.output.rglob("*.safetensors") if file != path}
    if (name, share) == ("recipe.yaml", 0.5):
        path.write_text("complete: true\nrecipe: [")
    with pytest.raises(DexFlexError, match=path.name):
        generate.generate(config, [])
    assert {file: file.read_bytes() for file in others} == others


def test_two_processes_do_not_work_in_one_corpus(config):
    with locked(config.output), pytest.raises(DexFlexError, match="is in use by process"):
        generate.generate(config, [])
    assert not config.output.exists()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"hand": "claw"}, "no hand 'claw'.*'leap', 'sharpa'"),
        ({"workers": -1}, "must not be negative"),
        ({"objects_per_job": 0}, "must be positive"),
        ({"jobs": Jobs(2000, 0, 0)}, "`train` may have at most 10000 objects"),
        ({"jobs": Jobs(0, 126, 0)}, "`tune` may have at most 1000 objects"),
    ],
)
def test_a_wrong_setting_is_refused_by_name(values, message):
    with pytest.raises(DexFlexError, match=message):
        CorpusConfig(**values)


@pytest.mark.parametrize("values", [{"operated": 0.9}, {"operated": 1.5, "acquired": -0.5}])
def test_shares_must_sum_to_one_and_not_be_negative(values):
    with pytest.raises(DexFlexError, match="not be negative and must sum to 1"):
        Shares(**values)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_configurations_of_the_repository_parse(path):
    assert draccus.parse(CorpusConfig, config_path=path, args=[]).jobs.train > 0


def test_the_command_line_reads_a_file_and_overrides(config, tmp_path, capsys):
    recipe = tmp_path / "recipe.json"
    recipe.write_text(json.dumps({"output": str(config.output), "workers": 0, "jobs": {"train": 9}}))
    words = ["--config", str(recipe), "--jobs.train=1", "--jobs.tune=0", "--jobs.test=0"]
    assert main(words) == 0
    assert "train: 4 steps in 1 shards" in capsys.readouterr().out
    assert main([*words, "--seed=1"]) == 1
    assert "error: " in capsys.readouterr().err


def small(output, seed=0, objects=1, hand="leap"):
    """A corpus of few objects; its first episode of a kind exceeds that kind's share."""
    return CorpusConfig(output, seed, 0, Jobs(1, 0, 0), objects, steps_per_object=20 // objects, hand=hand)


def only_shard(config):
    return read_shard(shard_path(config.output / "train", 0))


def test_a_job_makes_episodes_of_all_kinds_and_counts_what_they_hold(hand, tmp_path):
    config = small(tmp_path / "corpus", objects=2, hand=hand.name)
    assert generate.generate(config, [])
    shard = only_shard(config)
    rows, totals = shard.tensors, shard.totals
    assert shard.hand == hand
    assert yaml.safe_load((config.output / "recipe.yaml").read_text())["recipe"]["hand"] == hand.name
    assert [KINDS[episode["kind"]] for episode in shard.episodes] == list(KINDS)
    np.testing.assert_array_equal(rows["kind"], [shard.episodes[k]["kind"] for k in rows["episode"]])
    for kind, name in enumerate(
        ("steps_operator", "steps_acquisition_and_release", "steps_strokes_on_a_hinge")
    ):
        assert totals[name] == (rows["kind"] == kind).sum() > 0
    patterns = [value for key, value in totals.items() if key.startswith("pattern_")]
    assert sum(patterns) == totals["steps"] == len(rows["step"])
    assert totals["turned_rad"] > 0.5 * totals["strokes_rad"] > 0
    assert totals["goals_attempted"] >= totals["goals_solved"] > 0
    assert {episode["seed"] for episode in shard.episodes} <= {0, 1}


def test_the_same_seed_makes_the_same_shard_and_another_seed_another(tmp_path):
    configs = [small(tmp_path / name, seed) for name, seed in (("once", 0), ("again", 0), ("other", 1))]
    for config in configs:
        generate.generate(config, [])
    first, second, third = (only_shard(config) for config in configs)
    assert first.episodes == second.episodes
    for key, value in first.tensors.items():
        np.testing.assert_array_equal(value, second.tensors[key], key)
    assert first.episodes[0]["world"] != third.episodes[0]["world"]
