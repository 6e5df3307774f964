"""What every interface promises: rows alone, resets by row, refusals that leave nothing behind."""

import itertools
import subprocess
import sys

import pytest
import torch
from interface_cases import METHODS, STATE, TACTILE, drafts, memory, observation, row, taxels_of

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import HANDS
from lerobot_dexflex.interfaces import Method, make_interface
from lerobot_dexflex.interfaces.commanded_hand import CommandedHand


@pytest.fixture(params=HANDS.values(), ids=list(HANDS))
def hand(request):
    return request.param


def episode(hand, name, rows, steps=6):
    """Yield observations and drafts of a batch of hands."""
    for k in range(steps):
        yield observation(rows, seed=k, hand=hand), drafts(name, rows, seed=10 + k, size=0.004, hand=hand)


@pytest.mark.parametrize("rows", [3, 17])
@pytest.mark.parametrize("name", METHODS)
def test_a_batch_does_what_its_rows_do_alone_to_the_last_bit(hand, name, rows):
    together, alone = make_interface(hand, name), [make_interface(hand, name) for _ in range(rows)]
    for k, (seen, draft) in enumerate(episode(hand, name, rows)):
        if k == 3:
            mask = torch.arange(rows) % 2 == 0
            together.reset(mask)
            for single, again in zip(alone, mask, strict=True):
                single.reset(again[None])
        whole = together.step(seen, draft)
        for i, single in enumerate(alone):
            assert torch.equal(single.step(row(seen, i), draft[i : i + 1])[0], whole[i])
            assert single.motion is not None
            assert together.motion is not None
            assert torch.equal(single.motion[0], together.motion[i])


@pytest.mark.parametrize("name", METHODS)
def test_resetting_a_row_restarts_that_row_only(hand, name):
    ours, untouched, restarted = (make_interface(hand, name) for _ in range(3))
    steps = list(episode(hand, name, 2))
    for interface, (seen, draft) in itertools.product((ours, untouched), steps[:3]):
        interface.step(seen, draft)
    ours.reset(torch.tensor([False, True]))
    for seen, draft in steps[3:]:
        result = ours.step(seen, draft)
        assert torch.equal(result[0], untouched.step(seen, draft)[0])
        assert torch.equal(result[1], restarted.step(seen, draft)[1])


@pytest.mark.parametrize("name", METHODS)
def test_a_reset_of_all_forgets_everything_and_the_batch_may_change(hand, name):
    ours, fresh = make_interface(hand, name), make_interface(hand, name)
    for seen, draft in episode(hand, name, 2, steps=3):
        ours.step(seen, draft)
    ours.reset()
    for seen, draft in episode(hand, name, 5, steps=3):
        assert torch.equal(ours.step(seen, draft), fresh.step(seen, draft))


@pytest.mark.parametrize("name", METHODS)
def test_there_is_no_motion_before_the_first_step(hand, name):
    interface = make_interface(hand, name)
    assert interface.motion is None
    interface.step(observation(2, hand=hand), drafts(name, 2, hand=hand))
    assert interface.motion is not None
    assert interface.motion.shape == (2, hand.n_fingers, 3)


@pytest.mark.parametrize("name", METHODS)
def test_targets_keep_the_dtype_and_work_across_inference_mode(hand, name):
    interface, draft = make_interface(hand, name), drafts(name, 2, hand=hand).float()
    with torch.inference_mode():
        assert interface.step(observation(2, hand=hand), draft).dtype == torch.float32
    interface.reset(torch.tensor([True, False]))
    interface.step(observation(2, hand=hand), draft)


BROKEN = {
    "draft with NaN": (lambda seen, draft: (seen, draft * torch.nan), r"draft holds NaN .* rows \[0, 1\]"),
    "draft without a horizon": (lambda seen, draft: (seen, draft[:, 0]), "A draft must have shape"),
    "draft of one row": (lambda seen, draft: (seen, draft[:1]), "A draft must have shape"),
    "encoder with infinity": (
        lambda seen, draft: ({**seen, STATE: seen[STATE] / 0.0}, draft),
        r"'observation.state' holds NaN or infinity in rows \[0, 1\]",
    ),
    "no encoder": (lambda seen, draft: ({TACTILE: seen[TACTILE]}, draft), "lacks 'observation.state'"),
    "few joints": (
        lambda seen, draft: ({**seen, STATE: seen[STATE][:, :12]}, draft),
        r"\(batch, >= (16|22)\)",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
@pytest.mark.parametrize("name", METHODS)
def test_a_refused_step_leaves_nothing_behind(hand, name, case):
    spoil, message = BROKEN[case]
    assert_refused(hand, name, message, *spoil(observation(2, seed=9, hand=hand), drafts(name, 2, hand=hand)))


@pytest.mark.parametrize("name", METHODS)
def test_a_step_whose_command_is_refused_at_last_leaves_nothing_behind(hand, name, monkeypatch):
    def refuse(commanded, joints, posture=None):
        raise DexFlexError("no such command")

    execute = CommandedHand.execute
    for before in (0, 3):
        monkeypatch.setattr(CommandedHand, "execute", execute)
        interface = stepped(hand, name, before)
        monkeypatch.setattr(CommandedHand, "execute", refuse)
        assert_forgotten(
            interface, "no such command", observation(2, seed=9, hand=hand), drafts(name, 2, hand=hand)
        )


def stepped(hand, name, steps):
    """Return an interface after so many steps."""
    interface = make_interface(hand, name)
    for seen, draft in episode(hand, name, 2, steps):
        interface.step(seen, draft)
    return interface


def assert_refused(hand, name, message, seen, draft):
    """A step is refused and forgotten, as the first of an episode and later."""
    for before in (0, 3):
        assert_forgotten(stepped(hand, name, before), message, seen, draft)


def assert_forgotten(interface, message, seen, draft):
    before = memory(interface)
    with pytest.raises(DexFlexError, match=message):
        interface.step(seen, draft)
    after = memory(interface)
    assert after.keys() == before.keys()
    assert [key for key in after if after[key] is not before[key]] == []


@pytest.mark.parametrize("name", METHODS)
def test_another_batch_or_a_mask_of_another_size_is_refused(hand, name):
    interface = make_interface(hand, name)
    interface.step(observation(2, hand=hand), drafts(name, 2, hand=hand))
    with pytest.raises(DexFlexError, match="from 2 to 3 hands without a reset"):
        interface.step(observation(3, hand=hand), drafts(name, 3, hand=hand))
    with pytest.raises(DexFlexError, match="one bool per row"):
        interface.reset(torch.tensor([True]))


@pytest.mark.parametrize("name", [name for name in METHODS if name.startswith("p")])
def test_touch_of_another_shape_is_refused(hand, name):
    seen = observation(2, hand=hand) | {TACTILE: torch.zeros(2, 60)}
    message = (
        rf"'observation.tactile' must have shape \(2, {taxels_of(hand)}\): 10 x 6 taxels .* '{hand.name}'"
    )
    assert_refused(hand, name, message, seen, drafts(name, 2, hand=hand))


@pytest.mark.parametrize("name", METHODS)
def test_the_registry_tells_the_truth_about_the_interface(hand, name):
    made = make_interface(hand, name)
    assert (made.name, made.command_space) == (name, Method.parse(name).command_space)


def test_importing_interfaces_and_the_loop_imports_no_networks():
    code = (
        "import sys, lerobot_dexflex.interfaces; print('mujoco' in sys.modules);"
        "from lerobot_dexflex.interfaces import make_interface as make;"
        "from lerobot_dexflex.hands import LEAP; make(LEAP, 'press'); make(LEAP, 'projection');"
        "import lerobot_dexflex.commands.loop; print('lerobot_dexflex.controller' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False", "False"]
