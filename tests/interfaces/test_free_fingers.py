"""A hand that holds nothing, or is to let go, follows its draft; a finger removed by error does not."""

import pytest
import torch
from interface_cases import TACTILE, held, measured, row
from learned_cases import LEARNED, draft_of, flex, noisy, pressing, touched

from lerobot_dexflex.commands.families import REMOVAL_STEPS
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.interfaces.free_fingers import EMPTY_STEPS, INSISTING_STEPS, FreeFingers

FELT = [name for name in LEARNED if "notouch" not in name]
EXACT = {"rtol": 0, "atol": 1e-9}
"""Of joint targets [rad]."""
INWARD = torch.tensor([[0.0, 0.0, -1.0]] * 4, dtype=torch.float64)
"""Pads that look down. Shape (4, 3)."""
ALL, NONE, INDEX = [True] * 4, [False] * 4, [True, False, False, False]


def away(outward, rows=1):
    """Drafts that lead fingers off what pads that look down touch, [mm] for all or one per finger."""
    outward = torch.as_tensor(outward, dtype=torch.float64).expand(4)
    return held(-0.001 * outward[:, None] * INWARD.expand(rows, 4, 3))


def removed(steps, size=2.0, finger=0):
    """The drafts of a removal of `size` [mm] per step of a finger that is held back, as it ages."""
    struck = torch.nn.functional.one_hot(torch.tensor(finger), 4)
    ahead = torch.arange(8.0).view(1, 8, 1, 1)
    return [away(struck) * size * (age + ahead) for age in range(1, steps + 1)]


def free_of(fingers, draft, loads, late=False):
    """One step; the loads [N] are a number for all or one per finger. Returns a list of bools per finger."""
    loads = torch.as_tensor(loads, dtype=torch.float64).expand(len(draft), 4)
    found = fingers.look(draft, loads, INWARD.expand(len(draft), 4, 3), torch.full((len(draft),), late))
    return found[0].tolist() if len(draft) == 1 else found.tolist()


def test_a_hand_that_feels_nothing_is_free_from_the_first_step_and_later_after_a_while():
    fingers = FreeFingers()
    assert free_of(fingers, away(0.0), 0.0) == ALL
    assert free_of(fingers, away(0.0), [0.0, 0.0, 0.0, 1.0]) == NONE
    found = [free_of(fingers, away(0.0), 0.01) for _ in range(EMPTY_STEPS + 1)]
    assert found == [NONE] * (EMPTY_STEPS - 1) + [ALL] * 2


def test_touch_that_is_not_known_is_not_nothing_and_a_gap_does_not_start_the_wait_again():
    fingers, unknown = FreeFingers(), [0.0, torch.nan, 0.0, 0.0]
    assert free_of(fingers, away(0.0), unknown) == NONE
    assert free_of(fingers, away(0.0), 0.0) == ALL
    assert [free_of(fingers, away(0.0), unknown) for _ in range(2 * EMPTY_STEPS)] == [NONE] * 2 * EMPTY_STEPS
    assert free_of(fingers, away(0.0), 0.0) == ALL


@pytest.mark.parametrize(
    ("outward", "loads", "free"),
    [
        ([9, 9, 10, 11], 1.0, ALL),
        ([9, 9, 10, 12], 1.0, NONE),  # Not alike: 9 / 12 < .8.
        ([7, 7, 7, 7], 1.0, NONE),  # Not far.
        ([9, 5, 20, 9], [1.0, 0.0, 0.0, 1.0], ALL),  # Who carries nothing leaves as it likes.
        ([9, 5, 20, 9], [1.0, torch.nan, 0.0, 1.0], NONE),  # Of one that may carry it is not known.
        ([9, 0, 9, 9], [1.0, 0.0, 0.0, 1.0], NONE),  # Middle stays: thumb may be a removal.
        ([9, 9, 9, 9], torch.nan, ALL),
        ([9, 9, 9, 9], [1.0, 0.0, 0.0, 0.0], NONE),  # One that carries may be an error.
    ],
)
def test_a_release_leads_all_that_carry_outward_alike_and_is_known_at_once(outward, loads, free):
    assert free_of(FreeFingers(), away(outward), loads) == free


def test_fingers_led_outward_together_for_long_are_free_however_little():
    fingers, draft = FreeFingers(), away([5, 5, 5, 20])
    assert [free_of(fingers, draft, 1.0)[0] for _ in range(INSISTING_STEPS)] == [False] * 9 + [True]
    broken = FreeFingers()
    for k in range(3 * INSISTING_STEPS):
        held_back = k % INSISTING_STEPS == INSISTING_STEPS - 1
        assert not free_of(broken, away([5, 5, 5, 0 if held_back else 20]), 1.0)[0]


def test_a_removal_is_no_insistence_and_a_longer_one_is():
    fingers = FreeFingers()
    for _ in range(3):
        for draft in (*removed(REMOVAL_STEPS), away(-5.0)):
            assert free_of(fingers, draft, 1.0) == NONE
    found = [free_of(fingers, draft, 1.0) for draft in removed(INSISTING_STEPS)]
    assert found == [NONE] * (INSISTING_STEPS - 1) + [INDEX]


def test_late_drafts_do_not_insist_and_do_not_interrupt_who_does():
    fingers, (*drafts, last) = FreeFingers(), removed(INSISTING_STEPS)
    for draft in drafts:
        assert free_of(fingers, draft, 1.0) == NONE
        assert free_of(fingers, draft, 1.0, late=True) == NONE
    assert free_of(fingers, last, 1.0) == INDEX


def test_free_fingers_are_held_again_once_they_touch_and_are_not_led_outward_or_are_led_inward():
    fingers = FreeFingers()
    others = [1.0, 0.0, 0.0, 0.0]
    assert free_of(fingers, away(9.0), 1.0) == ALL
    assert free_of(fingers, away(9.0), others) == ALL  # Something brushes a finger that goes on leaving.
    assert free_of(fingers, away(0.0), others) == [False, True, True, True]
    assert free_of(fingers, away([0.0, -3.0, -5.0, 0.0]), others) == [False, True, False, True]
    assert free_of(fingers, away(0.0), 1.0) == NONE


def test_rows_are_judged_and_forgotten_alone():
    fingers, both = FreeFingers(), torch.cat([away(9.0), away(0.0)])
    assert free_of(fingers, both, 1.0) == [ALL, NONE]
    fingers.reset(torch.tensor([True, False]))
    assert free_of(fingers, both[[1, 0]], 1.0) == [NONE, ALL]
    for draft in removed(INSISTING_STEPS - 1):
        free_of(fingers, draft.expand(2, -1, -1, -1), 1.0)
    fingers.reset(torch.tensor([False, True]))
    assert free_of(fingers, removed(1)[0].expand(2, -1, -1, -1), 1.0) == [INDEX, NONE]
    assert free_of(fingers, torch.cat([away(0.0)] * 2), 0.0) == [INDEX, NONE]  # They carried something.
    fingers.reset(torch.tensor([True, False]))
    assert free_of(fingers, torch.cat([away(0.0)] * 2), 0.0) == [ALL, NONE]
    fingers.reset()
    assert free_of(fingers, away(0.0), 0.0) == ALL


# In the interfaces.


def leaving(seen, outward):
    """A held draft that leads the fingers of a hand off what they touch, [mm] for all or one per finger."""
    outward = torch.as_tensor(outward, dtype=torch.float64).expand(4)
    return held(-0.001 * outward[:, None] * measured(seen)[2])


@pytest.mark.parametrize("name", FELT)
def test_a_hand_in_the_air_is_commanded_as_by_raw(make, name):
    interface, raw = make(f"{name}@0.5"), make_interface(LEAP, "raw@0.5")
    for k in range(5):
        seen, draft = touched(0.0, rows=2, seed=k), draft_of(2, k, size=0.01)
        torch.testing.assert_close(interface.step(seen, draft), raw.step(seen, draft), **EXACT)
        torch.testing.assert_close(interface.motion, raw.motion, **EXACT)
        assert interface.explanation.free.all()


@pytest.mark.parametrize("name", LEARNED)
def test_a_hand_without_touch_is_not_taken_for_one_in_the_air(make, name):
    interface, seen = make(name), touched(0.0)
    del seen[TACTILE]
    for k in range(2 * EMPTY_STEPS):
        interface.step(seen, draft_of(1, k))
        assert not interface.explanation.free.any()


@pytest.mark.parametrize("name", LEARNED)
def test_a_release_is_obeyed_at_once_and_without_grip(make, name):
    interface, raw = make(name), make_interface(LEAP, "raw")
    seen = touched(2.0)
    draft = leaving(seen, [9, 9, 10, 10])
    torch.testing.assert_close(interface.step(seen, draft), raw.step(seen, draft), **EXACT)
    torch.testing.assert_close(interface.motion, draft[:, 0], **EXACT)
    if interface.explanation.forces is not None:
        assert not interface.explanation.forces.any()
    assert interface.explanation.row(0)["free"] == dict.fromkeys(LEAP.finger_names, True)


def test_of_a_finger_that_is_to_leave_the_motion_is_the_drafts_and_the_others_go_on_pressing(controller):
    interface, control = flex(pressing(controller, 1.0)), flex(pressing(controller, 1.0))
    draft, last = leaving(touched(2.0), [20, 0, 0, 0]), INSISTING_STEPS - 1
    for k in range(INSISTING_STEPS):
        interface.step(noisy(touched(2.0), k), draft)
        assert interface.explanation.free[0].tolist() == (INDEX if k == last else NONE)
    torch.testing.assert_close(interface.motion[0, 0], draft[0, 0, 0], **EXACT)
    forces = interface.explanation.forces[0].norm(dim=-1)
    torch.testing.assert_close(forces, torch.tensor([0.0, 1.0, 1.0, 1.0]).double(), rtol=0, atol=1e-6)
    control.step(noisy(touched(2.0), last), draft)  # It has seen no insistence.
    assert control.explanation.forces[0, 0].norm() > 0.9
    assert (interface.motion[0, 1:] - control.motion[0, 1:]).abs().max() < 0.01


@pytest.mark.parametrize("name", FELT)
def test_rows_are_free_alone_and_a_reset_row_forgets(make, name):
    batch, seen = make(name), touched(2.0, rows=2)
    draft = torch.cat([leaving(row(seen, 0), 9.0), 0 * leaving(row(seen, 0), 9.0)])
    batch.step(seen, draft)
    assert batch.explanation.free.tolist() == [ALL, NONE]
    batch.reset(torch.tensor([True, False]))
    batch.step({**seen, TACTILE: 0 * seen[TACTILE]}, 0 * draft)
    assert batch.explanation.free.tolist() == [ALL, NONE]  # One has never carried, one did a moment ago.


@pytest.mark.parametrize("name", FELT)
def test_a_refused_step_does_not_count(make, name, monkeypatch):
    interface, seen = make(name), touched(2.0)
    draft = leaving(seen, [20, 0, 0, 0])
    with monkeypatch.context() as patch:
        patch.setattr(interface._hand, "execute", None)
        for _ in range(INSISTING_STEPS):
            with pytest.raises(TypeError):
                interface.step(seen, draft)
    interface.step(seen, draft)
    assert not interface.explanation.free.any()
