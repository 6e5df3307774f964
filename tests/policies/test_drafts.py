import pytest
import torch

from lerobot_policy_dexflex.drafts import displacement_draft, joint_draft


def plan(positions):
    """Planned fingertips (1, chunk, 4, 3) that move along x only, in metres."""
    return torch.tensor(positions, dtype=torch.float64).view(1, -1, 1, 1) * torch.ones(4, 3)


def test_a_joint_draft_looks_ahead_and_repeats_the_last_target():
    chunk = torch.arange(5.0).view(1, 5, 1)
    assert joint_draft(chunk, 1, 3).flatten().tolist() == [1, 2, 3]
    assert joint_draft(chunk, 3, 4).flatten().tolist() == [3, 4, 4, 4]


def test_displacements_are_differences_of_the_plan_and_end_in_rest():
    planned, command = plan([1.0, 3.0, 6.0]), torch.ones(1, 4, 3, dtype=torch.float64)
    draft = displacement_draft(planned, 1, 4, command, planned[:, 0], 1.0)
    assert draft[0, :, 0, 0].tolist() == [2, 3, 0, 0]


def test_with_gain_one_the_first_displacement_reaches_the_plan_from_wherever_the_command_is():
    planned, command = plan([1.0, 2.0, 3.0]), torch.full((1, 4, 3), 0.25, dtype=torch.float64)
    draft = displacement_draft(planned, 1, 2, command, planned[:, 0], 1.0)
    assert draft[0, :, 0, 0].tolist() == [1.75, 1]


def test_a_smaller_gain_makes_up_that_part_of_the_lag_in_every_step():
    planned, command = plan([1.0, 1.0, 1.0, 1.0]), torch.zeros(1, 4, 3, dtype=torch.float64)
    draft = displacement_draft(planned, 1, 3, command, planned[:, 0], 0.5)
    assert draft[0, :, 0, 0].tolist() == [0.5, 0.25, 0.125]


@pytest.mark.parametrize("gain", [0.3, 1.0])
def test_an_episode_begins_at_the_command_so_there_is_no_lag(gain):
    planned, command = plan([1.0, 2.0]), torch.zeros(1, 4, 3, dtype=torch.float64)
    assert displacement_draft(planned, 0, 2, command, None, gain)[0, :, 0, 0].tolist() == [1, 1]
