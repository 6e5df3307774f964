"""Several hands of one controller: slots by the fingers' roles, in a frame in which hands are alike."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig, DexFlexController, HistoryBuffer, SelectionSettings
from lerobot_dexflex.controller.layout import SharedLayout, layout_of
from lerobot_dexflex.controller.view import View
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import finger_frames, fingertips
from lerobot_dexflex.hands import LEAP, SHARPA

ORDER = (3, 0, 2, 1)
"""Of the fingers of a hand that is LEAP but for the order in which it counts them."""
JOINTS = np.concatenate([np.arange(4 * k, 4 * k + 4) for k in ORDER])


@pytest.fixture(scope="module")
def reordered():
    def sorted_joints(values):
        return tuple(np.array(values)[JOINTS].tolist())

    postures = ("relaxed", "nominal", "idle", "open", "loose")
    return replace(
        LEAP,
        name="reordered",
        fingers=tuple(LEAP.fingers[k] for k in ORDER),
        **{f"{name}_joints": sorted_joints(getattr(LEAP, f"{name}_joints")) for name in postures},
    )


def history_of(hand, joints, touch):
    """Return the history of a hand that has just been looked at."""
    observation = {
        "observation.state": joints,
        "observation.fingertips": fingertips(hand, joints).flatten(1),
        "observation.gravity": torch.tensor([[0.6, 0.0, -0.8]]).expand(len(joints), -1),
        "observation.tactile": touch.flatten(1),
    }
    return HistoryBuffer(hand).observe(observation)


def felt(hand, rows=2):
    generator = torch.Generator().manual_seed(0)
    joints = torch.tensor(hand.nominal_joints).expand(rows, -1)
    joints = (joints + 0.1 * torch.randn(joints.shape, generator=generator)).float()
    return joints, 0.2 * torch.rand(rows, hand.n_fingers, *hand.taxels, generator=generator)


def test_fingers_meet_in_slots_by_their_roles():
    layout = SharedLayout(LEAP, SHARPA)
    slots = {
        hand.name: dict(zip(hand.finger_names, layout.slots(hand).tolist(), strict=True))
        for hand in (LEAP, SHARPA)
    }
    assert slots["sharpa"] == {"index": 0, "middle": 1, "ring": 2, "pinky": 3, "thumb": 4}
    assert slots["leap"] == {"index": 0, "middle": 1, "ring": 2, "thumb": 4}
    there = layout.geometry(LEAP)[:, 0]
    assert there.tolist() == [1, 1, 1, 0, 1]
    joints = layout.geometry(SHARPA)[:, 7:].reshape(5, 5, 4)[:, :, 0].sum(1)
    assert joints.tolist() == [4, 4, 4, 5, 5]


def test_the_geometry_tells_how_each_joint_moves_the_tip():
    layout, step = SharedLayout(LEAP, SHARPA), 1e-6
    view, nominal = View(layout, SHARPA), torch.tensor([SHARPA.nominal_joints], dtype=torch.float64)
    told = layout.geometry(SHARPA)[:, 7:].reshape(5, 5, 4)
    for joint, slot in enumerate(layout.joint_slots(SHARPA)):
        moved = nominal.clone()
        moved[0, joint] += step
        speed = (view.points(fingertips(SHARPA, moved)) - view.points(fingertips(SHARPA, nominal)))[0] / step
        finger = slot // 5
        np.testing.assert_allclose(0.1 * told[finger, slot % 5, 1:], speed[finger].numpy(), atol=1e-5)


def test_the_order_in_which_a_hand_counts_its_fingers_is_not_seen(reordered):
    layout = SharedLayout(LEAP, SHARPA, reordered)
    joints, touch = felt(LEAP)
    one = View(layout, LEAP).history(history_of(LEAP, joints, touch))
    other = View(layout, reordered).history(history_of(reordered, joints[:, JOINTS], touch[:, list(ORDER)]))
    for name, a, b in zip(one._fields, one, other, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-5, msg=name)


@pytest.mark.parametrize("hand", [LEAP, SHARPA], ids=lambda hand: hand.name)
def test_what_goes_into_the_layout_comes_back(hand):
    layout = SharedLayout(LEAP, SHARPA)
    view, (joints, _) = View(layout, hand), felt(hand)
    motion = torch.randn(2, 8, hand.n_fingers, 3, dtype=torch.float64)
    assert view.vectors(motion).shape == (2, 8, 5, 3)
    torch.testing.assert_close(view.own_vectors(view.vectors(motion)), motion)
    # A force in the frame of its pad is the same force in that of its distal link.
    rotation = finger_frames(hand, joints).distal_rotation
    force = torch.randn(2, hand.n_fingers, 3)
    local = (view.rotations(rotation).mT @ view.vectors(force)[..., None]).squeeze(-1)
    torch.testing.assert_close((rotation @ view.own_local(local)[..., None]).squeeze(-1), force)


def test_one_controller_serves_both_hands_with_the_same_weights():
    torch.manual_seed(0)
    controller = DexFlexController(ControllerConfig(hand="leap+sharpa")).eval().requires_grad_(False)
    settings = SelectionSettings(2, 2, 2)
    for hand in (LEAP, SHARPA):
        served = controller.serving(hand)
        assert served.encoder is controller.encoder
        state = served.encode(history_of(hand, *felt(hand)))
        draft = 0.001 * torch.randn(2, 8, hand.n_fingers, 3)
        selection = served.select(state, draft, torch.zeros(2, 8, hand.n_fingers, 3), settings)
        assert selection.candidates.chunks.shape == (2, 6, 8, hand.n_fingers, 3)
        assert selection.dream.slip.shape == (2, 6, hand.n_fingers)
        assert served.decode(state, selection.chunk).grip().shape == (2, hand.n_fingers, 3)
        assert served.squeeze(state, draft).shape == (2, hand.n_fingers, 3)


def test_a_controller_of_one_hand_serves_it_as_it_is(reordered):
    controller = DexFlexController(ControllerConfig(hand="sharpa"))
    assert controller.serving(SHARPA) is controller
    with pytest.raises(DexFlexError, match="was trained for 'sharpa', but the robot is 'leap'"):
        controller.serving(LEAP)
    with pytest.raises(DexFlexError, match=r"was trained for 'leap\+sharpa', but the robot is 'reordered'"):
        ControllerConfig(hand="leap+sharpa").check(reordered)


def test_hands_that_cannot_share_a_controller_are_refused():
    with pytest.raises(DexFlexError, match="several once each"):
        layout_of("leap+leap")
    with pytest.raises(DexFlexError, match=r"as many taxels. Got 'leap' \(10, 6\), 'coarse' \(5, 3\)"):
        SharedLayout(LEAP, replace(SHARPA, name="coarse", taxels=(5, 3)))
