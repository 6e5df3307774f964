"""What holds for every interface with networks, by whatever method's name."""

import json
from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from interface_cases import STATE, TACTILE, observation, row
from learned_cases import LEARNED, draft_of, flex, joints_of, noisy

from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.interfaces import make_interface

CLOSE = {"rtol": 0, "atol": 1e-5}
"""Of joint targets [rad]: matrices of float32 are multiplied in another order in batches of another size."""
learned = pytest.mark.parametrize("name", LEARNED)


@learned
def test_a_batch_does_what_its_rows_do_alone_whichever_of_them_are_reset(make, name):
    batch, alone = make(name), [make(name) for _ in range(3)]
    for k in range(7):
        if k == 3:
            batch.reset(torch.tensor([False, True, False]))
            alone[1].reset()
        seen, draft = noisy(observation(3, k), k), draft_of(3, k)
        targets = batch.step(seen, draft)
        for index, interface in enumerate(alone):
            expected = interface.step(row(seen, index), draft[index : index + 1])
            torch.testing.assert_close(targets[index : index + 1], expected, **CLOSE)
            if interface.explanation.choice is not None:
                assert batch.explanation.row(index)["branch"] == interface.explanation.row(0)["branch"]


@learned
def test_a_full_reset_is_a_new_interface_and_takes_a_batch_of_another_size(make, name):
    used, new = make(name), make(name)
    for k in range(4):
        used.step(noisy(observation(2, k), k), draft_of(2, k))
    with pytest.raises(DexFlexError, match="from 2 to 3 hands without a reset"):
        used.step(observation(3), draft_of(3))
    used.reset()
    assert used.explanation is None
    for k in range(3):
        seen, draft = noisy(observation(3, 10 + k), k), draft_of(3, k)
        assert torch.equal(used.step(seen, draft), new.step(seen, draft))


@learned
def test_a_reset_row_forgets_its_draft_and_holds_if_the_next_is_late(make, name):
    interface, new, seen = make(name), make(name), observation(2)
    interface.step(seen, draft_of(2))
    interface.reset(torch.tensor([True, False]))
    targets, fresh = interface.step(seen, None), new.step(seen, None)
    torch.testing.assert_close(targets[0], fresh[0], **CLOSE)
    assert (targets[1] - fresh[1]).abs().max() > 1e-3


@learned
def test_targets_come_in_the_drafts_type_and_motion_is_told(make, name):
    interface = make(name)
    assert make(name).motion is None
    assert interface.step(observation(2), draft_of(2).float()).dtype == torch.float32
    assert interface.motion.shape == (2, 4, 3)
    assert interface.step(observation(2), draft_of(2)).dtype == torch.float64


@learned
def test_a_gain_scales_the_motion_that_is_asked_and_no_forces(make, name):
    whole, half = make(name), make(f"{name}@0.5")
    for interface in (whole, half):
        interface.step(observation(2), draft_of(2))
    torch.testing.assert_close(half.motion, 0.5 * whole.motion, rtol=0, atol=1e-12)
    if whole.explanation.forces is not None:
        assert torch.equal(half.explanation.forces, whole.explanation.forces)


@learned
def test_no_joint_target_is_faster_than_the_servo_whatever_is_asked_or_measured(make, name):
    interface, targets = make(name), [joints_of(observation(2))]
    for k in range(12):
        seen = observation(2, k if k else 0)
        if k % 3 == 1:
            seen[STATE] = seen[STATE] + 2.0  # All encoders jump.
        targets.append(interface.step(noisy(seen, k), draft_of(2, k, size=10.0 ** (k % 4 - 3))))
    steps = [float((after - before).abs().max()) for before, after in pairwise(targets)]
    assert max(steps) <= LEAP.joint_speeds.min() * CONTROL_PERIOD + 1e-12
    assert max(steps) > 0.2  # There was something to bound.


@learned
def test_it_steps_in_inference_mode_and_is_reset_outside_of_it(make, name):
    inside, outside = make(name), make(name)
    for k in range(3):
        seen, draft = observation(2, k), draft_of(2, k)
        with torch.inference_mode():
            targets = inside.step(seen, draft)
        assert torch.equal(targets, outside.step(seen, draft))
        for interface in (inside, outside):
            interface.reset(torch.tensor([k == 0, k == 1]))


@learned
def test_the_measured_fingertips_are_those_of_the_joints_whatever_the_observation_says(make, name):
    first, second = make(name), make(name)
    without = {key: value for key, value in observation(2).items() if "fingertips" not in key}
    seen = {**observation(2), "observation.fingertips": torch.full((2, 12), 9.0)}
    assert torch.equal(first.step(without, draft_of(2)), second.step(seen, draft_of(2)))


@learned
def test_the_same_seed_gives_the_same_targets_and_another_seed_others(make, name):
    first, second, other = make(name), make(name), make(f"{name}+seed=1")
    for k in range(3):
        seen, draft = observation(2, k), draft_of(2, k)
        assert torch.equal(first.step(seen, draft), second.step(seen, draft))
        other.step(seen, draft)
    assert not torch.equal(first.motion, other.motion)


REFUSED = {
    "NaN in the draft": ({}, torch.full((2, 8, 4, 3), torch.nan), r"draft holds NaN or infinity in rows"),
    "a draft too short": ({}, torch.zeros(2, 5, 4, 3), "8 control steps ahead; the draft has 5"),
    "joint targets": ({}, torch.zeros(2, 8, 16), r"A draft must have shape \(2, horizon, 4, 3\)"),
    "NaN in a joint": ({STATE: torch.full((2, 16), torch.nan)}, None, "'observation.state' holds NaN"),
    "too few joints": ({STATE: torch.zeros(2, 12)}, None, r"'observation.state' must have shape"),
    "no gravity": ({"observation.gravity": None}, None, "lacks 'observation.gravity'"),
    "wrong gravity": (
        {"observation.gravity": torch.zeros(2, 2)},
        None,
        "'observation.gravity' of the hand 'leap' must",
    ),
    "wrong touch": ({TACTILE: torch.zeros(2, 60)}, None, r"'observation.tactile' must have shape \(2, 240\)"),
    "another batch": ({STATE: torch.zeros(3, 16)}, None, "from 2 to 3 hands without a reset"),
}


def memories(interface):
    """What the parts of an interface remember."""
    parts = (interface._hand, interface._touch, interface._drafts, interface._past)
    return [value for part in parts for value in vars(part).values()]


@pytest.mark.parametrize("why", REFUSED)
@learned
def test_a_refused_step_leaves_nothing_behind(make, name, why):
    change, wrong, message = REFUSED[why]
    refused, twin = make(name), make(name)
    for k in range(5):
        seen, draft = noisy(observation(2, k), k), draft_of(2, k)
        assert torch.equal(refused.step(seen, draft), twin.step(seen, draft))
        told, known = (refused.motion, refused.explanation), memories(refused)
        bad = {key: value for key, value in {**noisy(seen, 50), **change}.items() if value is not None}
        for _ in range(2):
            with pytest.raises(DexFlexError, match=message):
                refused.step(bad, draft if wrong is None else wrong)
        assert (refused.motion, refused.explanation) == told
        assert all(now is before for now, before in zip(memories(refused), known, strict=True))


@learned
def test_a_step_refused_first_is_as_if_there_had_been_none(make, name):
    refused, new = make(name), make(name)
    with pytest.raises(DexFlexError, match="NaN"):
        refused.step(observation(3), torch.full((3, 8, 4, 3), torch.nan))
    assert refused.motion is None
    assert refused.explanation is None
    assert torch.equal(refused.step(observation(2), draft_of(2)), new.step(observation(2), draft_of(2)))


@pytest.mark.parametrize(
    "where", ["interfaces.dexflex.centres_of_pressure", "interfaces.commanded_hand.solve_fingertips"]
)
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("ablation", ["", "nogrip"])
def test_a_step_that_fails_after_the_grip_felt_is_forgotten_by_the_grip_as_well(
    controller, monkeypatch, where, error, ablation
):
    failing, twin = flex(controller, ablation), flex(controller, ablation)
    loaded = observation(2)
    empty = {**loaded, TACTILE: torch.zeros(2, 240)}

    def fail(*_):
        raise error

    for seen in (loaded, empty, empty):
        assert torch.equal(failing.step(seen, draft_of(2)), twin.step(seen, draft_of(2)))
        with monkeypatch.context() as patch:
            patch.setattr(f"lerobot_dexflex.{where}", fail)
            with pytest.raises(error):  # Remembered, it would tell that the fingers let go.
                failing.step(empty, draft_of(2))
    assert torch.equal(failing._grip._unloaded, twin._grip._unloaded)


@pytest.mark.parametrize("base", ["dexflex", "dexgen"])
def test_a_controller_of_another_draft_hand_or_rate_is_refused(controller_folder, tmp_path, base):
    for file in controller_folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    assert make_interface(LEAP, base, tmp_path).step(observation(1), draft_of(1)).shape == (1, 16)
    config = json.loads((tmp_path / "config.json").read_text())
    for name, value, message in (
        ("draft_definition", "displacement_of_commanded", "drafts are 'displacement_of_commanded'.*anew"),
        ("hand", "allegro", "There is no hand 'allegro'"),
        ("rate", 10.0, "10"),
    ):
        (tmp_path / "config.json").write_text(json.dumps({**config, name: value}))
        with pytest.raises(DexFlexError, match=message):
            make_interface(LEAP, base, tmp_path)


@pytest.mark.parametrize("base", ["dexflex", "dexgen"])
def test_a_controller_of_one_hand_does_not_serve_another(controller_folder, base):
    message = rf"in {controller_folder} was trained for 'leap', but the robot is 'sharpa'.*--hand=sharpa"
    with pytest.raises(DexFlexError, match=message):
        make_interface(SHARPA, base, controller_folder)


def test_a_hand_without_a_shipped_controller_says_how_to_get_one():
    with pytest.raises(
        DexFlexError, match=r"No controller for 'claw' at .*--policy.controller=.*dexflex-train"
    ):
        make_interface(replace(LEAP, name="claw"), "dexflex")


@learned
def test_weights_are_never_changed(make, name):
    interface = make(name)
    before = {key: value.clone() for key, value in interface.controller.state_dict().items()}
    for k in range(3):
        interface.step(observation(2, k), draft_of(2, k))
    assert all(torch.equal(value, before[key]) for key, value in interface.controller.state_dict().items())
    assert not any(value.requires_grad for value in interface.controller.parameters())


def test_interfaces_share_a_loaded_controller_and_no_memory(make):
    first, second, new = make(LEARNED[0]), make(LEARNED[0]), make(LEARNED[0])
    assert first.controller is second.controller
    for k in range(3):
        first.step(observation(2, k), draft_of(2, k))
    assert torch.equal(second.step(observation(2), draft_of(2)), new.step(observation(2), draft_of(2)))
