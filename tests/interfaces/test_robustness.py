"""Learned interfaces stay finite, within the joint limits and honest when touch or drafts fail."""

import pytest
import torch
from interface_cases import STATE, TACTILE, observation
from learned_cases import LEARNED, draft_of, flex, noisy, pressing, touched

from lerobot_dexflex.hand.kinematics import joint_limits
from lerobot_dexflex.hands import LEAP

JOINT_LOWER, JOINT_UPPER = joint_limits(LEAP)


STEPS = 10


def without_touch(seen):
    return {key: value for key, value in seen.items() if key != TACTILE}


def with_finger(seen, finger, taxels):
    touch = seen[TACTILE].clone().view(-1, 4, 60)
    touch[:, finger] = taxels
    return {**seen, TACTILE: touch.flatten(1)}


TOUCH_FAULTS = {
    "key absent": (without_touch, "missing", [0, 1, 2, 3]),
    "one NaN": (lambda seen: with_finger(seen, 1, torch.tensor([torch.nan] + [0.1] * 59)), "missing", [1]),
    "all infinite": (lambda seen: with_finger(seen, slice(None), torch.inf), "missing", [0, 1, 2, 3]),
    "frozen": (lambda seen: with_finger(seen, 2, torch.linspace(0.1, 0.2, 60)), "frozen", [2]),
    "saturated": (lambda seen: with_finger(seen, 3, torch.linspace(0.9, 1.5, 60)), "saturated", [3]),
}


def assert_executable(targets):
    assert torch.isfinite(targets).all()
    assert (targets.double() >= JOINT_LOWER - 1e-6).all()
    assert (targets.double() <= JOINT_UPPER + 1e-6).all()


@pytest.mark.parametrize("fault", TOUCH_FAULTS)
@pytest.mark.parametrize("name", LEARNED)
def test_a_failing_finger_is_named_and_the_hand_goes_on(make, name, fault):
    break_touch, health, fingers = TOUCH_FAULTS[fault]
    interface = make(name)
    for k in range(STEPS):
        seen = noisy(observation(2, k), k)
        assert_executable(interface.step(break_touch(seen) if k > 2 else seen, draft_of(2, k)))
    for index in range(2):
        expected = {f: health if i in fingers else "ok" for i, f in enumerate(LEAP.finger_names)}
        assert interface.explanation.row(index)["touch_health"] == expected
    interface.step(noisy(observation(2), STEPS), draft_of(2))
    assert set(interface.explanation.row(0)["touch_health"].values()) == {"ok"}


@pytest.mark.parametrize("name", LEARNED)
def test_what_a_failing_finger_reports_has_no_influence(make, name):
    targets = []
    for junk in (torch.linspace(0.9, 1.5, 60), torch.linspace(1.0, 7.0, 60)):
        interface = make(name)
        told = interface.step(with_finger(observation(2), 3, junk), draft_of(2))
        after = interface.step(observation(2), draft_of(2))  # It is well again and the past is looked at.
        targets.append(torch.stack([told, after]))
    assert torch.equal(*targets)


@pytest.mark.parametrize("name", LEARNED)
def test_late_drafts_are_bridged_reported_and_end_in_rest(make, name):
    interface = make(name)
    interface.step(observation(2), draft_of(2))
    for k in range(STEPS):
        targets = interface.step(observation(2, k), None)
        assert targets.dtype == observation(2)[STATE].dtype
        assert_executable(targets)
        assert interface.explanation.row(0)["draft_health"] == "late"
    interface.step(observation(2), draft_of(2))
    assert interface.explanation.row(0)["draft_health"] == "ok"


@pytest.mark.parametrize("size", [0.05, 1.0, 1e6])
@pytest.mark.parametrize("name", LEARNED)
def test_drafts_far_outside_of_the_workspace_are_clipped_and_reported(make, name, size):
    interface = make(name)
    for k in range(STEPS):
        assert_executable(interface.step(observation(2, k), draft_of(2, k, size)))
        assert interface.explanation.row(1)["draft_health"] == "clipped"
    assert interface.motion.abs().max() <= 0.2


@pytest.mark.parametrize("name", LEARNED)
def test_everything_failing_at_once_is_survived(make, name):
    interface = make(name)
    generator = torch.Generator().manual_seed(0)
    for k in range(3 * STEPS):
        break_touch = list(TOUCH_FAULTS.values())[k % len(TOUCH_FAULTS)][0]
        late = torch.rand(1, generator=generator) < 0.3
        draft = None if late else draft_of(2, k, 10.0 ** (k % 5 - 3))
        assert_executable(interface.step(break_touch(observation(2, k)), draft))
        if k % 7 == 0:
            interface.reset(torch.tensor([True, False]))


@pytest.mark.parametrize("name", LEARNED)
def test_dropped_frames_are_survived_and_touch_is_believed_again_with_the_next(make, name):
    interface, last = make(name), noisy(observation(2), 0)
    for k in range(STEPS):  # The camera thread of the sensors hangs: every frame is the same.
        assert_executable(interface.step(last, draft_of(2, k)))
        expected = "ok" if k < 4 else "frozen"
        assert set(interface.explanation.row(0)["touch_health"].values()) == {expected}
    interface.step(noisy(observation(2), 1), draft_of(2))
    assert set(interface.explanation.row(1)["touch_health"].values()) == {"ok"}


@pytest.mark.parametrize("name", LEARNED)
def test_a_hand_in_the_air_reports_zeros_and_is_well(make, name):
    interface, seen = make(name), {**observation(1), TACTILE: torch.zeros(1, 240)}
    for _ in range(STEPS):
        interface.step(seen, draft_of(1))
    assert set(interface.explanation.row(0)["touch_health"].values()) == {"ok"}


@pytest.mark.parametrize("fault", [fault for fault in TOUCH_FAULTS if fault != "frozen"])
def test_a_finger_that_is_not_felt_is_pressed_as_decoded_and_by_the_constant_only_for_a_moment(
    controller, fault
):
    """The decoder may know of a contact otherwise; the constant goes by what is felt."""
    break_touch, _, fingers = TOUCH_FAULTS[fault]
    pressed = {}
    for ablation in ("", "nogrip"):
        interface = flex(pressing(controller, 1.0), ablation)
        interface.step(touched(1.0), draft_of(1))
        for k in range(4):
            interface.step(break_touch(noisy(touched(1.0), k)), draft_of(1, k))
        pressed[ablation] = interface.explanation.forces[0].norm(dim=-1) > 0
    assert pressed[""].all()
    assert (~pressed["nogrip"]).nonzero().flatten().tolist() == fingers


def test_faults_and_late_drafts_are_told_in_one_sentence(controller):
    interface = flex(controller)
    interface.step(with_finger(observation(1), 1, torch.nan), None)
    sentence = interface.explanation.sentence(0)
    assert sentence.endswith("touch of middle missing; draft late")
