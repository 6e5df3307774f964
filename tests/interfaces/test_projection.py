"""The interface around the contact projection keeps its own command and reads displacements from drafts."""

import pytest
import torch
from interface_cases import STATE, TACTILE, held, measured, observation, still, touching

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import solve_fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.interfaces.projection import RUNAWAY, ProjectionInterface

FREE = {TACTILE: torch.zeros(1, 240)}


def leads(interface, steps):
    """Return the motion [m] after every step of (observation, draft)."""
    found = []
    for seen, draft in steps:
        interface.step(seen, draft)
        found.append(interface.motion)
    return torch.stack(found)


def test_without_a_grasp_it_executes_what_raw_does():
    interface, raw = ProjectionInterface(LEAP), make_interface(LEAP, "raw")
    for k in range(5):
        seen = observation(1, seed=k) | FREE
        draft = held(torch.full((1, 4, 3), 0.001 * (k + 1), dtype=torch.float64))
        torch.testing.assert_close(interface.step(seen, draft), raw.step(seen, draft), atol=1e-12, rtol=0)


def test_a_pressing_draft_builds_up_a_squeeze_slowly_and_it_stays():
    interface, seen = make_interface(LEAP, "projection:squeeze_gain=0+speed=0.001"), touching(2.0)
    _, _, inward = measured(seen)
    pressing = held(0.006 * inward)
    depth = (leads(interface, [(seen, pressing)] * 40)[:, 0] * inward).sum(-1)  # (steps, 4)
    assert (depth.diff(dim=0) > -1e-9).all()
    assert depth.diff(dim=0).max() <= 0.001 + 1e-9
    assert depth[0].max() <= 0.001 + 1e-9
    assert (depth[-1] > 0.003).all()
    assert (depth[-1] < 0.0061).all()


def test_the_command_is_where_it_was_when_the_hand_has_moved():
    """The lead is from the measured tips, wherever they are by now."""
    interface = ProjectionInterface(LEAP)
    first = observation(1) | FREE
    second = first | {STATE: first[STATE] + 0.05}
    goal = measured(first)[1] + 0.002
    interface.step(first, held(goal - measured(first)[1]))
    posture = interface._hand.posture
    blind = make_interface(LEAP, "projection:free_gain=0")
    blind.step(first, held(goal - measured(first)[1]))
    joints = interface.step(second, held(goal - measured(second)[1]))
    torch.testing.assert_close(joints, solve_fingertips(LEAP, goal, posture), atol=1e-9, rtol=0)
    blinded = {STATE: second[STATE]}  # Nothing of the draft passes: the command stays.
    blind.step(blinded, held(goal - measured(second)[1] + 0.01))
    torch.testing.assert_close(blind.motion, goal - measured(second)[1], atol=1e-9, rtol=0)


def test_a_command_that_is_not_followed_does_not_run_away():
    interface, seen = ProjectionInterface(LEAP), observation(1) | FREE
    draft = held(torch.tensor([0.0, 0.0, -0.2], dtype=torch.float64).expand(1, 4, 3))
    lead = leads(interface, [(seen, draft)] * 5).norm(dim=-1)
    torch.testing.assert_close(lead, torch.full_like(lead, RUNAWAY))
    interface.step(seen, still())
    assert interface.motion is not None
    assert interface.motion.abs().max() < 1e-12  # It comes back at once.


def test_insisting_drafts_let_go_and_a_reset_row_must_insist_anew():
    interface, seen = ProjectionInterface(LEAP), touching(1.0, rows=2)
    _, _, inward = measured(seen)
    opening = held(-0.008 * inward)
    away = -(leads(interface, [(seen, opening)] * 6) * inward).sum(-1).amin(-1)  # (steps, rows)
    assert (away[:2] < 0.003).all()
    torch.testing.assert_close(away[-1], torch.full_like(away[-1], 0.008))
    interface.reset(torch.tensor([True, False]))
    interface.step(seen, opening)
    assert interface.motion is not None
    again = -(interface.motion * inward).sum(-1).amin(-1)
    assert again[0] < 0.003
    assert again[1] > 0.0079


def test_a_plan_is_told_from_a_draft_that_holds():
    """A motion in every step of the draft passes within the grasp, the same as one place is damped."""
    seen = touching(2.0)
    _, _, inward = measured(seen)
    slide = torch.zeros(1, 4, 3, dtype=torch.float64)
    slide[0, 1] = torch.linalg.cross(inward[0, 1], torch.tensor([0.0, 0.0, 1.0]).double())
    slide = 5e-4 * slide
    steps = torch.arange(1, 9, dtype=torch.float64).view(1, -1, 1, 1)
    moved = [
        (leads(make_interface(LEAP, "projection:gain=1+squeeze_gain=0"), [(seen, draft)])[0] - slide).norm()
        for draft in (steps * slide[:, None], held(slide))
    ]
    assert moved[0] < 1e-5
    assert moved[1] > 1e-4


@pytest.mark.parametrize("fault", ["key absent", "NaN"])
def test_missing_touch_is_survived_and_counts_as_free(fault):
    interface, seen = ProjectionInterface(LEAP), touching(1.0)
    blind = {STATE: seen[STATE]} if fault == "key absent" else seen | {TACTILE: seen[TACTILE] * torch.nan}
    draft = held(torch.full((1, 4, 3), 0.001, dtype=torch.float64))
    before = torch.zeros(1, 4, 3, dtype=torch.float64)
    for _ in range(3):
        assert torch.isfinite(interface.step(blind, draft)).all()
        expected = before + 0.3 * (draft[:, 0] - before)
        assert interface.motion is not None
        torch.testing.assert_close(interface.motion, expected)
        before = expected


def test_options_are_its_gains():
    interface = make_interface(LEAP, "projection:preload=2+speed=0.002")
    assert isinstance(interface, ProjectionInterface)
    assert (interface.settings.preload, interface.settings.speed) == (2.0, 0.002)
    with pytest.raises(DexFlexError, match="`gain` must be 0 or more"):
        make_interface(LEAP, "projection:gain=-1")
