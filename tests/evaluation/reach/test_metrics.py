import numpy as np
import pytest
from degraded_fakes import chain, episode

from lerobot_dexflex.commands.loop import MAX_STEPS
from lerobot_dexflex.evaluation.reach.metrics import EVENT_LAGS, around_events, contact_retention, measure


def test_errors_are_relative_to_the_motion_plus_two_millimetres():
    found = measure(episode(label=0.004, draft=0.008, selected=0.001))
    assert found.intent == pytest.approx(0.003 / 0.006)
    assert found.intervention == pytest.approx(0.007 / 0.010)
    assert (found.duration, found.progress) == (1.0, 0.5)


def test_a_drop_completes_the_intent_error_with_ones():
    # A quarter of the time limit at error 0.2, then dropped: 0.25 * 0.2 + 0.75 * 1.
    found = measure(episode(MAX_STEPS // 4, label=0.008, selected=0.010, dropped=True))
    assert found.duration == 0.25
    assert found.intent == found.intent_loaded == pytest.approx(0.8)


def test_finishing_early_is_no_shorter_duration():
    assert measure(episode(40, label=0.008, selected=0.010)).intent == pytest.approx(0.2)


def test_loaded_and_free_fingers_have_intent_errors_of_their_own():
    found = episode(4, label=0.004, selected=0.001)  # Of the first finger.
    found.selected[:, 2, 1] = 0.001
    assert measure(found).intent_free is None
    found.loads[1:, 0] = 0.0
    numbers = measure(found)
    assert numbers.intent_free == pytest.approx(0.003 / 0.006)
    # Once both, then the third finger alone, which should stand still.
    first = np.hypot(0.003, 0.001) / 0.006
    assert numbers.intent_loaded == pytest.approx((first + 3 * 0.001 / 0.002) / 4)


def test_the_tight_budget_is_a_quarter_more_than_the_operators_own_steps():
    found = episode(100, progress=1.0)  # A hundredth per step.
    found.chain = chain(steps=50)
    assert measure(found).progress_budget == pytest.approx(0.63)  # 62.5 steps, begun ones count.
    found.chain = chain(steps=90)
    assert measure(found).progress_budget == 1.0  # It was over before.
    found = episode(MAX_STEPS, progress=1.0)
    found.chain = chain(steps=MAX_STEPS)
    assert measure(found).progress_budget == 1.0


def test_steps_of_a_goal_are_those_of_reached_ones():
    found = episode()
    assert measure(found).goal_steps == 10
    found.goal_steps = []
    assert measure(found).goal_steps is None


def test_errors_are_split_at_the_edges_of_events():
    found = episode(4, label=0.004, selected=0.004, event=(1, 2))
    found.selected[1:3, 0, 0] = 0.001
    numbers = measure(found)
    assert numbers.intent_event == pytest.approx(0.5)
    assert numbers.intent_calm == 0
    without = measure(episode(4))
    assert (without.intent_event, without.intent_calm, without.intervention_calm) == (None, None, None)


def test_retention_counts_loaded_fingers_that_still_carry_load_later():
    loads = np.full((6, 4), 1.0)
    loads[3:, 0] = 0.0  # One finger lets go at step 3.
    # Two steps later: steps 0 keep 4 of 4, steps 1, 2 keep 3 of 4, step 3 keeps 3 of 3.
    assert contact_retention(loads, dropped=False, horizon=2) == pytest.approx(
        (4 + 3 + 3 + 3) / (4 + 4 + 4 + 3)
    )


def test_a_drop_loses_all_fingers_and_an_episode_without_contact_has_no_retention():
    loads = np.full((3, 4), 1.0)
    assert contact_retention(loads, dropped=True, horizon=2) == pytest.approx(4 / 12)
    assert contact_retention(loads, dropped=False, horizon=2) == 1.0
    assert contact_retention(loads, dropped=True, horizon=8) == 0.0
    assert contact_retention(0 * loads, dropped=False, horizon=2) is None


def test_interventions_are_averaged_in_bins_from_the_first_step_of_each_removal():
    in_event = np.zeros(60, bool)
    in_event[[10, 11, 40, 41]] = True
    series = np.zeros(60)
    series[10], series[43] = 4.0, 12.0
    series[6:10] = 1.0
    curve = around_events(series, in_event)
    assert curve is not None
    # 8 steps are in the bin that begins with the removals, 8 in the one before it.
    assert curve[EVENT_LAGS == 0] == (4 + 12) / 8
    assert curve[EVENT_LAGS == -4] == 4 / 8
    assert curve[EVENT_LAGS == 4] == 0.0
    # 20 steps after the second removal the episode is over: only the first counts.
    series[30] = 4.0
    curve = around_events(series, in_event)
    assert curve is not None
    assert curve[EVENT_LAGS == 20] == 1.0
    assert around_events(series, np.zeros(60, bool)) is None


def test_a_removal_that_is_going_on_from_the_first_step_begins_there():
    curve = around_events(np.array([5.0, 1.0]), np.array([True, True]))
    assert curve is not None
    assert curve[EVENT_LAGS == 0] == 3.0
    assert np.isnan(curve[EVENT_LAGS != 0]).all()
