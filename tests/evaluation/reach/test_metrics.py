import numpy as np
import pytest
from degraded_fakes import episode

from lerobot_dexflex.evaluation.reach.metrics import EVENT_LAGS, around_events, contact_retention, measure
from lerobot_dexflex.evaluation.reach.record import Record, make_record


def test_errors_are_relative_to_the_command_plus_two_millimetres():
    found = measure(episode(label=0.004, draft=0.008, executed=0.001))
    assert found.intent == pytest.approx(0.003 / 0.006)
    assert found.intervention == pytest.approx(0.007 / 0.010)
    assert (found.duration, found.progress, found.goals) == (1.0, 0.5, 4)


def test_a_drop_completes_the_intent_error_with_ones():
    # 40 of 160 steps at error 0.2, then dropped: 0.25 * 0.2 + 0.75 * 1.
    found = measure(episode(40, label=0.008, executed=0.010, dropped=True))
    assert found.duration == 0.25
    assert found.intent_alive == pytest.approx(0.2)
    assert found.intent == pytest.approx(0.8)


def test_finishing_early_is_no_shorter_duration():
    assert measure(episode(40, label=0.008, executed=0.010)).intent == pytest.approx(0.2)


def test_errors_are_split_at_the_edges_of_removals():
    found = episode(4, label=0.004, executed=0.004, event=(1, 2))
    found.executed[1:3, 0, 0] = 0.001
    numbers = measure(found)
    assert numbers.intent_event == pytest.approx(0.5)
    assert numbers.intent_calm == 0
    assert measure(episode(4)).intent_event is None


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


def test_interventions_are_aligned_with_the_first_step_of_each_removal():
    in_event = np.zeros(60, bool)
    in_event[[10, 11, 40, 41]] = True
    series = np.zeros(60)
    series[10], series[40] = 1.0, 3.0
    curve = around_events(series, in_event)
    assert curve is not None
    assert curve[EVENT_LAGS == 0] == 2.0
    assert curve[EVENT_LAGS == 1] == 0.0
    # 24 steps after the second removal the episode is over: only the first counts.
    series[34] = 4.0
    curve = around_events(series, in_event)
    assert curve is not None
    assert curve[EVENT_LAGS == 24] == 4.0
    assert around_events(series, np.zeros(60, bool)) is None


def test_a_removal_that_is_going_on_from_the_first_step_begins_there():
    curve = around_events(np.array([5.0, 1.0]), np.array([True, True]))
    assert curve is not None
    assert curve[EVENT_LAGS == 0] == 5.0
    assert np.isnan(curve[EVENT_LAGS == -1]).all()


def record():
    found = episode(40, event=(20, 21))
    return make_record(
        found, method="raw", cell="clean", index=3, chain="abc", version="v", group=(0, 4), traced=True
    )


def test_a_record_survives_its_line_of_json():
    found = record()
    assert Record.parse(found.line()) == found
    assert found.trace is not None
    assert sum(found.trace["in_event"]) == 2


def test_a_torn_or_foreign_line_is_no_record():
    with pytest.raises(ValueError, match=r"Unterminated|delimiter|Expecting"):
        Record.parse(record().line()[:-20])
    with pytest.raises(ValueError, match="Not a record"):
        Record.parse('{"group": [0, 1]}')


def test_branches_are_shares_of_the_steps_that_chose():
    found = episode()
    found.explanations = [{"branch": "draft"}, {"branch": "pure"}, {"branch": "draft"}, {}]
    made = make_record(found, method="m", cell="c", index=0, chain="", version="", group=(0, 1), traced=False)
    assert made.branches == {"draft": 0.6667, "pure": 0.3333}
    assert made.trace is None
