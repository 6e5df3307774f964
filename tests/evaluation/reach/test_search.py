"""The random search repeats itself, continues, and finds an effect that is there."""

import itertools
from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest

from lerobot_dexflex.commands import loop
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach import search
from lerobot_dexflex.evaluation.reach.search import (
    RANGES,
    TABLE,
    Search,
    draw_trial,
    fit,
    run_search,
)
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import INTERFACES, Method
from lerobot_dexflex.interfaces.grip import ServoSettings
from lerobot_dexflex.interfaces.press import PressInterface, PressSettings
from lerobot_dexflex.runs.table import Table


def test_every_setting_but_smoothing_is_searched_around_its_default():
    names = {*INTERFACES["press"].options, "gain"}
    assert set(RANGES) == names - {"smoothing"}
    servo = ServoSettings()
    defaults = asdict(PressSettings()) | {"servo": servo.gain, "back": servo.back, "limit": servo.limit}
    defaults["gain"] = 1.0
    for name, (low, high) in RANGES.items():
        assert low <= defaults[name] <= high


def test_a_trial_builds_press_as_its_name_would():
    trial = draw_trial(5, [1000])
    settings = trial.settings | {"blocked": bool(trial.settings["blocked"])}
    words = [f"{name}={value}" for name, value in settings.items() if name != "gain"]
    made, named = trial.make(LEAP), Method.parse(f"press:{'+'.join(words)}@{settings['gain']}").make(LEAP)
    assert isinstance(named, PressInterface)
    assert (made.settings, made._grip.servo, made.gain) == (named.settings, named._grip.servo, named.gain)


def test_switches_are_on_or_off_and_sources_take_turns():
    trials = [draw_trial(number, [1000]) for number in range(20)]
    assert {trial.settings["blocked"] for trial in trials} == {0.0, 1.0}
    assert [trial.source for trial in trials[:3]] == ["motion", "pressing", "motion"]


def test_a_trial_is_always_the_same_and_never_an_episode_twice():
    seeds = list(range(1000, 1030))
    assert draw_trial(3, seeds) == draw_trial(3, seeds)
    assert draw_trial(3, seeds).settings != draw_trial(4, seeds).settings
    assert len(set(draw_trial(3, seeds).seeds)) == len(draw_trial(3, seeds).errors) == search.BATCH


def test_a_search_continues_where_it_was_and_keeps_that_of_other_chains_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(search, "BATCH", 1)
    monkeypatch.setattr(loop, "GOAL_STEPS", 2)  # Eight goals in sixteen steps.
    job = Search(tmp_path / "search", tmp_path / "chains", n_chains=1)
    rows = run_search(job, 1, workers=0, quiet=True)
    (found,) = rows.to_dict("records")
    assert (found["seed"] >= search.TRAINING_SEED, found["condition"]) == (True, "trial-0")
    assert 0 <= found["progress"] <= 1
    drawn = draw_trial(0, [found["seed"]])
    assert found["errors"] == drawn.errors[0].name
    assert found["source"] == drawn.source
    assert found["force"] == pytest.approx(drawn.settings["force"], rel=1e-3)
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
        drawn["blocked"] = round(drawn["blocked"])
        low, high = RANGES["force"]
        place = 2 * (drawn["force"] - low) / (high - low) - 1
        for source, errors in itertools.product(("motion", "pressing"), ("clean", "delay_2")):
            progress = 0.5 - 0.1 * place + 0.05 * drawn["blocked"] + rng.normal(0, 0.1)
            rows.append({**drawn, "source": source, "errors": errors, "progress": progress})
    effects = {effect.name: effect for effect in fit(pd.DataFrame(rows))}
    assert effects["force"].slope == pytest.approx(-0.1, abs=4 * effects["force"].error)
    assert effects["force"].error < 0.01
    assert effects["force"].best == pytest.approx(RANGES["force"][0], abs=0.5)
    # Half the range of a switch is half of what it does.
    assert effects["blocked"].slope == pytest.approx(0.025, abs=4 * effects["blocked"].error)
    assert effects["blocked"].best == 1
    assert abs(effects["gain"].slope) < 4 * effects["gain"].error


def test_too_few_episodes_are_refused():
    with pytest.raises(DexFlexError, match="1 episodes cannot tell"):
        fit(pd.DataFrame([{"errors": "clean", "progress": 0.5}]))
