import pytest
import torch

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.draft_watch import (
    DRAFT_HEALTH,
    FARTHEST,
    FASTEST,
    DraftWatch,
    checked_draft,
)

TIPS = torch.full((1, 4, 3), 0.05, dtype=torch.float64)


def ramp(rows=1):
    """A draft that goes on by 1 mm along every axis in each of its steps."""
    steps = 1e-3 * torch.arange(1, DRAFT_HORIZON + 1, dtype=torch.float64)
    return steps.view(1, -1, 1, 1).expand(rows, -1, 4, 3)


def millimetres(draft):
    return (1e3 * draft[0, :, 0, 0]).round(decimals=6).tolist()


def test_a_draft_in_time_passes_unchanged():
    reading = DraftWatch().look(ramp(), TIPS)
    assert torch.equal(reading.draft, ramp())
    assert DRAFT_HEALTH[int(reading.health)] == "ok"


def test_late_drafts_go_on_with_the_rest_of_the_last_wherever_the_hand_is_and_hold_its_end():
    watch = DraftWatch()
    watch.look(ramp(), TIPS)
    first = watch.look(None, TIPS)  # The hand has not moved,
    assert DRAFT_HEALTH[int(first.health)] == "late"
    assert millimetres(first.draft) == [2, 3, 4, 5, 6, 7, 8, 8]
    second = watch.look(None, TIPS + 0.002)  # and then it has.
    assert millimetres(second.draft) == [1, 2, 3, 4, 5, 6, 6, 6]
    later = [watch.look(None, TIPS + 0.007) for _ in range(DRAFT_HORIZON)]
    assert millimetres(later[-1].draft) == [1] * 8


def test_a_late_first_draft_holds_where_the_hand_was_then():
    watch = DraftWatch()
    assert not watch.look(None, TIPS).draft.any()
    assert millimetres(watch.look(None, TIPS - 0.001).draft) == [1] * 8


def test_wild_drafts_are_clipped_per_axis_and_reported_for_their_row():
    draft = ramp(rows=2).clone()
    draft[1, 0, 2] = torch.tensor([0.5, -0.070, 0.059], dtype=torch.float64)
    draft[1, 7, 2] = torch.tensor([0.5, -0.070, 0.059], dtype=torch.float64)
    reading = DraftWatch().look(draft, TIPS.expand(2, -1, -1))
    assert reading.draft[1, 0, 2].tolist() == [FARTHEST, -FARTHEST, 0.059]
    assert reading.draft[1, 7, 2].tolist() == [8 * FASTEST, -0.070, 0.059]
    assert [DRAFT_HEALTH[k] for k in reading.health.tolist()] == ["ok", "clipped"]
    assert torch.equal(reading.draft[0], draft[0])


def test_a_reset_row_forgets_its_drafts_and_the_others_do_not():
    watch, tips = DraftWatch(), TIPS.expand(2, -1, -1)
    watch.look(ramp(rows=2), tips)
    watch.reset(torch.tensor([True, False]))
    reading = watch.look(None, tips)
    assert not reading.draft[0].any()
    assert millimetres(reading.draft[1:])[0] == 2


def test_late_drafts_of_a_hand_that_was_moved_far_are_bounded():
    watch = DraftWatch()
    watch.look(ramp(), TIPS)
    assert watch.look(None, TIPS + 0.5).draft.abs()[0, 0].max() == FARTHEST


@pytest.mark.parametrize("horizon", [1, 9])
def test_another_horizon_is_refused_with_the_remedy(horizon):
    with pytest.raises(
        DexFlexError, match=f"8 control steps ahead; the draft has {horizon}. Cut it, or repeat"
    ):
        checked_draft(LEAP, torch.zeros(1, horizon, 4, 3), 1)


def test_nan_is_refused_and_a_late_draft_is_not():
    with pytest.raises(DexFlexError, match=r"NaN or infinity in rows \[0\]"):
        checked_draft(LEAP, torch.full((1, 8, 4, 3), torch.nan), 1)
    assert checked_draft(LEAP, None, 1) is None
