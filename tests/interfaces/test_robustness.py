"""Learned interfaces stay finite, within the joint limits and honest when touch or drafts fail."""

import pytest
import torch
from interface_cases import STATE, TACTILE, drafts, observation

from lerobot_dexflex.conventions import FINGER_NAMES
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import JOINT_LOWER, JOINT_UPPER

_FEW = "n_pure=4+n_seeded=4+nfe=2"
LEARNED = [f"dexflex:{_FEW}", f"dexflex-notouch:{_FEW}", "dexgen:steps=2"]
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


def vary(seen, k):
    """Sensor noise, so that only a frozen finger repeats itself."""
    noise = 0.01 * torch.rand(seen[TACTILE].shape, generator=torch.Generator().manual_seed(100 + k))
    return {**seen, TACTILE: seen[TACTILE] + noise}


@pytest.mark.parametrize("fault", TOUCH_FAULTS)
@pytest.mark.parametrize("name", LEARNED)
def test_a_failing_finger_is_named_and_the_hand_goes_on(make, name, fault):
    break_touch, health, fingers = TOUCH_FAULTS[fault]
    interface = make(name)
    for k in range(STEPS):
        seen = vary(observation(2, k), k)
        assert_executable(interface.step(break_touch(seen) if k > 2 else seen, drafts(name, 2, k)))
    for index in range(2):
        expected = {f: health if i in fingers else "ok" for i, f in enumerate(FINGER_NAMES)}
        assert interface.explanation.row(index)["touch_health"] == expected
    interface.step(vary(observation(2), STEPS), drafts(name, 2))
    assert set(interface.explanation.row(0)["touch_health"].values()) == {"ok"}


@pytest.mark.parametrize("name", LEARNED)
def test_what_a_failing_finger_reports_has_no_influence(make, name):
    targets = []
    for junk in (torch.linspace(0.9, 1.5, 60), torch.linspace(1.0, 7.0, 60)):
        interface = make(name)
        targets.append(interface.step(with_finger(observation(2), 3, junk), drafts(name, 2)))
    assert torch.equal(*targets)


@pytest.mark.parametrize("name", LEARNED)
def test_late_drafts_are_bridged_reported_and_end_in_rest(make, name):
    interface = make(name)
    interface.step(observation(2), drafts(name, 2))
    for k in range(STEPS):
        targets = interface.step(observation(2, k), None)
        assert targets.dtype == observation(2)[STATE].dtype
        assert_executable(targets)
        assert interface.explanation.row(0)["draft_health"] == "late"
    interface.step(observation(2), drafts(name, 2))
    assert interface.explanation.row(0)["draft_health"] == "ok"


@pytest.mark.parametrize("size", [0.05, 1.0, 1e6])
@pytest.mark.parametrize("name", LEARNED)
def test_drafts_far_outside_of_the_workspace_are_clipped_and_reported(make, name, size):
    interface = make(name)
    for k in range(STEPS):
        assert_executable(interface.step(observation(2, k), drafts(name, 2, k, size=size)))
        assert interface.explanation.row(1)["draft_health"] == "clipped"
    assert torch.isfinite(interface.command).all()


@pytest.mark.parametrize("name", LEARNED)
def test_everything_failing_at_once_is_survived(make, name):
    interface = make(name)
    generator = torch.Generator().manual_seed(0)
    for k in range(3 * STEPS):
        break_touch = list(TOUCH_FAULTS.values())[k % len(TOUCH_FAULTS)][0]
        late = torch.rand(1, generator=generator) < 0.3
        draft = None if late else drafts(name, 2, k, size=10.0 ** (k % 5 - 3))
        assert_executable(interface.step(break_touch(observation(2, k)), draft))
        if k % 7 == 0:
            interface.reset(torch.tensor([True, False]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({TACTILE: torch.zeros(2, 60)}, r"'observation.tactile' must have shape \(2, 240\)"),
        ({"observation.fingertips": torch.full((2, 12), torch.nan)}, r"'observation.fingertips' holds NaN"),
        ({"observation.gravity": torch.zeros(2, 2)}, r"'observation.gravity' must have shape \(batch, 3\)"),
    ],
)
@pytest.mark.parametrize("name", LEARNED)
def test_wrong_shapes_and_broken_proprioception_stay_errors(make, name, change, message):
    interface = make(name)
    interface.step(observation(2), drafts(name, 2))
    before = interface.command
    with pytest.raises(DexFlexError, match=message):
        interface.step({**observation(2), **change}, drafts(name, 2))
    assert interface.command is before


@pytest.mark.parametrize("name", LEARNED)
def test_gravity_or_fingertips_may_not_be_left_out(make, name):
    for key in ("observation.gravity", "observation.fingertips"):
        seen = {k: v for k, v in observation(1).items() if k != key}
        with pytest.raises(DexFlexError, match=f"lacks '{key}'"):
            make(name).step(seen, drafts(name, 1))
