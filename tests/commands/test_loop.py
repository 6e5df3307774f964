"""The loop pairs methods, refills its slots, records what the corpus needs, and judges drops."""

import numpy as np
import pytest

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import build_chain
from lerobot_dexflex.interfaces.method import make_interface

STEPS = 30


@pytest.fixture(scope="module")
def chains():
    env = ReachEnv(cameras=())
    return [build_chain(env, seed, verify=False) for seed in (50_001, 50_004, 50_010)]


def test_the_batch_size_changes_nothing(chains):
    noise = CommandErrors.of(noise=0.001)
    wide = run_chains(chains, noise, make_interface("raw"), batch=3, max_steps=STEPS)
    narrow = run_chains(chains, noise, make_interface("raw"), batch=1, max_steps=STEPS)
    for first, second in zip(wide, narrow, strict=True):
        np.testing.assert_array_equal(first.goal_error, second.goal_error)
        assert first.chain == second.chain


def test_methods_meet_the_same_noise(chains):
    noise = CommandErrors.of(noise=0.001)
    raw, filtered = (
        run_chains(chains[:1], noise, make_interface(name), max_steps=2)[0] for name in ("raw", "filter")
    )
    np.testing.assert_allclose(raw.draft[0] - raw.label[0], filtered.draft[0] - filtered.label[0], atol=1e-12)


def test_opening_the_hand_is_a_drop(chains):
    (episode,) = run_chains(chains[:1], CommandErrors.of(bias=0.02), make_interface("raw"))
    assert episode.dropped
    assert episode.progress < 1


def test_a_teacher_executes_the_clean_command(chains):
    def every_second(rng):
        del rng
        while True:
            yield from (True, False)

    (episode,) = run_chains(
        chains[:1],
        CommandErrors.of(noise=0.002),
        make_interface("raw"),
        teacher=every_second,
        max_steps=STEPS,
    )
    np.testing.assert_allclose(episode.executed[::2], episode.label[::2], atol=1e-12)
    np.testing.assert_allclose(episode.executed[1::2], episode.draft[1::2], atol=1e-12)


def test_recorded_rows_continue_each_other(chains):
    (episode,) = run_chains(
        chains[:1], CommandErrors.of(noise=0.001), make_interface("raw"), record=True, max_steps=STEPS
    )
    rows = episode.rows
    np.testing.assert_allclose(rows["command"][1:], (rows["command"] + episode.executed)[:-1], atol=1e-12)
    assert rows["tactile"].shape == (episode.steps, 240)
    assert list(rows["snapshot_step"]) == list(range(0, episode.steps, 8))
    assert rows["snapshot_physics"].shape[0] == len(rows["snapshot_step"])


def test_events_are_told_with_the_finger_that_left(chains):
    removal = CommandErrors.of(removal=0.002)
    first, second = run_chains(chains[:2], [removal, CommandErrors()], make_interface("raw"), max_steps=STEPS)
    assert (second.events, second.in_event.any()) == ([], False)
    steps = [k for event in first.events for k in range(event.onset, event.end)]
    assert steps == np.flatnonzero(first.in_event).tolist()
    event = first.events[0]
    assert event.finger == first.loads[event.onset].argmax()
    changed = np.abs(first.draft - first.label).max(2) > 0
    assert changed[event.onset : event.end, event.finger].all()
    assert changed.sum() == len(steps)
