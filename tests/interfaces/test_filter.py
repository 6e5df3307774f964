"""`filter` lags behind the draft and never leads far; with nothing to smooth or clip it is `raw`."""

import pytest
import torch
from interface_cases import drafts, held, measured, observation

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface


def motion(name, draft, steps=1):
    """Return the motion that an interface asks of a resting hand after some steps of the same draft."""
    interface, seen = make_interface(LEAP, name), observation(1)
    for _ in range(steps):
        interface.step(seen, draft)
    assert interface.motion is not None
    return interface.motion


def test_without_smoothing_and_clipping_it_is_raw():
    seen, draft = observation(3), drafts("raw", 3)
    assert torch.equal(
        make_interface(LEAP, "filter:1").step(seen, draft).float(),
        make_interface(LEAP, "raw").step(seen, draft).float(),
    )


def test_it_goes_a_share_of_the_way_in_every_step():
    draft = held(torch.full((1, 4, 3), 0.004, dtype=torch.float64))
    torch.testing.assert_close(motion("filter:0.5", draft), 0.5 * draft[:, 0])
    torch.testing.assert_close(motion("filter:0.5", draft, 2), 0.75 * draft[:, 0], atol=3e-4, rtol=0)


def test_a_draft_that_jumps_to_and_fro_is_damped():
    interface, seen = make_interface(LEAP, "filter:0.3"), observation(1)
    _, tips, _ = measured(seen)
    to = held(torch.full((1, 4, 3), 0.006, dtype=torch.float64))
    strayed = [fingertips(LEAP, interface.step(seen, sign * to)) - tips for sign in (1, -1) * 10]
    assert max(float(way.norm(dim=-1).max()) for way in strayed[4:]) < 0.4 * 0.006 * 3**0.5


def test_it_leads_by_the_limit_at_most():
    draft = held(torch.full((1, 4, 3), 0.02, dtype=torch.float64))
    asked = motion("filter:1+limit=0.01", draft)
    torch.testing.assert_close(asked.norm(dim=-1), torch.full((1, 4), 0.01, dtype=torch.float64))


@pytest.mark.parametrize(("name", "wrong"), [("filter:0", "share"), ("filter:limit=-1", "limit")])
def test_what_makes_no_filter_is_refused(name, wrong):
    with pytest.raises(DexFlexError, match=f"`{wrong}` of the filter"):
        make_interface(LEAP, name)
