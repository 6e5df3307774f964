import pytest
import torch

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.draft_watch import DRAFT_HEALTH, DraftWatch, checked_draft

LIKE = torch.zeros(1, 16)


def ramp(first=1.0, rows=1):
    """A draft whose k-th displacement is (first + k) mm along every axis."""
    steps = 1e-3 * (first + torch.arange(DRAFT_HORIZON, dtype=torch.float64))
    return steps.view(1, -1, 1, 1).expand(rows, -1, 4, 3)


def millimetres(draft):
    return (1e3 * draft[0, :, 0, 0]).round(decimals=6).tolist()


def test_a_draft_in_time_passes_unchanged():
    reading = DraftWatch().look(ramp(), LIKE)
    assert torch.equal(reading.draft, ramp())
    assert DRAFT_HEALTH[int(reading.health)] == "ok"


def test_late_drafts_go_on_with_the_rest_of_the_last_and_end_in_rest():
    watch = DraftWatch()
    watch.look(ramp(), LIKE)
    first = watch.look(None, LIKE)
    assert DRAFT_HEALTH[int(first.health)] == "late"
    assert millimetres(first.draft) == [2, 3, 4, 5, 6, 7, 8, 0]
    later = [watch.look(None, LIKE) for _ in range(DRAFT_HORIZON - 1)]
    assert millimetres(later[-2].draft) == [8, 0, 0, 0, 0, 0, 0, 0]
    assert not later[-1].draft.any()


def test_a_late_first_draft_holds():
    assert not DraftWatch().look(None, LIKE).draft.any()


def test_wild_displacements_are_clipped_per_axis_and_reported_for_their_row():
    draft = ramp(rows=2).clone()
    draft[1, 3, 2] = torch.tensor([0.5, -0.020, 0.001], dtype=torch.float64)
    reading = DraftWatch().look(draft, torch.zeros(2, 16))
    assert reading.draft[1, 3, 2].tolist() == [0.015, -0.015, 0.001]
    assert [DRAFT_HEALTH[k] for k in reading.health.tolist()] == ["ok", "clipped"]


def test_a_reset_row_forgets_its_drafts_and_the_others_do_not():
    watch, like = DraftWatch(), torch.zeros(2, 16)
    watch.look(ramp(rows=2), like)
    watch.reset(torch.tensor([True, False]))
    reading = watch.look(None, like)
    assert not reading.draft[0].any()
    assert millimetres(reading.draft[1:])[0] == 2


@pytest.mark.parametrize("horizon", [1, 9])
def test_another_horizon_is_refused_with_the_remedy(horizon):
    with pytest.raises(
        DexFlexError, match=f"8 control steps ahead; the draft has {horizon}. Cut it, or repeat"
    ):
        checked_draft(torch.zeros(1, horizon, 4, 3), 1)


def test_nan_is_refused():
    with pytest.raises(DexFlexError, match=r"NaN or infinity in rows \[0\]"):
        checked_draft(torch.full((1, 8, 4, 3), torch.nan), 1)
