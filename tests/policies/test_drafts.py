"""What a chunk becomes at each of its steps: targets ahead, or offsets from measured fingertips."""

from collections.abc import Mapping

import pytest
import torch
from torch import Tensor

from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.raw import RawInterface
from lerobot_policy_dexflex.chunk_execution import ChunkExecution
from lerobot_policy_dexflex.drafts import joint_draft, smoothed, tip_draft, without_squeeze


def plan(positions):
    """Planned fingertips (1, chunk, 4, 3), the same number in all coordinates [m]."""
    return torch.tensor(positions, dtype=torch.float64).view(1, -1, 1, 1) * torch.ones(4, 3)


def test_a_joint_draft_looks_ahead_and_repeats_the_last_target():
    chunk = torch.arange(5.0).view(1, 5, 1)
    assert joint_draft(chunk, 1, 3).flatten().tolist() == [1, 2, 3]
    assert joint_draft(chunk, 3, 4).flatten().tolist() == [3, 4, 4, 4]


def test_a_tip_draft_leads_from_the_measured_fingertips_to_every_next_target():
    tips = torch.full((1, 4, 3), 0.25, dtype=torch.float64)
    draft = tip_draft(plan([1.0, 3.0, 6.0]), 1, 4, tips)
    assert draft.shape == (1, 4, 4, 3)
    assert draft[0, :, 0, 0].tolist() == [2.75, 5.75, 5.75, 5.75]


def test_smoothing_is_a_moving_average_that_keeps_constants_and_repeats_the_ends():
    plans = torch.tensor([0.0, 0.0, 5.0, 0.0, 0.0, 10.0]).view(1, 6, 1)
    assert smoothed(plans, 5).flatten().tolist() == [1.0, 1.0, 1.0, 3.0, 5.0, 6.0]
    assert torch.equal(smoothed(plans, 1), plans)
    assert torch.equal(smoothed(torch.full((2, 4, 3), 7.0), 3), torch.full((2, 4, 3), 7.0))


ROUND = torch.tensor([[0.02, 0.0, 0.01], [0.0, 0.03, 0.0], [-0.02, 0.0, 0.0], [0.0, -0.03, 0.02]]).double()
"""Four fingertips around an object [m]."""


@pytest.mark.parametrize("touching", [[1, 1, 1, 1], [1, 0, 1, 1], [0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 0]])
def test_a_plan_that_moves_the_grip_as_a_rigid_body_stays(touching):
    moved = (
        ROUND + torch.linalg.cross(torch.tensor([0.01, -0.02, 0.03]).double().expand_as(ROUND), ROUND) + 0.004
    )
    planned = moved.reshape(1, 1, 12).expand(-1, 8, -1)
    held = torch.tensor([touching]).bool()
    torch.testing.assert_close(without_squeeze(planned, ROUND.reshape(1, 12), held), planned)


def test_squeeze_is_taken_out_of_touching_fingers_at_every_step_and_motion_is_kept():
    squeezed = (0.8 * (ROUND - ROUND.mean(0)) + ROUND.mean(0)).reshape(1, 12)
    motion = 0.001 * torch.arange(8.0).double().clamp(min=2)[None, :, None] - 0.002
    planned, tips = squeezed[:, None] + motion, ROUND.reshape(1, 12)
    all_touch, none = torch.ones(1, 4).bool(), torch.zeros(1, 4).bool()
    torch.testing.assert_close(without_squeeze(planned, tips, all_touch), tips[:, None] + motion)
    assert torch.equal(without_squeeze(planned, tips, none), planned)
    # Of two fingers only their distance is no rigid motion.
    two = without_squeeze(planned, tips, torch.tensor([[1, 0, 1, 0]]).bool()).unflatten(-1, (4, 3))
    assert torch.equal(two[:, :, 1::2], planned.unflatten(-1, (4, 3))[:, :, 1::2])
    distance = (two[:, :, 0] - two[:, :, 2]).norm(dim=-1)
    torch.testing.assert_close(distance, (ROUND[0] - ROUND[2]).norm().expand_as(distance))


START = torch.full((1, 23), 0.5)
PLANNED = fingertips(LEAP, 0.5 + 0.01 * torch.arange(1, 11, dtype=torch.float64)[:, None].expand(-1, 16))[
    None
]


class Recorder(RawInterface):
    """Keeps the drafts that `raw` gets."""

    def __init__(self) -> None:
        super().__init__(LEAP)
        self.drafts: list[Tensor] = []

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        self.drafts.append(draft)
        return super().step(observation, draft)


@pytest.fixture
def execution():
    """A plan of ten steps, in which every joint moves by 0.01 rad, in execution."""
    made = ChunkExecution(Recorder(), n_arm=7, n_steps=8)
    made.begin(torch.cat([torch.zeros(1, 10, 7), PLANNED.float().flatten(2)], -1))
    return made


def test_every_draft_of_a_plan_is_relative_to_the_hand_as_it_is_measured_then(execution):
    # The hand goes its own way: neither what was planned nor what was commanded before is where it is.
    for k, joints in enumerate((0.5, 0.45, 0.7)):
        state = torch.full((1, 23), joints)
        execution.step({"observation.state": state})
        draft = execution.interface.drafts[-1]
        assert draft.dtype == torch.float64
        here = fingertips(LEAP, state[:, 7:].double())[:, None]
        torch.testing.assert_close(here + draft, PLANNED[:, k : k + 8], rtol=0, atol=1e-8)


def test_raw_reaches_the_plan_from_wherever_the_hand_is_measured(execution):
    for k in range(3):
        targets = execution.step({"observation.state": START + 0.02 * k})
        reached = fingertips(LEAP, targets[:, 7:].double())
        torch.testing.assert_close(reached, PLANNED[:, k], rtol=0, atol=5e-4)  # What the IK misses.
