"""The grip that DexFlex supplies: the decoder's forces, or a constant in the ablation."""

import pytest
import torch
from interface_cases import TACTILE, observation
from learned_cases import draft_of, flex, joints_of, noisy, pressing, tips_of, touched

from lerobot_dexflex.controller import HistoryBuffer
from lerobot_dexflex.conventions import FINGERTIPS
from lerobot_dexflex.hand.kinematics import contact_torques, finger_frames, pads, solve_fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.grip import Grip, ServoSettings
from lerobot_dexflex.interfaces.press import PressInterface, PressSettings

EXACT = {"rtol": 0, "atol": 1e-9}
SINGLE = {"rtol": 0, "atol": 1e-6}


def led(seen, motion, forces, points):
    """Joint targets that move the tips and lead the joints by J^T f / kp."""
    joints = joints_of(seen)
    posture = solve_fingertips(LEAP, tips_of(seen) + motion, joints)
    torques = contact_torques(LEAP, joints, points, forces)
    assert torques.abs().max() < LEAP.motors[0].grip_torque
    return posture + torques / LEAP.motors[0].position_gain


def test_the_decoders_forces_are_explained_in_the_palm_frame_and_lead_the_joints(controller):
    interface, seen = flex(pressing(controller, 2.0), "noselection"), touched(1.0, rows=2)
    targets = interface.step(seen, draft_of(2))
    centres, inward = pads(LEAP, joints_of(seen))
    torch.testing.assert_close(interface.explanation.forces, 2.0 * inward, **SINGLE)
    expected = led(seen, draft_of(2)[:, 0], 2.0 * inward, centres)  # Evenly touched: the pads' centres.
    torch.testing.assert_close(targets, expected, rtol=0, atol=1e-6)
    assert interface.explanation.row(0)["grip"] == pytest.approx(
        dict.fromkeys(("index", "middle", "ring", "thumb"), 2.0)
    )
    torch.testing.assert_close(interface.motion, draft_of(2)[:, 0], **EXACT)  # It holds no grip.


def test_forces_are_decoded_of_the_state_and_the_motion_that_is_executed(controller):
    interface, seen, draft = flex(controller, "noselection"), touched(1.0, rows=2), draft_of(2)
    targets = interface.step(seen, draft)
    past = HistoryBuffer(LEAP).observe({**seen, FINGERTIPS: tips_of(seen).flatten(1)})
    local = controller.decode(controller.encode(past), draft.float()).grip().double()
    forces = torch.einsum("bfij,bfj->bfi", finger_frames(LEAP, joints_of(seen)).distal_rotation, local)
    assert forces.norm(dim=-1).max() > 0.1
    torch.testing.assert_close(interface.explanation.forces, forces, rtol=0, atol=1e-5)
    told = interface.explanation.forces
    expected = led(seen, draft[:, 0], told, pads(LEAP, joints_of(seen))[0])
    torch.testing.assert_close(targets, expected, **SINGLE)


def test_a_finger_that_is_not_to_press_leads_no_joint(controller):
    some = pressing(controller, 2.0, (True, False, True, False))
    interface, seen = flex(some, "noselection"), touched(1.0)
    targets = interface.step(seen, draft_of(1))
    posture = solve_fingertips(LEAP, tips_of(seen) + draft_of(1)[:, 0], joints_of(seen))
    leads = (targets - posture).unflatten(1, (4, 4)).abs().amax(-1)[0]
    assert (leads > 0.01).tolist() == [True, False, True, False]
    assert leads[[1, 3]].max() < 1e-12
    assert not interface.explanation.forces[0, [1, 3]].any()


def test_forces_act_where_the_pad_is_pressed_and_at_its_centre_where_touch_is_not_known(controller):
    targets = {}
    for name in ("even", "one side", "one side, not known"):
        interface, seen = flex(pressing(controller, 2.0), "noselection"), touched(1.0)
        if name != "even":
            taxels = torch.zeros(1, 4, 10, 6)
            taxels[:, 0, 0], taxels[:, 1:] = 1 / 6, 1 / 60  # The index is pressed at one end.
            seen[TACTILE] = taxels.flatten(1)
        if name.endswith("not known"):
            seen[TACTILE][0, 0] = torch.nan
        targets[name] = interface.step(seen, draft_of(1))
    pressed, unknown = (targets[name] - targets["even"] for name in ("one side", "one side, not known"))
    assert pressed[0, :4].abs().max() > 0.001
    assert pressed[0, 4:].abs().max() < 1e-6
    torch.testing.assert_close(unknown, torch.zeros_like(unknown), **SINGLE)


def test_forces_are_fed_forward_alone_and_a_missing_finger_would_not_be_servoed_either(controller):
    seen = touched(0.5)
    seen[TACTILE][0, :60] = torch.nan
    targets = []
    for servo in (None, ServoSettings(gain=1e-3)):
        interface = flex(pressing(controller, 2.0), "noselection")
        if servo:
            interface._grip = Grip(LEAP, servo)
        targets.append(interface.step(seen, draft_of(1)))
    servoed = (targets[1] - targets[0]).unflatten(1, (4, 4)).abs().amax(-1)[0]
    assert servoed[0] == 0
    assert (servoed[1:] > 1e-3).all()  # 1.5 N are missing: 1.5 mm.
    assert interface.explanation.row(0)["touch_health"]["index"] == "missing"


def test_the_grip_is_decoded_anew_in_every_step_of_a_prefix(controller):
    interface, forces = flex(controller, prefix=4), []
    for k in range(4):
        interface.step(noisy(observation(1, k), k), draft_of(1))
        forces.append(interface.explanation.forces)
    assert all(not torch.equal(forces[0], other) for other in forces[1:])


def test_a_gain_scales_the_motion_and_leaves_the_leads_of_the_grip(controller):
    interface, seen = flex(pressing(controller, 2.0), "noselection"), touched(1.0)
    interface.gain = 0.5
    targets = interface.step(seen, draft_of(1))
    centres, inward = pads(LEAP, joints_of(seen))
    torch.testing.assert_close(
        targets, led(seen, 0.5 * draft_of(1)[:, 0], 2.0 * inward, centres), rtol=0, atol=1e-6
    )


def test_a_grip_beyond_the_motors_is_bounded(controller):
    """8 N, the most that a decoder wants, at the end of a finger are more than its motors have."""
    targets = []
    for newtons in (8.0, 80.0):
        interface, seen = flex(pressing(controller, newtons), "noselection"), touched(1.0)
        targets.append(interface.step(seen, 0 * draft_of(1)))
    torch.testing.assert_close(*targets, **SINGLE)
    lead = (targets[0] - joints_of(seen)).abs().max()
    assert lead.item() == pytest.approx(LEAP.motors[0].grip_torque / LEAP.motors[0].position_gain, abs=1e-6)


def test_without_learned_forces_touching_fingers_press_with_the_constant_of_press(controller):
    seen = touched([1.0, 0.5, 0.0, 2.0], rows=2)
    interface = flex(pressing(controller, 5.0), "nogrip")
    interface.step(seen, draft_of(2))
    pushed = interface.explanation.forces.norm(dim=-1)
    torch.testing.assert_close(pushed[0], torch.tensor([1.5, 1.5, 0.0, 1.5], dtype=torch.float64), **EXACT)
    torch.testing.assert_close(
        interface.explanation.forces[:, :2], 1.5 * pads(LEAP, joints_of(seen))[1][:, :2], **EXACT
    )


def test_without_selection_and_learned_forces_it_is_press_without_a_servo(controller):
    ours = flex(controller, "noselection", grip=1.5, prefix=1)
    press = PressInterface(LEAP, PressSettings(force=1.5), ServoSettings(gain=0.0, back=0.0))
    for k, loads in enumerate(([1.0, 1.0, 0.0, 2.0], 0.0, 0.0, 0.0, 0.0, 1.0)):
        seen, draft = touched(loads, rows=2, seed=k), draft_of(2, k)
        torch.testing.assert_close(ours.step(seen, draft), press.step(seen, draft), **SINGLE)
        fingers = int((ours.explanation.forces[0].norm(dim=-1) > 0).sum())
        assert fingers == (3, 3, 3, 0, 0, 4)[k]  # A load of a moment ago still counts.
