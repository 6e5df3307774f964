"""Learned interfaces serve the hand of their controller, whatever its fingers and joints."""

from typing import Any

import pytest
import torch

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.conventions import GRAVITY, STATE, TACTILE
from lerobot_dexflex.hand.kinematics import (
    contact_torques,
    finger_frames,
    fingertips,
    leads,
    pads,
    solve_fingertips,
)
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface, ablated
from lerobot_dexflex.interfaces.dexgen import DexGenInterface

FEW = SelectionSettings(n_pure=2, n_seeded=2, n_finger=5)
pytestmark = pytest.mark.parametrize("hand", [LEAP, SHARPA], ids=lambda hand: hand.name)


def observed(hand, rows=2, load=1.0):
    """Half-closed hands, an arm of seven joints before them, whose fingers all carry a load [N]."""
    generator = torch.Generator().manual_seed(0)
    joints = torch.tensor(hand.nominal_joints, dtype=torch.float64).expand(rows, -1)
    joints = joints + 0.03 * torch.rand(joints.shape, generator=generator, dtype=torch.float64)
    arm = torch.zeros(rows, 7, dtype=torch.float64)
    taxels = torch.full((rows, hand.n_fingers * 60), load / 60)
    gravity = torch.tensor([0.0, 0.0, -1.0]).expand(rows, 3)
    return joints, {STATE: torch.cat([arm, joints], 1), TACTILE: taxels, GRAVITY: gravity}


def draft_of(hand, rows=2, size=0.001):
    generator = torch.Generator().manual_seed(1)
    return size * torch.randn(rows, 8, hand.n_fingers, 3, generator=generator, dtype=torch.float64)


def test_the_decoders_forces_lead_the_joints_of_every_finger_by_its_own_gains(controller_of, hand):
    controller, newtons = controller_of(hand.name), 1.5
    joints, seen = observed(hand, rows=1)
    inward = pads(hand, joints)[1]
    rotation = finger_frames(hand, joints).distal_rotation  # Forces are decoded in these frames.
    local = (rotation.mT @ (newtons * inward)[..., None]).squeeze(-1)
    with torch.no_grad():
        controller.decoder.out.weight.zero_()
        always = torch.full((hand.n_fingers, 1), 9.0)
        bias = torch.cat([local[0].float() / controller.decoder.scale, always], 1)
        controller.decoder.out.bias.copy_(bias.flatten())
    interface, draft = DexFlexInterface(hand, controller, ablated(FEW, "noselection")), draft_of(hand, 1)
    targets = interface.step(seen, draft)
    assert interface.explanation is not None
    torch.testing.assert_close(interface.explanation.forces, newtons * inward, rtol=0, atol=1e-6)
    posture = solve_fingertips(hand, fingertips(hand, joints) + draft[:, 0], joints)
    torques = contact_torques(hand, joints, pads(hand, joints)[0], newtons * inward)
    torch.testing.assert_close(targets, posture + leads(hand, torques), rtol=0, atol=1e-5)
    torch.testing.assert_close(interface.motion, draft[:, 0], rtol=0, atol=1e-12)
    grip = interface.explanation.row(0)["grip"]
    assert grip == pytest.approx(dict.fromkeys(hand.finger_names, newtons))


def test_a_chosen_chunk_is_executed_within_the_limits_and_explained_by_the_fingers_names(controller_of, hand):
    interface, (_, seen) = DexFlexInterface(hand, controller_of(hand.name), FEW), observed(hand)
    for k in range(3):
        interface.step({**seen, TACTILE: seen[TACTILE] + 1e-3 * k}, draft_of(hand))
    targets = interface.step(seen, draft_of(hand))
    assert targets.shape == (2, hand.n_joints)
    lower, upper = torch.tensor(hand.joint_lower), torch.tensor(hand.joint_upper)
    assert ((targets >= lower - 1e-9) & (targets <= upper + 1e-9)).all()
    assert interface.explanation is not None
    row = interface.explanation.row(0)
    assert list(row["slip"]) == list(row["touch_health"]) == list(hand.finger_names)
    assert set(row["touch_health"].values()) == {"ok"}


def test_free_fingers_follow_the_draft_below_dexgen_and_the_others_its_inverse_dynamics(controller_of, hand):
    """Dynamics that lead every joint by 0.1 rad tell whose finger it is."""
    controller = controller_of(hand.name)
    prior: Any = DiffusionPrior(controller.config).requires_grad_(False)
    prior.dynamics[-1].weight.zero_()
    prior.dynamics[-1].bias.fill_(1.0)
    joints, seen = observed(hand, rows=1)
    interface = DexGenInterface(hand, controller, prior)
    targets = interface.step(seen, draft_of(hand, 1))
    torch.testing.assert_close(targets, joints + 0.1, rtol=0, atol=1e-6)

    last = hand.n_fingers - 1
    inward = pads(hand, joints)[1]
    away = torch.zeros(1, 8, hand.n_fingers, 3, dtype=torch.float64)
    away[:, :, last] = -0.02 * inward[:, None, last]
    interface = DexGenInterface(hand, controller, prior)
    for k in range(9):  # It insists.
        interface.step({**seen, TACTILE: seen[TACTILE] + 1e-3 * k}, away)
    targets = interface.step({**seen, TACTILE: seen[TACTILE] + 0.1}, away)
    assert interface.explanation is not None
    assert interface.explanation.free[0].tolist() == [k == last for k in range(hand.n_fingers)]
    follows = ((targets - joints - 0.1).abs() > 1e-3)[0]
    own = hand.finger_joints[last]
    assert follows[own].any()
    assert not follows[: own.start].any()
