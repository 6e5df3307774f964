"""What of a pressing source's draft commands into the object is taken out of it: our grip replaces it."""

import copy

import pytest
import torch
from learned_cases import draft_of, flex, joints_of, touched

from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.dexgen import DexGenInterface

SEEN = touched(1.0)
INWARD = pads(LEAP, joints_of(SEEN))[1][0]
SQUEEZE = torch.tensor([0.005, 0.0, 0.0, 0.0009])[:, None] * INWARD
"""The index finger presses by 5 mm, the thumb by a hair."""
TAKEN = SQUEEZE * torch.tensor([1.0, 0, 0, 0])[:, None]
"""What of it is taken for squeeze."""


def finding(controller, squeeze=SQUEEZE):
    """A controller that finds the same squeeze [m] (4, 3) in every draft."""
    found = copy.deepcopy(controller)
    with torch.no_grad():
        found.splitter.out.weight.zero_()
        found.splitter.out.bias.copy_((squeeze / found.splitter.scale).flatten())
    return found


def pressing_draft(seed=1):
    return draft_of(1, seed, size=0.0005) + SQUEEZE


def test_only_the_motion_of_a_pressing_draft_is_executed_and_remembered(controller):
    interface = flex(finding(controller), "noselection", use_splitter=True)
    for k in range(3):
        interface.step(SEEN, pressing_draft(k))
        motion = pressing_draft(k)[:, 0] - TAKEN
        torch.testing.assert_close(interface.motion, motion, rtol=0, atol=1e-9)
        remembered = interface._past.drafts[:, -1].double()
        torch.testing.assert_close(remembered, motion, rtol=0, atol=1e-8)
    row = interface.explanation.row(0)
    assert row["squeeze"] == pytest.approx({"index": 0.005, "middle": 0, "ring": 0, "thumb": 0}, abs=1e-8)
    assert row["intervention"] == pytest.approx(0, abs=1e-12)
    assert "the squeeze of index replaced" in interface.explanation.sentence(0)


def test_unless_told_to_split_all_of_a_draft_is_motion(controller):
    interface = flex(finding(controller), "noselection")
    interface.step(SEEN, pressing_draft())
    torch.testing.assert_close(interface.motion, pressing_draft()[:, 0], rtol=0, atol=1e-12)
    assert not interface.explanation.squeeze.any()


def test_dexgen_reads_drafts_alike(controller):
    prior = DiffusionPrior(controller.config)
    splitting = DexGenInterface(LEAP, finding(controller), prior, use_splitter=True)
    plain = DexGenInterface(LEAP, controller, prior)
    splitting.step(SEEN, pressing_draft())
    plain.step(SEEN, pressing_draft() - TAKEN)
    torch.testing.assert_close(splitting.motion, plain.motion, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("ablation", "squeezes"), [("noselection", False), ("notouch", True)])
def test_a_finger_that_does_not_touch_does_not_squeeze_unless_touch_is_hidden(controller, ablation, squeezes):
    alone = {"n_pure": 0, "n_seeded": 0, "n_finger": 0, "use_splitter": True}
    interface = flex(finding(controller), ablation, **alone)
    interface.step(touched([0.0, 1.0, 1.0, 1.0]), pressing_draft())
    motion = pressing_draft()[:, 0] - squeezes * TAKEN
    torch.testing.assert_close(interface.motion, motion, rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["the squeeze", "the draft"])
def test_what_leads_outward_is_no_squeeze(controller, side):
    """Neither of a finger that is to leave the object, nor what is found to pull it off."""
    interface = flex(finding(controller, -side * SQUEEZE), "noselection", use_splitter=True)
    draft = draft_of(1, size=0.0005) + side * SQUEEZE
    interface.step(SEEN, draft)
    torch.testing.assert_close(interface.motion, draft[:, 0], rtol=0, atol=1e-12)
