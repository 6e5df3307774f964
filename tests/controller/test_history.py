import pytest
import torch

from lerobot_dexflex.controller import HistoryBuffer
from lerobot_dexflex.controller.history import past_rows
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP, SHARPA


def observation(*values, hand=LEAP):
    """Rows whose every entry is a number; an arm of seven joints comes first."""
    column, fingers = torch.tensor(values, dtype=torch.float32)[:, None], hand.n_fingers
    keys = {"state": 7 + hand.n_joints, "tactile": fingers * 60, "fingertips": fingers * 3, "gravity": 3}
    return {f"observation.{key}": column.expand(-1, width) for key, width in keys.items()}


def test_first_observation_fills_the_past(hand):
    history = HistoryBuffer(hand).observe(observation(5.0, hand=hand))
    assert history.joints.shape == (1, 4, hand.n_joints)
    assert history.tactile.shape == (1, 4, hand.n_fingers, 10, 6)
    assert history.slow_fingertips.shape == (1, 8, hand.n_fingers, 3)
    assert all((part == 5).all() for part in (history.joints, history.fingertips, history.tactile))
    assert (history.slow_loads == 5 * 60).all()
    assert not history.tactile_missing.any()


def test_frames_and_window_look_back_the_right_number_of_steps():
    buffer = HistoryBuffer(LEAP)
    history = [buffer.observe(observation(float(step))) for step in range(40)][-1]
    assert history.joints[0, :, 0].tolist() == [39, 38, 36, 32]
    assert history.slow_fingertips[0, :, 0, 0].tolist() == list(range(39, 8, -4))


def test_reset_row_forgets_alone():
    buffer = HistoryBuffer(LEAP)
    for step in range(10):
        buffer.observe(observation(float(step), 100.0 + step))
        buffer.remember(torch.full((2, 8, 4, 3), float(step)))
    buffer.reset(torch.tensor([False, True]))
    history = buffer.observe(observation(10.0, 7.0))
    assert history.joints[0, :, 0].tolist() == [10, 9, 7, 3]
    assert history.joints[1, :, 0].tolist() == [7, 7, 7, 7]
    assert buffer.drafts[0, :, 0, 0].tolist() == [2, 3, 4, 5, 6, 7, 8, 9]
    assert not buffer.drafts[1].any()


def test_buffer_agrees_with_rows_gathered_from_a_recording():
    buffer, rows = HistoryBuffer(LEAP), []
    for step in range(12):
        rows.append(buffer.observe(observation(float(step))).joints[0, :, 0])
    steps = torch.arange(12)
    assert torch.equal(torch.stack(rows), past_rows(100 + steps, steps, (0, 1, 3, 7)).float() - 100)


def test_missing_touch_is_marked_and_never_zero_loads():
    buffer = HistoryBuffer(LEAP)
    broken = observation(1.0)
    broken["observation.tactile"] = broken["observation.tactile"].clone()
    broken["observation.tactile"][0, 60] = torch.nan
    assert buffer.observe(broken).tactile_missing[0].tolist() == [False, True, False, False]
    del broken["observation.tactile"]
    history = HistoryBuffer(LEAP).observe(broken)
    assert history.tactile_missing.all()
    assert torch.isfinite(history.tactile).all()


def test_an_observation_of_another_hand_is_refused(hand):
    """An arm's joints come before the hand's, so that more joints are none of its business."""
    other = SHARPA if hand == LEAP else LEAP
    message = (
        rf"'observation.fingertips' of the hand '{hand.name}' must have shape \(batch, {hand.n_fingers * 3}\)"
    )
    with pytest.raises(DexFlexError, match=message):
        HistoryBuffer(hand).observe(observation(1.0, hand=other))


def test_buffer_works_across_inference_mode():
    buffer = HistoryBuffer(LEAP)
    with torch.inference_mode():
        buffer.observe(observation(1.0, 2.0))
    buffer.reset(torch.tensor([True, False]))
    assert buffer.observe(observation(3.0, 4.0)).joints[:, 1, 0].tolist() == [3, 2]


@pytest.mark.parametrize("key", ["observation.state", "observation.fingertips", "observation.gravity"])
def test_missing_or_broken_observations_are_refused(key):
    whole = observation(1.0)
    with pytest.raises(DexFlexError, match=key):
        HistoryBuffer(LEAP).observe({k: v for k, v in whole.items() if k != key})
    with pytest.raises(DexFlexError, match=key):
        HistoryBuffer(LEAP).observe(whole | {key: torch.zeros(1, 2)})
    with pytest.raises(DexFlexError, match=key):
        HistoryBuffer(LEAP).observe(whole | {key: torch.full_like(whole[key], torch.nan)})


def test_changing_the_batch_without_a_reset_is_refused():
    buffer = HistoryBuffer(LEAP)
    buffer.observe(observation(1.0))
    with pytest.raises(DexFlexError, match="from 1 to 2"):
        buffer.observe(observation(1.0, 2.0))
    with pytest.raises(DexFlexError, match="mask"):
        buffer.reset(torch.tensor([True, False]))
    buffer.reset()
    buffer.observe(observation(1.0, 2.0))
