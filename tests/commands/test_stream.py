"""What each error does to a stream of displacements, row by row, and what of it is logged."""

import numpy as np
import pytest
import torch

from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.stream import ErrorStream, seeds_of

CLEAN = 1e-3 * np.arange(12, dtype=np.float64).reshape(4, 3)
CLEAN_RUN = np.stack([CLEAN * (k + 1) for k in range(100)])
LOADS = torch.tensor([0.2, 3.0, 1.0, 2.0]).double()
INWARD = torch.tensor([1.0, 0.0, 0.0]).double().expand(4, -1)
NAMES = [
    "noise_2mm",
    "jitter_2mm",
    "scale_1.5",
    "delay_2",
    "removal_3mm",
    "bias_1mm",
    "freeze_5",
    "dropout_5",
]


def begun(names, seeds):
    stream = ErrorStream(len(names))
    for row, (name, seed) in enumerate(zip(names, seeds, strict=True)):
        errors = CommandErrors.parse(name)
        stream.begin(row, errors, seeds_of(errors, seed))
    return stream


def spoilt(stream, clean, loads=LOADS):
    rows = len(stream)
    motion = stream.delayed(torch.from_numpy(clean).expand(rows, -1, -1))[:, None]
    return stream.step(motion, loads.expand(rows, -1), INWARD.expand(rows, -1, -1))[:, 0].numpy()


def run(name, seed=0):
    """Return the spoilt displacements of `CLEAN_RUN`, (100, 4, 3), and the stream."""
    stream = begun([name], [seed])
    return np.stack([spoilt(stream, clean)[0] for clean in CLEAN_RUN]), stream


def stretches(flags):
    """Return first steps and ends of the stretches of true flags."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def test_clean_commands_pass():
    np.testing.assert_array_equal(run("clean")[0], CLEAN_RUN)


@pytest.mark.parametrize("name", NAMES)
def test_a_row_is_the_same_alone_and_beside_others(name):
    stream = begun([*NAMES, name], [*range(5, 5 + len(NAMES)), 0])
    beside = np.stack([spoilt(stream, clean)[-1] for clean in CLEAN_RUN])
    np.testing.assert_array_equal(beside, run(name)[0])


def test_noise_is_uniform_and_new_at_every_step():
    noise = run("noise_2mm")[0] - CLEAN_RUN
    assert np.abs(noise).max() <= 0.002
    assert noise.std() == pytest.approx(0.004 / np.sqrt(12), rel=0.05)
    assert abs(np.corrcoef(noise[1:].ravel(), noise[:-1].ravel())[0, 1]) < 0.1


def test_noise_adds_up_to_wrong_positions_and_jitter_does_not():
    wandering, shaking = (np.cumsum(run(f"{name}_2mm")[0] - CLEAN_RUN, 0) for name in ("noise", "jitter"))
    assert np.abs(shaking).max() <= 0.002 + 1e-12
    assert shaking.std() == pytest.approx(0.004 / np.sqrt(12), rel=0.05)
    assert np.abs(wandering).max() > 0.005


def test_bias_is_the_same_at_every_step():
    bias = run("bias_1mm")[0] - CLEAN_RUN
    np.testing.assert_allclose(bias, np.broadcast_to(bias[0], bias.shape), atol=1e-12)
    assert 0 < np.abs(bias).max() <= 0.001


def test_scaling_multiplies():
    np.testing.assert_allclose(run("scale_1.5")[0], 1.5 * CLEAN_RUN)


def test_delay_repeats_the_first_command_and_then_lags_two_steps():
    delayed, _ = run("delay_2")
    np.testing.assert_array_equal(delayed[:3], np.broadcast_to(CLEAN_RUN[0], (3, 4, 3)))
    np.testing.assert_array_equal(delayed[2:], CLEAN_RUN[:-2])


def test_removal_pulls_the_most_loaded_finger_off_for_eight_steps_about_every_25():
    removed, stream = run("removal_3mm")
    changed = np.abs(removed - CLEAN_RUN).max(2) > 0
    assert not changed[:, [0, 2, 3]].any()
    np.testing.assert_allclose(removed[changed[:, 1], 1], np.tile([-0.003, 0, 0], (changed[:, 1].sum(), 1)))
    starts, ends = stretches(changed[:, 1])
    assert 3 <= len(starts) <= 6
    assert set((ends - starts)[:-1]) == {8}
    assert 7 <= starts[0] <= 19
    assert stream.events == [
        ErrorEvent(0, "removal", int(a), int(b), 1) for a, b in zip(starts, ends, strict=True)
    ]


def test_a_hand_that_holds_nothing_has_no_removals():
    stream = begun(["removal_3mm"], [0])
    for clean in CLEAN_RUN:
        np.testing.assert_array_equal(spoilt(stream, clean, torch.zeros(4))[0], clean)
    assert stream.events == []


@pytest.mark.parametrize("steps", [3, 20])
def test_a_frozen_command_stands_still_and_then_rests_as_long_as_after_a_removal(steps):
    frozen, stream = run(f"freeze_{steps}")
    still = (frozen == 0).all((1, 2))
    np.testing.assert_array_equal(frozen[~still], CLEAN_RUN[~still])
    starts, ends = stretches(still)
    assert [(e.onset, e.end, e.finger) for e in stream.events] == [
        (a, b, None) for a, b in zip(starts, ends, strict=True)
    ]
    assert set((ends - starts)[:-1]) == {steps}
    rests = starts[1:] - ends[:-1]
    assert len(rests) >= 2
    assert rests.min() >= 9
    assert rests.max() <= 24


def test_a_dropout_stops_one_finger_drawn_at_random():
    struck = set()
    for seed in range(8):
        lost, stream = run("dropout_5", seed)
        still = (lost == 0).all(2)
        assert still.sum(1).max() == 1
        np.testing.assert_array_equal(lost[~still], CLEAN_RUN[~still])
        for event in stream.events:
            assert still[event.onset : event.end, event.finger].all()
            struck.add(event.finger)
        assert still.sum() == sum(event.end - event.onset for event in stream.events)
    assert struck == {0, 1, 2, 3}


def test_rows_know_their_own_events():
    stream = begun(["removal_3mm", "clean", "freeze_4"], [0, 0, 1])
    seen = []
    for clean in CLEAN_RUN:
        spoilt(stream, clean)
        seen.append(stream.in_event)
    counts = np.zeros(3, int)
    for event in stream.events:
        counts[event.row] += event.end - event.onset
    np.testing.assert_array_equal(np.sum(seen, 0), counts)
    assert counts[1] == 0
    assert {event.row: event.family for event in stream.events} == {0: "removal", 2: "freeze"}


def test_a_row_begins_anew_and_the_others_go_on():
    stream = begun(["delay_2", "delay_2"], [0, 0])
    for clean in CLEAN_RUN[:10]:
        spoilt(stream, clean)
    stream.restart(torch.tensor([True, False]))
    first, second = spoilt(stream, CLEAN_RUN[10])
    np.testing.assert_array_equal(first, CLEAN_RUN[10])
    np.testing.assert_array_equal(second, CLEAN_RUN[8])


def test_joined_errors_act_together_and_draw_as_they_do_alone():
    joined = run("noise_2mm+scale_1.5+freeze_5")[0]
    noisy, frozen = run("noise_2mm")[0], run("freeze_5")[0]
    still = (frozen == 0).all((1, 2))
    assert still.any()
    assert (joined[still] == 0).all()
    np.testing.assert_allclose(joined[~still], (noisy + 0.5 * CLEAN_RUN)[~still], atol=1e-12)


@pytest.mark.parametrize("name", ["noise_2mm", "jitter_2mm"])
def test_a_step_that_is_planned_twice_has_the_same_error_in_both_plans(name):
    errors = CommandErrors.parse(name)
    stream = begun([name], [3])
    plan = torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    first, second = (stream.step(plan, LOADS[None], INWARD[None], absolute=True)[0] for _ in range(2))
    if errors.families == ("jitter",):  # Positions are off; the second plan starts one step later.
        first, second = first.cumsum(0), second.cumsum(0)
    torch.testing.assert_close(first[1:], second[:-1], atol=1e-15, rtol=0)
    assert not torch.equal(first[0], first[1])


def test_a_command_that_knows_no_future_has_one_error_in_all_its_steps():
    stream = begun(["jitter_2mm"], [3])
    held = torch.full((1, 8, 4, 3), 0.001, dtype=torch.float64)
    for _ in range(2):
        moved = stream.step(held, LOADS[None], INWARD[None], absolute=True, held=True) - held
        torch.testing.assert_close(moved, moved[:, :1].expand_as(moved))
        assert 0 < moved.abs().max() <= 0.002
