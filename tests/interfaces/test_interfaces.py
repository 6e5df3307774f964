import subprocess
import sys

import pytest
import torch
from interface_cases import LEARNED, METHODS, STATE, TACTILE, drafts, hand_poses, observation, row

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.interfaces import Method
from lerobot_dexflex.interfaces.filter import FilterInterface
from lerobot_dexflex.interfaces.joint import JointInterface
from lerobot_dexflex.interfaces.raw import RawInterface

TOLERANCE = {name: 2e-5 if name in LEARNED else 0.0 for name in METHODS} | {"reflex": 1e-12}
"""What a row may differ by in another batch [rad]: networks, and torch where `reflex` sums taxels, may add up
in another order there. What is computed element by element or by `hand.kernels` cannot."""


def test_joint_returns_the_first_targets_and_knows_where_they_put_the_fingertips():
    interface, draft = JointInterface(), drafts("joint", 2)
    assert torch.equal(interface.step(observation(2), draft), draft[:, 0])
    torch.testing.assert_close(interface.command, fingertips(draft[:, 0]))


@pytest.mark.parametrize("arm", [0, 7])
def test_raw_moves_the_commanded_fingertips_by_exactly_the_first_displacement(arm):
    interface, draft = RawInterface(), drafts("raw", 3)
    measured = observation(3, arm=arm)[STATE][:, -16:]
    joints = interface.step(observation(3, arm=arm), draft)
    wanted = fingertips(measured) + draft[:, 0]
    torch.testing.assert_close(interface.command, wanted)
    torch.testing.assert_close(joints, solve_fingertips(wanted, measured))


def test_raw_ties_the_posture_to_the_previous_command_and_not_to_the_measured_hand():
    interface, draft = RawInterface(), drafts("raw", 1)
    first = interface.step(observation(1), draft)
    second = interface.step(observation(1, seed=5), draft)
    expected = solve_fingertips(fingertips(observation(1)[STATE][:, -16:]) + 2 * draft[:, 0], first)
    torch.testing.assert_close(second, expected)


def test_raw_replays_recorded_commanded_fingertips_to_the_recorded_joints():
    joints, interface = hand_poses(1), RawInterface()
    start = {STATE: joints}
    recorded, command = [], fingertips(joints)
    steps = drafts("raw", 20, size=0.003)[:, :1]
    for k in range(20):
        command = command + steps[k]
        joints = solve_fingertips(command, joints)
        recorded.append(joints)
    replayed = [interface.step(start, steps[k : k + 1]) for k in range(20)]
    torch.testing.assert_close(torch.stack(replayed), torch.stack(recorded), rtol=0, atol=1e-9)


def test_filter_averages_with_its_weight_and_then_clips_each_axis():
    interface = FilterInterface(smoothing=0.25, clip=0.002)
    start = fingertips(observation(1)[STATE][:, -16:])
    first, second = torch.zeros(2, 1, DRAFT_HORIZON, 4, 3, dtype=torch.float64)
    first[..., 0], second[..., 0], second[..., 1] = 0.001, 0.005, -0.020
    interface.step(observation(1), first)
    interface.step(observation(1), second)
    # Averages after the second step: x 0.75 * 1 + 0.25 * 5 = 2 mm, y 0.25 * -20 = -5 mm, clipped to -2 mm.
    moved = torch.tensor([0.001 + 0.002, -0.002, 0.0], dtype=torch.float64).expand(1, 4, 3)
    assert interface.command is not None
    torch.testing.assert_close(interface.command - start, moved)


def test_filter_without_smoothing_and_clip_is_raw():
    ours, raw, draft = FilterInterface(smoothing=1, clip=1), RawInterface(), drafts("raw", 2)
    for k in range(3):
        assert torch.equal(ours.step(observation(2, k), draft), raw.step(observation(2, k), draft))


@pytest.mark.parametrize("name", METHODS)
def test_a_batch_does_what_its_rows_do_alone(make, name):
    together, alone = make(name), [make(name) for _ in range(3)]
    for k in range(4):
        seen, draft = observation(3, seed=k), drafts(name, 3, seed=10 + k)
        rows = [alone[i].step(row(seen, i), draft[i : i + 1]) for i in range(3)]
        torch.testing.assert_close(together.step(seen, draft), torch.cat(rows), rtol=0, atol=TOLERANCE[name])


@pytest.mark.parametrize("name", METHODS)
def test_resetting_a_row_restarts_that_row_only(make, name):
    ours, untouched, restarted = (make(name) for _ in range(3))
    for interface in (ours, untouched):
        interface.step(observation(2), drafts(name, 2))
    ours.reset(torch.tensor([False, True]))
    seen, draft = observation(2, seed=3), drafts(name, 2, seed=4)
    result = ours.step(seen, draft)
    near = {"rtol": 0, "atol": TOLERANCE[name]}
    torch.testing.assert_close(result[0], untouched.step(seen, draft)[0], **near)
    torch.testing.assert_close(result[1], restarted.step(seen, draft)[1], **near)
    assert ours.command is not None
    assert restarted.command is not None
    torch.testing.assert_close(ours.command[1], restarted.command[1], **near)


@pytest.mark.parametrize("name", METHODS)
def test_the_command_begins_at_the_measured_hand_and_is_unknown_before(make, name):
    interface = make(name)
    assert interface.command is None
    torch.testing.assert_close(interface.start(observation(2)), fingertips(observation(2)[STATE][:, -16:]))
    interface.step(observation(2), drafts(name, 2))
    interface.reset()
    assert interface.command is None


@pytest.mark.parametrize("name", METHODS)
def test_rows_that_were_just_reset_begin_at_the_initial_command_and_others_ignore_it(make, name):
    interface, initial = make(name), hand_poses(2, seed=8)
    torch.testing.assert_close(interface.start(observation(2), initial), fingertips(initial))
    interface.step(observation(2), drafts(name, 2))
    interface.reset(torch.tensor([True, False]))
    before, other = interface.command, hand_poses(2, seed=9)
    assert before is not None
    command = interface.start(observation(2), other)
    torch.testing.assert_close(command[0], fingertips(other)[0])
    assert torch.equal(command[1], before[1])
    assert torch.equal(interface.start(observation(2), initial), command)


def test_a_step_after_start_moves_on_from_the_initial_command():
    interface, initial, draft = RawInterface(), hand_poses(2, seed=8), drafts("raw", 2)
    interface.start(observation(2), initial)
    wanted = solve_fingertips(fingertips(initial) + draft[:, 0], initial)
    torch.testing.assert_close(interface.step(observation(2), draft), wanted)


def test_an_initial_command_of_wrong_shape_or_with_nan_is_refused():
    interface = RawInterface()
    with pytest.raises(DexFlexError, match=r"`initial` must be a joint command .*\(2, 16\). Got \(1, 16\)"):
        interface.start(observation(2), hand_poses(1))
    with pytest.raises(DexFlexError, match=r"`initial` holds NaN or infinity in rows \[1\]"):
        interface.start(observation(2), hand_poses(2).index_fill(0, torch.tensor([1]), torch.nan))
    assert interface.command is None


def test_a_held_object_stays_in_the_hand_only_if_the_command_begins_at_the_squeeze():
    env = ReachEnv(cameras=())
    first, _ = env.reset(seed=3)
    start, squeeze = env.snapshot(), torch.as_tensor(env.command)[None]
    still = torch.zeros(1, DRAFT_HORIZON, 4, 3, dtype=torch.float64)
    dropped = []
    for initial in (squeeze, None):
        env.restore(start)
        interface, seen, info = RawInterface(), first, {}
        for _ in range(30):
            observed = {STATE: torch.as_tensor(seen["agent_pos"])[None]}
            interface.start(observed, initial)
            seen, _, _, _, info = env.step(interface.step(observed, still)[0].numpy())
        dropped.append(info["dropped"])
    assert dropped == [False, True]


@pytest.mark.parametrize("name", METHODS)
def test_targets_keep_the_dtype_and_work_across_inference_mode(make, name):
    interface, draft = make(name), drafts(name, 2).float()
    with torch.inference_mode():
        assert interface.step(observation(2), draft).dtype == torch.float32
    interface.reset(torch.tensor([True, False]))
    interface.step(observation(2), draft)


@pytest.mark.parametrize("name", METHODS)
def test_bad_input_is_refused_and_leaves_the_command_alone(make, name):
    interface, draft = make(name), drafts(name, 2)
    interface.step(observation(2), draft)
    before = interface.command
    assert before is not None
    broken = draft.clone()
    broken[1, 0] = torch.nan
    blind = observation(2)
    blind[STATE][0, -1] = torch.inf
    cases = [
        (observation(2), broken, r"NaN or infinity in rows \[1\]"),
        (blind, draft, r"'observation.state' holds NaN or infinity in rows \[0\]"),
        ({}, draft, "lacks 'observation.state'"),
        ({STATE: torch.zeros(2, 12)}, draft, r"shape \(batch, >= 16\)"),
        (observation(2), draft[:, 0], "A draft must have shape"),
        (observation(2), draft[:1], "A draft must have shape"),
        (observation(3), drafts(name, 3), "from 2 to 3 hands without a reset"),
    ]
    for seen, bad, message in cases:
        with pytest.raises(DexFlexError, match=message):
            interface.step(seen, bad)
    assert interface.command is before
    with pytest.raises(DexFlexError, match="one bool per row"):
        interface.reset(torch.tensor([True]))


@pytest.mark.parametrize("name", METHODS)
def test_the_registry_tells_the_truth_about_the_interface(make, name):
    assert (make(name).name, make(name).command_space) == (name, Method.parse(name).command_space)


def test_importing_the_interfaces_imports_no_networks():
    code = "import sys, lerobot_dexflex.interfaces; print('lerobot_dexflex.controller' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"


def test_a_gain_scales_what_an_interface_displaces(make):
    state, draft = observation(2), drafts("raw", 2)
    whole, part = make("filter"), make("filter@0.4")
    assert part.name == "filter@0.4"
    moved = []
    for interface in (whole, part):
        start = interface.start(state)
        interface.step(state, draft)
        assert interface.command is not None
        moved.append(interface.command - start)
    torch.testing.assert_close(moved[1], 0.4 * moved[0])


def test_without_touch_nothing_depends_on_it(make):
    state, draft = observation(2), drafts("raw", 2)
    numb = {**state, TACTILE: 5 * state[TACTILE]}
    for name, same in (("dexflex", False), ("dexflex-notouch", True)):
        targets = [make(name).step(seen, draft) for seen in (state, numb)]
        assert torch.equal(*targets) == same, name
