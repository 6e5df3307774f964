import numpy as np

from lerobot_dexflex.evaluation.events import AROUND, around, contact_events


def steps(flags):
    return np.flatnonzero(flags).tolist()


def test_an_event_is_the_step_in_which_a_contact_begins_or_ends():
    contacts = np.zeros((12, 2), bool)
    contacts[4:9, 0] = True  # Touches in step 3, leaves in step 8.
    assert steps(contact_events(contacts)) == [3, 8]


def test_a_flicker_of_one_step_is_no_event():
    contacts = np.zeros((12, 1), bool)
    contacts[5] = True
    assert not contact_events(contacts).any()
    assert not contact_events(~contacts).any()


def test_what_begins_in_the_last_step_counts():
    contacts = np.zeros((6, 1), bool)
    contacts[5] = True
    assert steps(contact_events(contacts)) == [4]


def test_steps_around_an_event_reach_to_both_sides_and_not_beyond_the_episode():
    events = np.zeros(30, bool)
    events[[2, 20]] = True
    near = around(events)
    assert steps(near) == [*range(2 + AROUND + 1), *range(20 - AROUND, 20 + AROUND + 1)]
    assert not around(np.zeros(4, bool)).any()
