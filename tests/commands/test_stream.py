"""What each error does to a stream of drafts, row by row, and what of it is logged.

The hand goes its own way here: where a command leads is measured from where the fingertips are in that step.
"""

import numpy as np
import pytest
import torch

from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.stream import ErrorStream, seeds_of
from lerobot_dexflex.hands import LEAP, SHARPA

STEPS, HORIZON = 100, 8
GOALS = 1e-3 * np.arange(12, dtype=np.float64).reshape(4, 3) * np.arange(1, STEPS + 1)[:, None, None]
"""Where the fingertips should be after each step [m], (steps, 4, 3)."""
TIPS = np.random.default_rng(0).normal(scale=0.01, size=(STEPS, 4, 3)).cumsum(0)
"""Where they are measured in each step [m]."""
LOADS = torch.tensor([0.2, 3.0, 1.0, 2.0]).double()
INWARD = torch.tensor([1.0, 0.0, 0.0]).double().expand(4, -1)
OUTWARD = np.array([-1.0, 0.0, 0.0])
NAMES = [
    *("noise_2mm", "scale_1.5", "delay_2", "removal_3mm", "bias_1mm", "freeze_5", "dropout_5"),
    "delay_1+noise_1mm+removal_2mm",
]


def begun(names, seeds):
    stream = ErrorStream(LEAP, len(names))
    for row, (name, seed) in enumerate(zip(names, seeds, strict=True)):
        errors = CommandErrors.parse(name)
        stream.begin(row, errors, seeds_of(errors, seed))
    return stream


def spoilt(stream, k, loads=LOADS, goals=GOALS):
    """Return what is left of the draft that holds the k-th goal [m], (rows, 4, 3), from where tips are."""
    rows = len(stream)
    tips = torch.from_numpy(TIPS[k]).expand(rows, -1, -1)
    wanted = stream.delayed(torch.from_numpy(goals[k]).expand(rows, -1, -1))
    motion = (wanted - tips)[:, None]
    return stream.step(motion, tips, loads.expand(rows, -1), INWARD.expand(rows, -1, -1))[:, 0].numpy()


def run(name, seed=0, loads=LOADS):
    """Return where the spoilt commands lead [m], (100, 4, 3), and the stream."""
    stream = begun([name], [seed])
    return np.stack([TIPS[k] + spoilt(stream, k, loads)[0] for k in range(STEPS)]), stream


def near(found, expected):
    np.testing.assert_allclose(found, expected, atol=1e-12, rtol=0)


def struck(found):
    """Return steps and fingers in which a command leads elsewhere, (steps, 4)."""
    return np.abs(found - GOALS).max(2) > 1e-9


def stretches(flags):
    """Return first steps and ends of the stretches of true flags."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def test_clean_commands_pass():
    near(run("clean")[0], GOALS)


@pytest.mark.parametrize("name", NAMES)
def test_a_row_is_the_same_alone_and_beside_others(name):
    stream = begun([*NAMES, name], [*range(5, 5 + len(NAMES)), 0])
    beside = np.stack([TIPS[k] + spoilt(stream, k)[-1] for k in range(STEPS)])
    np.testing.assert_array_equal(beside, run(name)[0])


def test_noise_of_positions_is_uniform_and_new_at_every_step_and_does_not_add_up():
    noise = run("noise_2mm")[0] - GOALS
    assert np.abs(noise).max() <= 0.002 + 1e-12
    assert noise.std() == pytest.approx(0.004 / np.sqrt(12), rel=0.05)
    assert abs(np.corrcoef(noise[1:].ravel(), noise[:-1].ravel())[0, 1]) < 0.1


def test_bias_is_the_same_at_every_step():
    bias = run("bias_1mm")[0] - GOALS
    near(bias, np.broadcast_to(bias[0], bias.shape))
    assert 0 < np.abs(bias).max() <= 0.001 + 1e-12


def test_scaling_multiplies_the_motion_from_where_the_fingertips_are():
    near(run("scale_1.5")[0] - TIPS, 1.5 * (GOALS - TIPS))


def test_delay_leads_to_old_places_wherever_the_hand_is_by_now():
    delayed, _ = run("delay_2")
    near(delayed[:3], np.broadcast_to(GOALS[0], (3, 4, 3)))
    near(delayed[2:], GOALS[:-2])


def test_removal_takes_the_most_loaded_finger_off_from_where_it_is_felt_for_eight_steps_about_every_25():
    removed, stream = run("removal_2mm")
    changed = struck(removed)
    assert not changed[:, [0, 2, 3]].any()
    starts, ends = stretches(changed[:, 1])
    assert 3 <= len(starts) <= 6
    assert set((ends - starts)[:-1]) == {8}
    assert 7 <= starts[0] <= 19
    for start, end in zip(starts, ends, strict=True):
        away = 0.002 * np.arange(1, end - start + 1)[:, None] * OUTWARD
        near(removed[start:end, 1], TIPS[start, 1] + away)
    assert stream.events == [
        ErrorEvent(0, "removal", int(a), int(b), 1) for a, b in zip(starts, ends, strict=True)
    ]


def test_the_later_steps_of_a_removal_go_on_outward():
    stream = begun(["removal_2mm"], [0])
    first = run("removal_2mm")[1].events[0].onset
    for k in range(first):
        spoilt(stream, k)
    tips = torch.from_numpy(TIPS[first])[None]
    draft = torch.zeros(1, HORIZON, 4, 3, dtype=torch.float64)
    found = stream.step(draft, tips, LOADS[None], INWARD[None])[0].numpy()
    near(found[:, 1], 0.002 * np.arange(1, HORIZON + 1)[:, None] * OUTWARD)
    near(found[:, [0, 2, 3]], np.zeros((HORIZON, 3, 3)))


def test_a_hand_that_holds_nothing_has_no_removals():
    found, stream = run("removal_3mm", loads=torch.zeros(4, dtype=torch.float64))
    near(found, GOALS)
    assert stream.events == []


@pytest.mark.parametrize("steps", [3, 20])
def test_a_frozen_command_stays_where_it_was_and_then_rests_as_long_as_after_a_removal(steps):
    frozen, stream = run(f"freeze_{steps}")
    still = struck(frozen).all(1)
    near(frozen[~still], GOALS[~still])
    starts, ends = stretches(still)
    for start, end in zip(starts, ends, strict=True):
        near(frozen[start:end], np.broadcast_to(GOALS[start - 1], (end - start, 4, 3)))
    assert [(e.onset, e.end, e.finger) for e in stream.events] == [
        (a, b, None) for a, b in zip(starts, ends, strict=True)
    ]
    assert set((ends - starts)[:-1]) == {steps}
    rests = starts[1:] - ends[:-1]
    assert len(rests) >= 2
    assert rests.min() >= 9
    assert rests.max() <= 24


def test_a_dropout_stops_one_finger_drawn_at_random():
    seen = set()
    for seed in range(8):
        lost, stream = run("dropout_5", seed)
        stopped = struck(lost)
        assert stopped.sum(1).max() == 1
        for event in stream.events:
            assert stopped[event.onset : event.end, event.finger].all()
            kept = GOALS[event.onset - 1, event.finger]
            near(lost[event.onset : event.end, event.finger], np.tile(kept, (event.end - event.onset, 1)))
            seen.add(event.finger)
        assert stopped.sum() == sum(event.end - event.onset for event in stream.events)
    assert seen == {0, 1, 2, 3}


def test_what_stands_still_is_the_command_with_its_errors():
    """A frozen glove repeats its last noisy and scaled wish, and later steps of the draft stand with it."""
    both, frozen = run("noise_2mm+scale_1.5+freeze_5")[0], run("freeze_5")[0]
    loose, _ = run("noise_2mm+scale_1.5")
    starts, ends = stretches(struck(frozen).all(1))
    assert len(starts) >= 2
    for start, end in zip(starts, ends, strict=True):
        near(both[start:end], np.broadcast_to(loose[start - 1], (end - start, 4, 3)))
    still = struck(frozen).all(1)
    near(both[~still], loose[~still])


def test_rows_know_their_own_events():
    stream = begun(["removal_3mm", "clean", "freeze_4"], [0, 0, 1])
    seen = []
    for k in range(STEPS):
        spoilt(stream, k)
        seen.append(stream.in_event)
    counts = np.zeros(3, int)
    for event in stream.events:
        counts[event.row] += event.end - event.onset
    np.testing.assert_array_equal(np.sum(seen, 0), counts)
    assert counts[1] == 0
    assert {event.row: event.family for event in stream.events} == {0: "removal", 2: "freeze"}


def test_a_row_begins_anew_and_the_others_go_on():
    stream = begun(["delay_2", "delay_2"], [0, 0])
    for k in range(10):
        spoilt(stream, k)
    stream.restart(torch.tensor([True, False]))
    first, second = TIPS[10] + spoilt(stream, 10)
    near(first, GOALS[10])
    near(second, GOALS[8])


@pytest.mark.parametrize("name", ["removal_2mm", "freeze_5", "dropout_5"])
def test_a_restarted_episode_knows_nothing_of_the_one_before(name):
    """No finger is left where an event of another episode left it."""
    stream = begun([name], [0])
    while not stream.in_event[0]:
        spoilt(stream, 0)
    stream.restart()
    found = np.stack([TIPS[k] + spoilt(stream, k)[0] for k in range(50, 90)])
    assert not struck_at(found, 50)[:7].any()
    for event in stream.events:
        onset = 50 + event.onset
        expected = TIPS[onset, 1] + 0.002 * OUTWARD if name == "removal_2mm" else GOALS[onset - 1]
        finger = slice(None) if event.finger is None else event.finger
        near(found[event.onset, finger], expected if name == "removal_2mm" else expected[finger])
    assert stream.events


def struck_at(found, first):
    return np.abs(found - GOALS[first : first + len(found)]).max(2) > 1e-9


def test_joined_errors_draw_as_they_do_alone():
    noise = run("noise_2mm")[0] - GOALS
    near(run("noise_2mm+scale_1.5")[0] - TIPS, 1.5 * (GOALS - TIPS) + noise)
    near(run("delay_2+noise_2mm")[0][2:], GOALS[:-2] + noise[2:])


def test_a_step_that_is_planned_twice_has_the_same_error_in_both_plans():
    stream = begun(["noise_2mm"], [3])
    plan = torch.zeros(1, HORIZON, 4, 3, dtype=torch.float64)
    tips = torch.zeros(1, 4, 3, dtype=torch.float64)
    first, second = (stream.step(plan, tips, LOADS[None], INWARD[None])[0] for _ in range(2))
    torch.testing.assert_close(first[1:], second[:-1], atol=0, rtol=0)
    assert not torch.equal(first[0], first[1])


def test_a_command_that_knows_no_future_has_one_error_in_all_its_steps():
    stream = begun(["noise_2mm"], [3])
    held = torch.full((1, HORIZON, 4, 3), 0.001, dtype=torch.float64)
    errors = []
    for _ in range(2):
        moved = stream.step(held, held[:, 0], LOADS[None], INWARD[None], held=True) - held
        torch.testing.assert_close(moved, moved[:, :1].expand_as(moved))
        errors.append(moved[0, 0])
        assert 0 < moved.abs().max() <= 0.002
    assert not torch.equal(*errors)


def test_any_finger_of_any_hand_may_drop_out_or_be_removed():
    fingers = SHARPA.n_fingers
    goals, inward = torch.zeros(1, 1, fingers, 3).double(), torch.ones(1, fingers, 3).double()
    dropped = set()
    for seed in range(12):
        stream = ErrorStream(SHARPA, 1)
        errors = CommandErrors.parse("dropout_5")
        stream.begin(0, errors, seeds_of(errors, seed))
        for _ in range(STEPS):
            stream.step(goals, goals[:, 0], torch.ones(1, fingers), inward)
        dropped |= {event.finger for event in stream.events}
    assert dropped == set(range(fingers))
    for most in range(fingers):
        stream = ErrorStream(SHARPA, 1)
        errors = CommandErrors.parse("removal_2mm")
        stream.begin(0, errors, seeds_of(errors, most))
        loads = torch.ones(1, fingers).double()
        loads[0, most] = 2.0
        found = [stream.step(goals, goals[:, 0], loads, inward)[0, 0] for _ in range(STEPS)]
        gone = torch.stack(found).abs().amax((0, 2)) > 1e-9
        assert gone.nonzero().flatten().tolist() == [most]
