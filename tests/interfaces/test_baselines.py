import pytest
import torch
from interface_cases import STATE, TACTILE, drafts, observation

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.interfaces.clip import ClipInterface
from lerobot_dexflex.interfaces.filter import FilterInterface
from lerobot_dexflex.interfaces.gain import GainInterface
from lerobot_dexflex.interfaces.hold import HoldInterface
from lerobot_dexflex.interfaces.joint import JointInterface
from lerobot_dexflex.interfaces.raw import RawInterface
from lerobot_dexflex.interfaces.reflex import MEMORY, ReflexInterface
from lerobot_dexflex.interfaces.shrink import ShrinkInterface


def moved(interface, seen, draft):
    """Displacement of the commanded fingertips in one step."""
    before = interface.start(seen)
    interface.step(seen, draft)
    return interface.command - before


def touching(load, rows=1, seed=0):
    """Every finger's taxels sum to `load` newton."""
    return observation(rows, seed=seed) | {TACTILE: torch.full((rows, 240), load / 60)}


def test_hold_moves_nothing_and_refuses_what_raw_refuses():
    interface, seen = HoldInterface(), observation(2)
    assert torch.equal(moved(interface, seen, drafts("raw", 2)), torch.zeros(2, 4, 3, dtype=torch.float64))
    with pytest.raises(DexFlexError, match="NaN"):
        interface.step(seen, drafts("raw", 2) * torch.nan)


def test_shrink_executes_its_share_and_clip_bounds_each_axis():
    seen, draft = observation(1), torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    draft[:, 0, 1] = torch.tensor([0.004, -0.001, 0.0])
    shrunk, clipped = torch.zeros(2, 1, 4, 3, dtype=torch.float64)
    shrunk[0, 1] = torch.tensor([0.0012, -0.0003, 0.0])
    clipped[0, 1] = torch.tensor([0.002, -0.001, 0.0])
    torch.testing.assert_close(moved(ShrinkInterface(0.3), seen, draft), shrunk)
    torch.testing.assert_close(moved(ClipInterface(0.002), seen, draft), clipped)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("shrink:0", r"`gain` must be in \(0, 1\]"),
        ("shrink:1.1", r"`gain` must be in \(0, 1\]"),
        ("clip:0", "`limit` must be positive"),
        ("filter:smoothing=0", r"`smoothing` must be in \(0, 1\]"),
        ("filter:smoothing=1.5", r"`smoothing` must be in \(0, 1\]"),
        ("filter:clip=0", "`clip` must be positive"),
    ],
)
def test_senseless_strengths_are_refused(name, message):
    with pytest.raises(DexFlexError, match=message):
        make_interface(name)


def test_the_reflex_keeps_a_loaded_finger_pressed_when_the_draft_lifts_it():
    interface, seen = ReflexInterface(), touching(1.0)
    joints = seen[STATE][:, -16:]
    inward = pads(joints)[1]
    lift = (-0.003 * inward)[:, None].expand(-1, 8, -1, -1)
    displacement = moved(interface, seen, lift)
    # At 1 N the command is to lead the measured tip by 6 mm inward; it begins at the measured tip.
    torch.testing.assert_close(
        (displacement * inward).sum(-1), torch.full((1, 4), 0.006, dtype=torch.float64)
    )


def test_the_reflex_lets_a_finger_go_that_has_been_unloaded_for_long():
    interface, air, draft = ReflexInterface(), touching(0.0), torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    inward = pads(air[STATE][:, -16:])[1]
    interface.step(touching(1.0), draft)
    for _ in range(MEMORY - 1):
        interface.step(air, draft)
        assert interface.command is not None
        lead = ((interface.command - fingertips(air[STATE][:, -16:])) * inward).sum(-1)
        torch.testing.assert_close(lead, torch.full((1, 4), 0.01, dtype=torch.float64))  # 6 mm + 4 mm at 0 N
    wanted = torch.full((1, 8, 4, 3), 0.001, dtype=torch.float64)
    torch.testing.assert_close(moved(interface, air, wanted), wanted[:, 0])


def test_the_reflex_forgets_loads_with_a_reset_of_their_row():
    interface, draft = ReflexInterface(), torch.zeros(2, 8, 4, 3, dtype=torch.float64)
    interface.step(touching(1.0, rows=2), draft)
    interface.reset(torch.tensor([True, False]))
    displacement = moved(interface, touching(0.0, rows=2), draft)
    assert displacement[0].abs().max() == 0
    assert displacement[1].abs().max() > 0.001


def test_the_reflex_refuses_to_run_without_touch():
    seen = {STATE: observation(1)[STATE]}
    with pytest.raises(DexFlexError, match="needs touch"):
        ReflexInterface().step(seen, drafts("raw", 1))


@pytest.mark.parametrize("inner", [RawInterface, FilterInterface])
def test_a_gain_scales_the_displacement_of_the_inner_interface(inner):
    ours, theirs = GainInterface(inner(), 0.6), inner()
    for k in range(4):
        seen, draft = observation(2, seed=k), drafts("raw", 2, seed=k)
        torch.testing.assert_close(moved(ours, seen, draft), 0.6 * moved(theirs, seen, draft))


def test_raw_with_a_gain_is_shrink_to_the_last_joint():
    ours, shrink = GainInterface(RawInterface(), 0.5), ShrinkInterface(0.5)
    for k in range(4):
        seen, draft = observation(2, seed=k), drafts("raw", 2, seed=k)
        torch.testing.assert_close(ours.step(seen, draft), shrink.step(seen, draft))


@pytest.mark.parametrize("name", ["dexflex", "dexgen"])
def test_a_learned_interface_under_a_gain_goes_on_from_what_was_executed(make, name):
    inner = make(name)
    ours = GainInterface(inner, 0.5)
    for k in range(3):
        seen, draft = observation(2, seed=k), drafts(name, 2, seed=k)
        ours.step(seen, draft)
        assert torch.equal(inner.start(seen), ours.start(seen))
        assert ours.explanation is not None


def test_the_explanation_under_a_gain_tells_what_was_executed(make):
    ours = GainInterface(make("dexflex"), 1e-6)
    ours.step(observation(1), drafts("dexflex", 1))
    draft = drafts("dexflex", 1)[:, 0].flatten(1).norm(dim=1)
    assert ours.explanation is not None
    torch.testing.assert_close(ours.explanation.intervention, draft / (draft + 0.002), atol=1e-3, rtol=0)


def test_gains_that_make_no_sense_are_refused():
    with pytest.raises(DexFlexError, match="must be in"):
        GainInterface(RawInterface(), 0)
    with pytest.raises(DexFlexError, match="joint targets"):
        GainInterface(JointInterface(), 0.5)
