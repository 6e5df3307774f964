"""The random search repeats itself, continues, and finds an effect that is there."""

from dataclasses import fields

import numpy as np
import pandas as pd
import pytest

from lerobot_dexflex.controller.settings import ProjectionSettings
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach import search
from lerobot_dexflex.evaluation.reach.search import RANGES, TABLE, Search, draw_trial, fit, run_search
from lerobot_dexflex.runs.table import Table


def test_every_setting_is_searched_around_its_default():
    held_drafts = {"planned_gain"}  # The benchmark's are held: no effect.
    assert set(RANGES) == {field.name for field in fields(ProjectionSettings)} - held_drafts
    for name, (low, high) in RANGES.items():
        assert low <= getattr(ProjectionSettings(), name) <= high


def test_a_trial_is_always_the_same_and_never_an_episode_twice():
    seeds = list(range(1000, 1030))
    assert draw_trial(3, seeds) == draw_trial(3, seeds)
    assert draw_trial(3, seeds).settings != draw_trial(4, seeds).settings
    assert len(set(draw_trial(3, seeds).seeds)) == len(draw_trial(3, seeds).errors) == search.BATCH


def test_a_search_continues_where_it_was_and_keeps_that_of_other_chains_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(search, "BATCH", 1)
    job = Search(tmp_path / "search", tmp_path / "chains", n_chains=1)
    rows = run_search(job, 1, workers=0, quiet=True)
    (found,) = rows.to_dict("records")
    assert (found["seed"], found["condition"]) == (search.TRAINING_SEED, "trial-0")
    assert 0 <= found["progress"] <= 1
    drawn = draw_trial(0, [search.TRAINING_SEED])
    assert found["errors"] == drawn.errors[0].name
    assert found["speed"] == pytest.approx(drawn.settings.speed, rel=1e-3)
    run_job = Search.run_job
    monkeypatch.setattr(Search, "run_job", lambda *_: pytest.fail("It was finished."))
    assert run_search(job, 1, workers=0, quiet=True).equals(rows)
    monkeypatch.setattr(Search, "run_job", run_job)
    other = Search(tmp_path / "search", tmp_path / "chains", n_chains=2)
    assert len(run_search(other, 1, workers=0, quiet=True)) == 1
    assert Table(tmp_path / "search" / TABLE).load()["version"].nunique() == 2


def test_an_effect_is_found_and_its_size_is_right():
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(300):
        drawn = {key: float(rng.uniform(*ends)) for key, ends in RANGES.items()}
        low, high = RANGES["speed"]
        place = 2 * (drawn["speed"] - low) / (high - low) - 1
        for errors in ("clean", "clean", "delay_2", "delay_3"):
            rows.append({**drawn, "errors": errors, "progress": 0.5 - 0.1 * place + rng.normal(0, 0.1)})
    effects = {effect.name: effect for effect in fit(pd.DataFrame(rows))}
    assert effects["speed"].slope == pytest.approx(-0.1, abs=4 * effects["speed"].error)
    assert effects["speed"].error < 0.01
    assert effects["speed"].best == pytest.approx(RANGES["speed"][0], abs=5e-4)
    assert abs(effects["gain"].slope) < 4 * effects["gain"].error


def test_too_few_episodes_are_refused():
    with pytest.raises(DexFlexError, match="1 episodes cannot tell"):
        fit(pd.DataFrame([{"errors": "clean", "progress": 0.5}]))
