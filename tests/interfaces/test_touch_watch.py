import pytest
import torch

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.touch_watch import FROZEN_STEPS, TOUCH_HEALTH, TouchWatch

TACTILE = "observation.tactile"


def touch(rows=1, seed=0):
    """Taxels that all carry a little, different in every seed."""
    return {TACTILE: 0.1 + 0.1 * torch.rand(rows, 240, generator=torch.Generator().manual_seed(seed))}


def with_finger(observation, finger, value):
    taxels = observation[TACTILE].clone().view(-1, 4, 60)
    taxels[0, finger] = value
    return {TACTILE: taxels.flatten(1)}


def names(reading, row=0):
    return [TOUCH_HEALTH[k] for k in reading.health[row].tolist()]


def test_live_touch_passes_unchanged():
    watch = TouchWatch(LEAP)
    for k in range(2 * FROZEN_STEPS):
        seen = touch(2, seed=k)
        reading = watch.look(seen, 2)
        assert torch.equal(reading.tactile, seen[TACTILE])
        assert not reading.missing.any()


def test_a_finger_in_the_air_reports_zero_for_ever_and_is_well():
    watch = TouchWatch(LEAP)
    for k in range(3 * FROZEN_STEPS):
        assert names(watch.look(with_finger(touch(seed=k), 2, 0.0), 1)) == ["ok"] * 4


def test_without_the_key_all_fingers_are_missing_and_keep_their_last_good_taxels():
    watch, seen = TouchWatch(LEAP), touch()
    watch.look(seen, 1)
    blind = watch.look({"observation.state": torch.zeros(1, 16)}, 1)
    assert names(blind) == ["missing"] * 4
    assert torch.equal(blind.tactile, seen[TACTILE])


def test_touch_that_was_never_there_is_missing_and_finite():
    reading = TouchWatch(LEAP).look({"observation.state": torch.zeros(2, 16)}, 2)
    assert reading.missing.all()
    assert torch.equal(reading.tactile, torch.zeros(2, 240))


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_one_broken_taxel_makes_its_finger_missing_and_no_other(value):
    watch, seen, broken = TouchWatch(LEAP), touch(), touch(seed=1)
    watch.look(seen, 1)
    broken[TACTILE][0, 3 * 60 + 7] = value
    reading = watch.look(broken, 1)
    assert names(reading) == ["ok", "ok", "ok", "missing"]
    assert torch.equal(reading.tactile[:, :180], broken[TACTILE][:, :180])
    assert torch.equal(reading.tactile[:, 180:], seen[TACTILE][:, 180:])


def test_a_finger_is_frozen_from_its_fifth_identical_frame_and_well_again_with_the_first_other_one():
    watch = TouchWatch(LEAP)
    healths = [names(watch.look(with_finger(touch(seed=k), 1, 0.3), 1))[1] for k in range(FROZEN_STEPS + 1)]
    assert healths == ["ok"] * (FROZEN_STEPS - 1) + ["frozen"] * 2
    assert names(watch.look(touch(seed=99), 1)) == ["ok"] * 4


def test_a_finger_with_a_quarter_of_its_taxels_at_full_scale_is_saturated():
    watch, seen = TouchWatch(LEAP), touch()
    seen[TACTILE][0, :14] = 1.0
    assert names(watch.look(seen, 1)) == ["ok"] * 4
    seen[TACTILE][0, :15] = 1.0
    assert names(watch.look(seen, 1)) == ["saturated", "ok", "ok", "ok"]


def test_a_saturated_finger_keeps_its_last_good_taxels_for_those_who_look_back():
    watch, seen = TouchWatch(LEAP), touch()
    watch.look(seen, 1)
    reading = watch.look(with_finger(touch(seed=1), 0, 1.0), 1)
    assert torch.equal(reading.tactile[:, :60], seen[TACTILE][:, :60])


def test_a_reset_row_forgets_its_frozen_past_and_the_others_do_not():
    watch, still = TouchWatch(LEAP), touch(2)
    for _ in range(FROZEN_STEPS - 1):
        watch.look(still, 2)
    assert watch.look(still, 2).missing.all()
    watch.reset(torch.tensor([True, False]))
    assert watch.look(still, 2).missing.all(1).tolist() == [False, True]


def test_taxels_of_another_shape_are_refused():
    with pytest.raises(DexFlexError, match=r"must have shape \(2, 240\).*Got \(2, 100\).*Leave the key out"):
        TouchWatch(LEAP).look({TACTILE: torch.zeros(2, 100)}, 2)
