import numpy as np
import pytest
import torch

from lerobot_dexflex.commands.corruption import Corruption
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.command_errors import CommandErrors, SupportRemoval
from lerobot_dexflex.hand.kinematics import fingertips, pads
from lerobot_dexflex.interfaces import CommandSpace, make_interface

JOINTS = torch.full((1, 16), 0.6, dtype=torch.float64)
TIPS = fingertips(JOINTS)
THUMB, SEED = 3, 5


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
        return TIPS.expand(len(observation["observation.state"]), -1, -1)

    def step(self, observation, draft):
        self.drafts.append(draft)
        return JOINTS.expand(len(draft), -1)


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


def steps_of_removals(seed, steps):
    """Return which steps the benchmark's own stream of this seed takes a finger away in."""
    stream = Corruption("removal", 0.002).stream(np.random.default_rng((seed, 1)))
    return [
        bool(stream.step(np.zeros((4, 3)), np.array([1, 1, 1, 5.0]), np.ones((4, 3))).any())
        for _ in range(steps)
    ]


def heard(draft, loads, steps, command_space: CommandSpace = "draft"):
    """Return the drafts that arrive below removals when the same one is sent in every step."""
    inner = Listener(command_space)
    removal = SupportRemoval(inner, 0.002)
    removal.begin([SEED])
    for _ in range(steps):
        removal.step(observation(loads), draft)
    return inner.drafts


def test_the_most_loaded_finger_leaves_from_where_it_is_felt_and_the_others_follow_the_draft():
    draft = torch.full((1, 8, 4, 3), 0.0005)
    drafts = heard(draft, [1.0, 1.0, 1.0, 5.0], 60)
    changed = [not torch.equal(seen, draft) for seen in drafts]
    assert changed == steps_of_removals(SEED, 60)
    assert 8 <= sum(changed) <= 24
    first = changed.index(True)
    inward = pads(JOINTS)[1][0, THUMB]
    for k in range(8):  # Felt 3 mm outside of the command, then 2 mm more in every step.
        seen = drafts[first + k][0]
        torch.testing.assert_close(seen[:, :THUMB], draft[0, :, :THUMB])
        expected = -(0.003 + 0.002 * (k + 1)) * inward
        torch.testing.assert_close(seen[0, THUMB].double(), expected, atol=1e-6, rtol=0)
        torch.testing.assert_close(seen[5, THUMB].double(), -0.002 * inward, atol=1e-6, rtol=0)
    assert torch.equal(drafts[first + 8], draft)
    assert torch.equal(draft, torch.full((1, 8, 4, 3), 0.0005))


def test_a_hand_that_holds_nothing_is_left_alone():
    draft = torch.full((1, 8, 4, 3), 0.0005)
    drafts = heard(draft, [0.0] * 4, 60)
    assert len(drafts) == 60
    assert all(torch.equal(seen, draft) for seen in drafts)


def test_planned_joints_are_those_of_a_finger_that_leaves():
    draft = JOINTS.view(1, 1, 16).repeat(1, 8, 1)
    drafts = heard(draft, [1.0, 1.0, 1.0, 5.0], 30, "joint")
    changed = steps_of_removals(SEED, 30)
    seen = drafts[changed.index(True) + 3][0, 0]
    assert torch.equal(seen[:12], JOINTS[0, :12])
    moved = (fingertips(seen[None]) - TIPS)[0, THUMB]
    outward = -pads(JOINTS)[1][0, THUMB]
    assert moved @ outward == pytest.approx(0.003 + 4 * 0.002, rel=0.3)  # The posture tie leaves some out.


def test_rows_have_their_own_removals_and_a_seed_repeats_them():
    inner = Listener()
    removal = SupportRemoval(inner, 0.002)
    draft = torch.full((2, 8, 4, 3), 0.0005)
    seen = []
    for _ in range(2):
        removal.begin([5, 6])
        removal.reset()
        for _ in range(40):
            removal.step(observation([1.0, 1.0, 1.0, 5.0], rows=2), draft)
        seen.append(torch.stack(inner.drafts))
    assert torch.equal(*seen)
    for row, seed in enumerate((5, 6)):
        changed = [not torch.equal(step[row], draft[row]) for step in seen[0]]
        assert changed == steps_of_removals(seed, 40)


def test_an_interface_under_removals_moves_the_hand_as_told():
    """`raw` lets go of the squeeze at once; `shrink` halves every step and so follows a little later."""
    moved = {}
    for name in ("raw", "shrink"):
        removal = SupportRemoval(make_interface(name), 0.002)
        removal.begin([SEED])
        state = observation([1.0, 1.0, 1.0, 5.0])
        removal.start(state, JOINTS)
        path = []
        for _ in range(30):
            removal.step(state, torch.zeros(1, 8, 4, 3, dtype=torch.float64))
            assert removal.command is not None
            path.append(removal.command[0, THUMB] @ -pads(JOINTS)[1][0, THUMB])
        first = steps_of_removals(SEED, 30).index(True)
        moved[name] = float(path[first] - path[first - 1])
    assert moved["raw"] == pytest.approx(0.005, abs=1e-5)
    assert moved["shrink"] == pytest.approx(0.0025, abs=1e-5)


def test_errors_name_themselves_and_must_be_lengths():
    assert CommandErrors().identity() == {}
    assert CommandErrors(noise=0.004).identity() == {"command_noise": "0.004"}
    assert CommandErrors(removal=0.002).identity() == {"command_removal": "0.002"}
    for bad in (-0.001, float("nan"), float("inf")):
        with pytest.raises(DexFlexError, match=r"`command_removal` must be 0 or more \[m\]"):
            CommandErrors(removal=bad).identity()
