"""Errors on their way to an interface: drafts and planned joints, on any device."""

import numpy as np
import pytest
import torch
from elsewhere import ELSEWHERE, Elsewhere, moved

from lerobot_dexflex.commands.disturbed import DisturbedInterface
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.human import HumanErrors
from lerobot_dexflex.commands.levels import LEVELS
from lerobot_dexflex.commands.stream import ErrorStream, seeds_of
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads
from lerobot_dexflex.hands import LEAP, SHARPA, Hand
from lerobot_dexflex.interfaces import CommandSpace
from lerobot_dexflex.interfaces.method import make_interface

JOINTS = torch.full((1, 16), 0.6, dtype=torch.float64)
TIPS = fingertips(LEAP, JOINTS)
THUMB, SEED = 3, 5
LOADS = [1.0, 1.0, 1.0, 5.0]
REMOVAL = CommandErrors.of(removal=0.002)


class Listener:
    """An interface that remembers the drafts it gets and never moves."""

    name: str = "listener"
    motion: torch.Tensor | None = None

    def __init__(self, command_space: CommandSpace = "draft", hand: Hand = LEAP):
        self.command_space: CommandSpace = command_space
        self.hand = hand
        self.drafts = []

    def reset(self, mask=None):
        self.drafts = []

    def step(self, observation, draft):
        self.drafts.append(draft)
        return draft[:, 0].flatten(1)


def observation(loads, rows=1, joints=JOINTS):
    """Return a hand that feels `loads` [N] per finger."""
    taxels = torch.zeros(rows, 4, 60)
    taxels[..., 30] = torch.tensor(loads)
    return {
        "observation.state": torch.cat([torch.zeros(rows, 7), joints.expand(rows, -1)], 1),
        "observation.tactile": taxels.flatten(1),
    }


def event_steps(errors, seed, steps):
    """Return in which steps events go on in the stream of this seed."""
    stream = ErrorStream(LEAP, 1)
    stream.begin(0, errors, seeds_of(errors, seed))
    found = []
    for _ in range(steps):
        stream.step(torch.zeros(1, 1, 4, 3), torch.zeros(1, 4, 3), torch.tensor([LOADS]), torch.ones(1, 4, 3))
        found.append(bool(stream.in_event[0]))
    return found


def heard(errors, drafts, loads=LOADS, command_space: CommandSpace = "draft", held=False):
    """Return the drafts that arrive."""
    inner = Listener(command_space)
    disturbed = DisturbedInterface(inner, errors, held)
    disturbed.begin([SEED])
    for draft in drafts:
        disturbed.step(observation(loads), draft)
    return inner.drafts


def test_the_most_loaded_finger_leaves_from_where_it_is_felt_and_the_others_follow_the_draft():
    draft = torch.full((1, 8, 4, 3), 0.0005)
    drafts = heard(REMOVAL, [draft] * 60)
    changed = [not torch.equal(seen, draft) for seen in drafts]
    assert changed == event_steps(REMOVAL, SEED, 60)
    assert 8 <= sum(changed) <= 24
    first = changed.index(True)
    inward = pads(LEAP, JOINTS)[1][0, THUMB]
    for k in range(8):
        seen = drafts[first + k][0]
        assert torch.equal(seen[:, :THUMB], draft[0, :, :THUMB])
        for ahead in (0, 5):  # 2 mm more in every step.
            expected = -0.002 * (k + 1 + ahead) * inward
            torch.testing.assert_close(seen[ahead, THUMB].double(), expected, atol=1e-6, rtol=0)
    assert torch.equal(drafts[first + 8], draft)
    assert torch.equal(draft, torch.full((1, 8, 4, 3), 0.0005))


def test_a_hand_that_holds_nothing_is_left_alone():
    draft = torch.full((1, 8, 4, 3), 0.0005)
    drafts = heard(REMOVAL, [draft] * 60, loads=[0.0] * 4)
    assert len(drafts) == 60
    assert all(torch.equal(seen, draft) for seen in drafts)


def test_planned_joints_are_those_of_a_finger_that_leaves():
    draft = JOINTS.view(1, 1, 16).repeat(1, 8, 1)
    drafts = heard(REMOVAL, [draft] * 30, command_space="joint")
    changed = event_steps(REMOVAL, SEED, 30)
    seen = drafts[changed.index(True) + 3][0, 0]
    assert torch.equal(seen[:12], JOINTS[0, :12])
    leaving = (fingertips(LEAP, seen[None]) - TIPS)[0, THUMB]
    outward = -pads(LEAP, JOINTS)[1][0, THUMB]
    assert leaving @ outward == pytest.approx(4 * 0.002, rel=0.3)  # The posture tie leaves some out.


def test_noise_is_that_of_positions_and_follows_the_step_for_which_they_are_planned():
    draft = torch.full((1, 8, 4, 3), 0.0005, dtype=torch.float64)
    first, second = (d[0] - draft[0] for d in heard(CommandErrors.of(noise=0.004), [draft] * 2))
    assert 0.002 < first.abs().max() <= 0.004 + 1e-12
    torch.testing.assert_close(first[1:], second[:-1], atol=1e-15, rtol=0)
    held = heard(CommandErrors.of(noise=0.004), [draft], held=True)[0][0] - draft[0]
    torch.testing.assert_close(held, held[:1].expand_as(held), atol=1e-15, rtol=0)


def test_noise_moves_the_fingertips_of_planned_joints_as_those_of_drafts():
    errors = CommandErrors.of(noise=0.004)
    plan = JOINTS.view(1, 1, 16).repeat(1, 8, 1)
    [joints] = heard(errors, [plan], command_space="joint")
    [draft] = heard(errors, [torch.zeros(1, 8, 4, 3, dtype=torch.float64)])
    asked, got = draft[0].flatten(), (fingertips(LEAP, joints[0]) - TIPS).flatten()
    # The tie to the posture leaves some of it out, as it does under `raw` in every step.
    assert 0.5 < (got @ asked) / (asked @ asked) < 1
    assert torch.corrcoef(torch.stack([asked, got]))[0, 1] > 0.8


def test_a_late_draft_leads_to_old_places_wherever_the_hand_is_by_now():
    inner = Listener()
    disturbed = DisturbedInterface(inner, CommandErrors.of(delay=2))
    disturbed.begin([SEED])
    goals, here = [TIPS + 0.001 * (k + 1) for k in range(6)], []
    for k, goal in enumerate(goals):
        state = observation(LOADS, joints=JOINTS + 0.02 * k)
        here.append(fingertips(LEAP, JOINTS + 0.02 * k))
        disturbed.step(state, (goal - here[k])[:, None].expand(-1, 8, -1, -1))
    for k, draft in enumerate(inner.drafts):
        expected = (goals[max(k - 2, 0)] - here[k])[:, None].expand(-1, 8, -1, -1)
        torch.testing.assert_close(draft, expected, atol=1e-6, rtol=0)


def test_late_joints_are_old_joints():
    plans = [JOINTS.view(1, 1, 16).repeat(1, 8, 1) + 0.01 * k for k in range(5)]
    drafts = heard(CommandErrors.of(delay=2), plans, command_space="joint")
    assert all(torch.equal(seen, plans[max(k - 2, 0)]) for k, seen in enumerate(drafts))


@pytest.mark.parametrize(("name", "fingers"), [("freeze", {0, 1, 2, 3}), ("dropout", None)])
def test_the_fingertips_of_planned_joints_stand_still_where_they_were_last(name, fingers):
    errors = CommandErrors.parse(f"{name}_6")
    plans = [JOINTS.view(1, 1, 16).repeat(1, 8, 1) + 0.005 * k for k in range(40)]
    drafts = heard(errors, plans, command_space="joint")
    still = event_steps(errors, SEED, 40)
    first = still.index(True)
    for k in range(first, first + 6):
        held = {
            f
            for f in range(4)
            if not torch.equal(drafts[k][..., 4 * f : 4 * f + 4], plans[k][..., 4 * f : 4 * f + 4])
        }
        assert held == (fingers or held)
        assert len(held) == len(fingers or (1,))
        for f in held:  # The posture tie leaves some of the way back out.
            kept, planned, told = (
                fingertips(LEAP, plan[0, :1])[0, f] for plan in (plans[first - 1], plans[k], drafts[k])
            )
            assert (told - kept).norm() < 0.2 * (planned - kept).norm()
            assert torch.equal(drafts[k][0, 0], drafts[k][0, 7])
    assert torch.equal(drafts[first + 6], plans[first + 6])


def test_rows_have_their_own_errors_and_a_seed_repeats_them():
    inner = Listener()
    disturbed = DisturbedInterface(inner, REMOVAL)
    draft = torch.full((2, 8, 4, 3), 0.0005)
    seen = []
    for _ in range(2):
        disturbed.begin([5, 6])
        inner.reset()
        for _ in range(40):
            disturbed.step(observation(LOADS, rows=2), draft)
        seen.append(torch.stack(inner.drafts))
    assert torch.equal(*seen)
    for row, seed in enumerate((5, 6)):
        changed = [not torch.equal(step[row], draft[row]) for step in seen[0]]
        assert changed == event_steps(REMOVAL, seed, 40)
    assert {event.row for event in disturbed.events} == {0, 1}


def test_an_interface_under_removals_moves_the_hand_as_told():
    """`raw` takes the finger off at once, half as far with half the gain."""
    lifted = {}
    for name in ("raw", "raw@0.5"):
        removal = DisturbedInterface(make_interface(LEAP, name), REMOVAL)
        removal.begin([SEED])
        path = []
        for _ in range(30):
            removal.step(observation(LOADS), torch.zeros(1, 8, 4, 3, dtype=torch.float64))
            assert removal.motion is not None
            path.append(float(removal.motion[0, THUMB] @ -pads(LEAP, JOINTS)[1][0, THUMB]))
        first = event_steps(REMOVAL, SEED, 30).index(True)
        lifted[name] = path[first - 1 : first + 2]
    assert lifted["raw"] == pytest.approx([0.0, 0.002, 0.004], abs=1e-6)
    assert lifted["raw@0.5"] == pytest.approx([0.0, 0.001, 0.002], abs=1e-6)


def test_a_person_below_a_policy_is_late_off_by_its_scale_and_loses_fingers():
    errors = CommandErrors.parse("novice")
    human = HumanErrors(LEAP, LEVELS["novice"], np.random.default_rng(seeds_of(errors, SEED)[0]))
    delay, scale, _ = human.person
    drafts = [0.001 * k + torch.zeros(1, 8, 4, 3, dtype=torch.float64) for k in range(300)]
    seen, lost, kept = heard(errors, drafts), 0, None
    for k, draft in enumerate(seen):
        human.advance()
        expected = scale * drafts[max(k - delay, 0)][0] + torch.from_numpy(human.offset)
        if human.finger is not None and kept is not None:
            expected[:, human.finger] = kept[human.finger]
            lost += 1
        torch.testing.assert_close(draft[0], expected, atol=1e-9, rtol=0)
        kept = draft[0, 0]
    assert lost >= 12  # Twice in 15 s, for at least .3 s.


def test_late_joints_of_a_person_are_old_joints_but_for_its_offsets():
    plans = [JOINTS.view(1, 1, 16).repeat(1, 8, 1) + 0.004 * k for k in range(12)]
    seen = heard(CommandErrors.parse("steady"), plans, command_space="joint")
    tips = [fingertips(LEAP, plan[0, :1]) for plan in plans]
    for k in range(3, 12):
        got = fingertips(LEAP, seen[k][0, :1])
        assert (got - tips[k - 1]).norm() < 0.006
        assert not torch.equal(seen[k], plans[k - 1])


def test_hands_without_a_seed_and_removals_without_touch_are_refused():
    disturbed = DisturbedInterface(Listener(), REMOVAL)
    draft = torch.zeros(1, 8, 4, 3)
    with pytest.raises(DexFlexError, match="'removal_2mm' was begun for 0 hands, but 1 drafts came"):
        disturbed.step(observation(LOADS), draft)
    disturbed.begin([SEED])
    blind = {key: value for key, value in observation(LOADS).items() if "tactile" not in key}
    with pytest.raises(DexFlexError, match=r"needs touch: the observation lacks observation\.tactile"):
        disturbed.step(blind, draft)


@pytest.mark.parametrize("command_space", ["draft", "joint"])
@pytest.mark.parametrize(
    "name",
    ["noise_2mm+bias_1mm", "scale_1.5", "delay_2", "removal_2mm", "freeze_5", "dropout_5", "novice"],
)
def test_errors_stay_on_the_drafts_device_and_are_those_of_the_cpu(name, command_space):
    errors = CommandErrors.parse(name)
    shape = (1, 8, 16) if command_space == "joint" else (1, 8, 4, 3)
    draft = (0.6 if command_space == "joint" else 0.0005) + torch.zeros(shape)
    expected = heard(errors, [draft * (1 + 0.01 * k) for k in range(22)], command_space=command_space)
    inner = Listener(command_space)
    disturbed = DisturbedInterface(inner, errors)
    with Elsewhere():
        disturbed.begin([SEED])
        state = moved(observation(LOADS))
        for k in range(22):
            disturbed.step(state, moved({"draft": draft * (1 + 0.01 * k)})["draft"])
        assert all(seen.device == ELSEWHERE for seen in inner.drafts)
        found = [seen.cpu() for seen in inner.drafts]
    assert all(torch.equal(*pair) for pair in zip(found, expected, strict=True))


def test_the_stand_in_device_refuses_what_cuda_refuses():
    with Elsewhere():
        there = moved({"x": torch.zeros(3)})["x"]
        with pytest.raises(RuntimeError, match="met tensors on lazy and on cpu"):
            torch.add(there, torch.ones(3))
        with pytest.raises(TypeError, match=r"Use Tensor\.cpu\(\) first"):
            there.numpy()
        assert (there + 1).cpu().numpy().tolist() == [1, 1, 1]


@pytest.mark.parametrize("finger", range(SHARPA.n_fingers))
def test_planned_joints_of_a_hand_with_fingers_of_unequal_length_leave_with_their_finger(finger):
    joints = torch.tensor(SHARPA.nominal_joints, dtype=torch.float64)[None]
    taxels = torch.zeros(1, SHARPA.n_fingers, 60)
    taxels[0, :, 30], taxels[0, finger, 30] = 1.0, 5.0
    state = {
        "observation.state": torch.cat([torch.zeros(1, 7), joints], 1),
        "observation.tactile": taxels.flatten(1),
    }
    inner = Listener("joint", SHARPA)
    disturbed = DisturbedInterface(inner, REMOVAL)
    disturbed.begin([SEED])
    plan = joints[:, None].repeat(1, 8, 1)
    for _ in range(24):
        disturbed.step(state, plan)
    [event] = {event.finger for event in disturbed.events}
    assert event == finger
    moved_joints = (torch.stack(inner.drafts) - plan).abs().amax((0, 1, 2)) > 1e-9
    assert {int(k) for k in SHARPA.finger_of_joint[moved_joints.numpy()]} == {finger}
    seen = inner.drafts[disturbed.events[0].onset + 3][0, :1]
    leaving = (fingertips(SHARPA, seen) - fingertips(SHARPA, joints))[0, finger]
    outward = -pads(SHARPA, joints)[1][0, finger]
    assert leaving @ outward == pytest.approx(4 * 0.002, rel=0.4)
