"""Errors on their way to an interface: drafts and planned joints, on any device."""

import pytest
import torch
from elsewhere import ELSEWHERE, Elsewhere, moved

from lerobot_dexflex.commands.disturbed import DisturbedInterface
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.stream import ErrorStream, seeds_of
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads
from lerobot_dexflex.interfaces import CommandSpace
from lerobot_dexflex.interfaces.method import make_interface

JOINTS = torch.full((1, 16), 0.6, dtype=torch.float64)
TIPS = fingertips(JOINTS)
THUMB, SEED = 3, 5
LOADS = [1.0, 1.0, 1.0, 5.0]
REMOVAL = CommandErrors.of(removal=0.002)


class Listener:
    """An interface that remembers the drafts it gets and never moves."""

    name: str = "listener"
    command: torch.Tensor | None = TIPS

    def __init__(self, command_space: CommandSpace = "draft"):
        self.command_space: CommandSpace = command_space
        self.drafts = []

    def reset(self, mask=None):
        self.drafts = []

    def start(self, observation, initial=None):
        state = observation["observation.state"]
        return TIPS.to(state.device).expand(len(state), -1, -1)

    def step(self, observation, draft):
        self.drafts.append(draft)
        return draft[:, 0].flatten(1)


def observation(loads, rows=1):
    """Return a hand that feels `loads` [N] per finger, 3 mm outside of where it is commanded."""
    taxels = torch.zeros(rows, 4, 60)
    taxels[..., 30] = torch.tensor(loads)
    felt = TIPS - 0.003 * pads(JOINTS)[1]
    return {
        "observation.state": torch.cat([torch.zeros(rows, 7), JOINTS.expand(rows, -1).float()], 1),
        "observation.tactile": taxels.flatten(1),
        "observation.fingertips": felt.flatten(1).float().expand(rows, -1),
    }


def event_steps(errors, seed, steps):
    """Return in which steps events go on in the stream of this seed."""
    stream = ErrorStream(1)
    stream.begin(0, errors, seeds_of(errors, seed))
    found = []
    for _ in range(steps):
        stream.step(torch.zeros(1, 1, 4, 3), torch.tensor([LOADS]), torch.ones(1, 4, 3))
        found.append(bool(stream.in_event[0]))
    return found


def heard(errors, drafts, loads=LOADS, command_space: CommandSpace = "draft"):
    """Return the drafts that arrive."""
    inner = Listener(command_space)
    disturbed = DisturbedInterface(inner, errors)
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
    inward = pads(JOINTS)[1][0, THUMB]
    for k in range(8):  # Felt 3 mm outside of the command, then 2 mm more in every step.
        seen = drafts[first + k][0]
        assert torch.equal(seen[:, :THUMB], draft[0, :, :THUMB])
        expected = -(0.003 + 0.002 * (k + 1)) * inward
        torch.testing.assert_close(seen[0, THUMB].double(), expected, atol=1e-6, rtol=0)
        torch.testing.assert_close(seen[5, THUMB].double(), -0.002 * inward, atol=1e-6, rtol=0)
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
    leaving = (fingertips(seen[None]) - TIPS)[0, THUMB]
    outward = -pads(JOINTS)[1][0, THUMB]
    assert leaving @ outward == pytest.approx(0.003 + 4 * 0.002, rel=0.3)  # The posture tie leaves some out.


def test_jitter_shakes_the_positions_of_a_draft_and_not_their_sum():
    draft = torch.full((1, 8, 4, 3), 0.0005, dtype=torch.float64)
    first, second = (d[0] - draft[0] for d in heard(CommandErrors.of(jitter=0.004), [draft] * 2))
    off = first.cumsum(0)
    assert 0.002 < off.abs().max() <= 0.004 + 1e-12
    torch.testing.assert_close(off[1:], second.cumsum(0)[:-1], atol=1e-12, rtol=0)


def test_jitter_moves_the_fingertips_of_planned_joints_as_those_of_drafts():
    errors = CommandErrors.of(jitter=0.004)
    plan = JOINTS.view(1, 1, 16).repeat(1, 8, 1)
    [joints] = heard(errors, [plan], command_space="joint")
    [draft] = heard(errors, [torch.zeros(1, 8, 4, 3, dtype=torch.float64)])
    asked, got = draft[0].cumsum(0).flatten(), (fingertips(joints[0]) - TIPS).flatten()
    # The tie to the posture leaves some of it out, as it does under `raw` in every step.
    assert 0.5 < (got @ asked) / (asked @ asked) < 1
    assert torch.corrcoef(torch.stack([asked, got]))[0, 1] > 0.8


def test_a_late_draft_leads_to_the_positions_of_an_old_one():
    """`raw` under a plan that comes two steps late is where the plan was two steps ago."""
    raw = DisturbedInterface(make_interface("raw"), CommandErrors.of(delay=2))
    raw.reset()
    raw.begin([SEED])
    state, reached = observation(LOADS), []
    for k in range(6):
        start = raw.start(state, JOINTS)
        draft = (TIPS + 0.001 * (k + 1) - start)[:, None].expand(-1, 8, -1, -1)
        raw.step(state, draft)
        reached.append(raw.command)
    for k, command in enumerate(reached):
        torch.testing.assert_close(command, TIPS + 0.001 * max(k - 1, 1), atol=1e-12, rtol=0)


def test_late_joints_are_old_joints():
    plans = [JOINTS.view(1, 1, 16).repeat(1, 8, 1) + 0.01 * k for k in range(5)]
    drafts = heard(CommandErrors.of(delay=2), plans, command_space="joint")
    assert all(torch.equal(seen, plans[max(k - 2, 0)]) for k, seen in enumerate(drafts))


@pytest.mark.parametrize(("name", "fingers"), [("freeze", {0, 1, 2, 3}), ("dropout", None)])
def test_joints_stand_still_where_they_were_last(name, fingers):
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
        for f in held:
            columns = slice(4 * f, 4 * f + 4)
            expected = plans[first - 1][:, :1, columns].expand(-1, 8, -1)
            assert torch.equal(drafts[k][..., columns], expected)
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
    """`raw` lets go of the squeeze at once; `shrink` halves every step and so follows a little later."""
    lifted = {}
    for name in ("raw", "shrink"):
        removal = DisturbedInterface(make_interface(name), REMOVAL)
        removal.begin([SEED])
        state = observation(LOADS)
        removal.start(state, JOINTS)
        path = []
        for _ in range(30):
            removal.step(state, torch.zeros(1, 8, 4, 3, dtype=torch.float64))
            assert removal.command is not None
            path.append(removal.command[0, THUMB] @ -pads(JOINTS)[1][0, THUMB])
        first = event_steps(REMOVAL, SEED, 30).index(True)
        lifted[name] = float(path[first] - path[first - 1])
    assert lifted["raw"] == pytest.approx(0.005, abs=1e-5)
    assert lifted["shrink"] == pytest.approx(0.0025, abs=1e-5)


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
    ["noise_2mm+bias_1mm", "jitter_4mm", "scale_1.5", "delay_2", "removal_2mm", "freeze_5", "dropout_5"],
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
