from typing import Any

import pytest
import torch
from interface_cases import TACTILE, observation
from learned_cases import draft_of, joints_of

from lerobot_dexflex.controller.diffusion_prior import LEAD_SCALE, DiffusionPrior
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import joint_limits
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.dexgen import DexGenInterface

JOINT_LOWER, JOINT_UPPER = joint_limits(LEAP)


SMALL = 0.001
"""Drafts within the six scales that the networks can express [m]."""


@pytest.fixture
def prior(controller):
    """A random prior whose inverse dynamics are linear in the chunk's first number: 0.2 leads per unit."""
    torch.manual_seed(1)
    prior: Any = DiffusionPrior(controller.config)
    first, seen = prior.dynamics[0], controller.config.body_width + controller.config.slow_width
    with torch.no_grad():
        for value in prior.dynamics.parameters():
            value.zero_()
        first.weight[0, seen], first.bias[0] = 1.0, 30.0  # SiLU is linear there.
        prior.dynamics[2].weight[0, 0] = 1.0
        prior.dynamics[4].weight[:, 0], prior.dynamics[4].bias[:] = 0.2, -6.0
    return prior


def test_with_overwhelming_guidance_the_drafts_motion_is_asked(make):
    interface = make("dexgen:1e9")
    for k in range(3):
        draft = draft_of(2, k, SMALL)
        interface.step(observation(2, k), draft)
        torch.testing.assert_close(interface.motion, draft[:, 0], rtol=0, atol=1e-5)
        assert interface.explanation.intervention.max() < 0.01


def test_without_guidance_the_draft_does_not_matter_but_the_state_does(make):
    targets = [
        make("dexgen:0").step(observation(2, state), draft_of(2, draft, SMALL))
        for state, draft in ((0, 1), (0, 2), (1, 1))
    ]
    assert torch.equal(targets[0], targets[1])
    assert not torch.equal(targets[0], targets[2])


@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_inverse_dynamics_lead_the_measured_joints_by_the_motion_that_is_asked(controller, prior, gain):
    interface, seen = DexGenInterface(LEAP, controller, prior, guidance=1e9), observation(2)
    interface.gain = gain
    draft = draft_of(2, size=SMALL)
    leads = interface.step(seen, draft) - joints_of(seen)
    first = draft[:, 0, 0, 0] / controller.scale.scale[0, 0]  # Of the index, along x, in its scale.
    expected = LEAD_SCALE * 0.2 * gain * first[:, None].expand(-1, 16)
    torch.testing.assert_close(leads, expected, rtol=0, atol=1e-4)
    torch.testing.assert_close(interface.motion, gain * draft[:, 0], rtol=0, atol=1e-5)


def test_targets_stay_within_the_joints_limits(controller, prior):
    with torch.no_grad():
        prior.dynamics[4].bias[:] = 1e3
    interface, seen = DexGenInterface(LEAP, controller, prior), observation(1)
    targets = [interface.step(seen, draft_of(1)) for _ in range(10)][-1]
    torch.testing.assert_close(targets[0], JOINT_UPPER.double())


def test_it_supplies_no_forces_and_chooses_among_no_candidates(make):
    interface = make("dexgen")
    interface.step(observation(2), draft_of(2))
    assert interface.explanation.forces is None
    assert interface.explanation.choice is None
    assert not {"grip", "branch"} & set(interface.explanation.row(0))


@pytest.mark.parametrize("use_touch", [True, False])
def test_touch_matters_exactly_if_it_is_used(make, use_touch):
    other = {**observation(2), TACTILE: observation(2, seed=9)[TACTILE]}
    motions = []
    for seen in (observation(2), other):
        interface = make(f"dexgen:use_touch={use_touch}")
        interface.step(seen, draft_of(2))
        motions.append(interface.motion)
    assert torch.equal(*motions) is not use_touch


def test_late_drafts_are_bridged_by_what_the_last_asked(make):
    """With overwhelming guidance the hand goes on to the places of the last draft."""
    interface, draft = make("dexgen:1e9"), draft_of(1, size=SMALL)
    for late in range(10):
        interface.step(observation(1), None if late else draft)
        torch.testing.assert_close(interface.motion, draft[:, min(late, 7)], rtol=0, atol=1e-5)


def test_it_runs_around_given_networks_and_asks_for_both(controller, prior):
    assert DexGenInterface(LEAP, controller, prior).step(observation(1), draft_of(1)).shape == (1, 16)
    with pytest.raises(DexFlexError, match="Give `prior` together with a controller object"):
        DexGenInterface(LEAP, controller)


@pytest.mark.parametrize("wrong", ["guidance=-1", "steps=0", "steps=51"])
def test_senseless_settings_are_refused(make, wrong):
    with pytest.raises(DexFlexError, match="must not be negative"):
        make(f"dexgen:{wrong}")
