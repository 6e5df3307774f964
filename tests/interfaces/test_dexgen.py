import pytest
import torch
from interface_cases import STATE, TACTILE, drafts, observation

from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.interfaces.dexgen import DexGenInterface
from lerobot_dexflex.interfaces.raw import RawInterface


def draft_of(rows, seed=1):
    """Drafts within the six scales that the networks can express."""
    return drafts("dexgen", rows, seed, size=0.001).float()


def test_with_overwhelming_guidance_it_is_raw(make):
    interface, raw = make("dexgen:1e9"), RawInterface()
    for k in range(3):
        seen, draft = observation(2, k), draft_of(2, k)
        torch.testing.assert_close(interface.step(seen, draft), raw.step(seen, draft), rtol=0, atol=1e-4)


def test_without_guidance_the_draft_does_not_matter_but_the_state_does(make):
    targets = [
        make("dexgen:0").step(observation(2, state), draft_of(2, draft))
        for state, draft in ((0, 1), (0, 2), (1, 1))
    ]
    assert torch.equal(targets[0], targets[1])
    assert not torch.equal(targets[0], targets[2])


def test_it_moves_the_command_by_the_sample_and_takes_the_joints_from_the_executor(make):
    interface, seen = make("dexgen"), observation(1)
    joints = interface.step(seen, draft_of(1).double())
    measured = seen[STATE][:, -16:]
    assert not torch.equal(interface.command, fingertips(measured) + draft_of(1)[:, 0])
    assert torch.equal(joints, solve_fingertips(interface.command, measured))


def test_the_output_gain_scales_what_is_executed(make):
    moves = []
    for gain in (1.0, 0.5):
        interface, seen = make(f"dexgen:output_gain={gain}"), observation(1)
        start = interface.start(seen)
        interface.step(seen, draft_of(1))
        moves.append(interface.command - start)
    torch.testing.assert_close(moves[1], 0.5 * moves[0])


@pytest.mark.parametrize("use_touch", [True, False])
def test_touch_matters_exactly_if_it_is_used(make, use_touch):
    other = {**observation(2), TACTILE: observation(2, seed=9)[TACTILE]}
    targets = [
        make(f"dexgen:use_touch={use_touch}").step(seen, draft_of(2)) for seen in (observation(2), other)
    ]
    assert torch.equal(*targets) is not use_touch


def test_it_runs_around_given_networks_and_asks_for_both(controller):
    prior = DiffusionPrior(controller.config)
    assert DexGenInterface(controller, prior).step(observation(1), draft_of(1)).shape == (1, 16)
    with pytest.raises(DexFlexError, match="Give `prior` together with a controller object"):
        DexGenInterface(controller)


@pytest.mark.parametrize("wrong", ["guidance=-1", "steps=0", "steps=51", "output_gain=-0.5"])
def test_senseless_settings_are_refused(make, wrong):
    with pytest.raises(DexFlexError, match="must not be negative"):
        make(f"dexgen:{wrong}")
