"""What interfaces take from the hand: pads, torques, speeds, and which fingers oppose."""

import mujoco
import numpy as np
import pytest
import torch
from interface_cases import STATE, hand_poses, held, measured, observation, still, touching

from lerobot_dexflex.commands.loop import stack_observations
from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.hand.kinematics import contact_torques, joint_limits, pads
from lerobot_dexflex.hand.model import add_hand, base_spec
from lerobot_dexflex.hands import HANDS, SHARPA
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.interfaces.contact_projection import PAST_DRAFTS, WINDOW, Grasp, project_draft
from lerobot_dexflex.interfaces.contact_projection import ProjectionSettings as Settings
from lerobot_dexflex.interfaces.grip import centres_of_pressure, loads_of

NO_SERVO = "servo=0+back=0"


@pytest.fixture(params=HANDS.values(), ids=list(HANDS))
def hand(request):
    return request.param


def test_pressure_on_a_taxel_is_where_the_model_has_that_taxel(hand):
    spec = base_spec()
    add_hand(spec, spec.worldbody, hand, (0, 0, 0), (1, 0, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = hand_poses(1, hand=hand)
    data.qpos[:] = joints[0].numpy()
    mujoco.mj_kinematics(model, data)
    taxels = torch.zeros(1, hand.n_fingers, *hand.taxels)
    taxels[:, :, -1, 1] = 1.0  # The row nearest to the tip, the second column.
    along = (hand.taxels[0] - 1) / 2 * hand.taxel_pitch[0]
    across = (1 - (hand.taxels[1] - 1) / 2) * hand.taxel_pitch[1]
    found = centres_of_pressure(hand, joints, taxels.flatten(1))[0].numpy()
    for finger, prefix in enumerate(hand.prefixes):
        pad = data.site(f"{prefix}_pad")
        expected = pad.xpos + pad.xmat.reshape(3, 3) @ (along, across, 0.0)
        np.testing.assert_allclose(found[finger], expected, atol=1e-9)
    assert loads_of(hand, taxels).tolist() == [[1.0] * hand.n_fingers]


def test_the_grip_of_press_is_the_torque_of_its_forces_as_far_as_motors_give_it(hand):
    seen = touching(1.0, hand=hand)
    joints, _, inward = measured(seen, hand)
    raw = make_interface(hand, "raw").step(seen, still(hand=hand))
    lower, upper = joint_limits(hand)
    step = torch.tensor(hand.joint_speeds * CONTROL_PERIOD)
    for force in (2.0, 60.0):
        pressed = make_interface(hand, f"press:{force}+{NO_SERVO}").step(seen, still(hand=hand))
        torques = contact_torques(hand, joints, pads(hand, joints)[0], force * inward)
        largest = torch.tensor(hand.grip_torques)
        lead = torques.clamp(-largest, largest) / torch.tensor(hand.position_gains)
        expected = (raw + lead).clamp(lower, upper).clamp(joints - step, joints + step)
        torch.testing.assert_close(pressed, expected, atol=1e-12, rtol=0)
        assert (torques.abs() > largest).any() == (force == 60.0)


def test_no_joint_is_told_to_turn_faster_than_its_own_motor_can():
    interface, seen = make_interface(SHARPA, "joint"), observation(1, hand=SHARPA)
    before = measured(seen, SHARPA)[0]
    far = torch.tensor(np.where(before[0] < 0.6, SHARPA.joint_upper, SHARPA.joint_lower))[None, None]
    steps = (interface.step(seen, far) - before).abs()[0].numpy()
    limits = SHARPA.joint_speeds * CONTROL_PERIOD
    asked = (far[0] - before).abs()[0].numpy()
    np.testing.assert_allclose(steps, np.minimum(asked, limits), atol=1e-12)
    assert len(np.unique(np.round(limits, 6))) > 2


@pytest.mark.parametrize("opens", [True, False])
def test_the_projection_lets_go_only_where_a_finger_that_opposes_goes_too(hand, opens):
    """A plan that takes three fingers outward opens a grasp if the thumb is one of them."""
    joints = hand_poses(1, hand=hand)
    tips, inward = measured({STATE: joints}, hand)[1], pads(hand, joints)[1]
    fingers = list(hand.opposed_fingers[:3])
    if opens:
        fingers[0] = hand.opposing_fingers[0]
    motion = torch.zeros_like(tips)
    motion[:, fingers] = -0.004 * inward[:, fingers]
    loads = torch.ones(1, WINDOW, hand.n_fingers, dtype=torch.float64)
    missing = torch.zeros(1, hand.n_fingers, dtype=torch.bool)
    drafts = motion[:, None].expand(-1, PAST_DRAFTS, -1, -1)
    found = project_draft(hand, held(motion), Grasp(joints, tips, loads, missing, drafts), Settings())
    assert torch.equal(found, motion) == opens


def test_five_fingers_press_what_raw_drops():
    env = ReachEnv(cameras=(), hand=SHARPA)
    first, _ = env.reset(seed=8)
    start, lifted = env.snapshot(), {}
    for name in ("press:2.5", "raw"):
        env.restore(start)
        interface, seen, info = make_interface(SHARPA, name), first, {}
        for _ in range(30):
            batch = stack_observations([seen])
            targets = interface.step(batch, still(hand=SHARPA))[0].numpy()
            seen, _, _, _, info = env.step(targets)
        lifted[name] = info["dropped"]
    assert lifted == {"press:2.5": False, "raw": True}
