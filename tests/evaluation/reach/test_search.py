"""The random search repeats itself, continues, and finds an effect that is there."""

from dataclasses import fields

import numpy as np
import pytest

from lerobot_dexflex.controller.settings import ProjectionSettings
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach import search
from lerobot_dexflex.evaluation.reach.search import RANGES, Search, Trial, fit, run_search
from lerobot_dexflex.evaluation.store import Store


def test_every_setting_is_searched_around_its_default():
    held_drafts = {"planned_gain"}  # The benchmark's are held: no effect.
    assert set(RANGES) == {field.name for field in fields(ProjectionSettings)} - held_drafts
    for name, (low, high) in RANGES.items():
        assert low <= getattr(ProjectionSettings(), name) <= high


def test_a_search_continues_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(search, "BATCH", 1)
    job = Search(tmp_path / "search", tmp_path / "chains", n_chains=1)
    (first,) = run_search(job, 1, workers=0, quiet=True)
    assert first.chains == [search.TRAINING_SEED]
    assert 0 <= first.progress[0] <= 1
    monkeypatch.setattr(search, "run_trial", lambda *_: pytest.fail("It was finished."))
    assert run_search(job, 1, workers=0, quiet=True) == [first]


def test_a_search_with_other_chains_is_not_mixed_in(tmp_path):
    Store(tmp_path, Search(tmp_path, tmp_path / "chains", n_chains=1).identity(), Trial.parse)
    other = Search(tmp_path, tmp_path / "chains", n_chains=2)
    with pytest.raises(DexFlexError, match="chains: 1 in the folder, 2 now"):
        Store(tmp_path, other.identity(), Trial.parse)


def test_an_effect_is_found_and_its_size_is_right():
    rng = np.random.default_rng(0)
    trials = []
    for number in range(300):
        drawn = {key: float(rng.uniform(*ends)) for key, ends in RANGES.items()}
        low, high = RANGES["speed"]
        place = 2 * (drawn["speed"] - low) / (high - low) - 1
        progress = 0.5 - 0.1 * place + rng.normal(0, 0.1, 4)
        corruptions = ["clean"] * 2 + ["delay_2"] * 2
        trials.append(Trial(number, drawn, [0] * 4, corruptions, progress.tolist(), [False] * 4))
    effects = {effect.name: effect for effect in fit(trials)}
    assert effects["speed"].slope == pytest.approx(-0.1, abs=4 * effects["speed"].error)
    assert effects["speed"].error < 0.01
    assert effects["speed"].best == pytest.approx(RANGES["speed"][0], abs=5e-4)
    assert abs(effects["gain"].slope) < 4 * effects["gain"].error


def test_too_few_episodes_are_refused():
    with pytest.raises(DexFlexError, match="1 episodes cannot tell"):
        fit([Trial(0, {}, [0], ["clean"], [0.5], [False])])
