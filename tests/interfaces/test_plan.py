import torch

from lerobot_dexflex.interfaces.explanation import Choice
from lerobot_dexflex.interfaces.plan import Plan


def plan(rows=2, age=0, shift=0.0):
    """A plan whose k-th place is k mm along every axis."""
    places = 1e-3 * torch.arange(8.0).view(1, -1, 1, 1).expand(rows, -1, 4, 3) + shift
    return Plan(places, Choice(*[torch.full((rows,), shift)] * len(Choice._fields)), torch.full((rows,), age))


def millimetres(motion):
    return (1e3 * motion[..., 0, 0]).round().int().tolist()


def test_what_is_left_begins_at_its_age_from_where_the_tips_are_and_holds_its_end():
    aged = plan()._replace(age=torch.tensor([0, 5]))
    tips = torch.full((2, 4, 3), 0.002)
    assert millimetres(aged.motion(tips)) == [[-2, -1, 0, 1, 2, 3, 4, 5], [3, 4, 5, 5, 5, 5, 5, 5]]
    assert millimetres(plan(age=20).motion(tips)) == [[5] * 8] * 2


def test_a_plan_grows_older_and_expires_by_row():
    assert plan(age=1).older().age.tolist() == [2, 2]
    assert plan(age=1).expired(torch.tensor([False, True]), 4).age.tolist() == [1, 4]


def test_rows_that_are_renewed_take_everything_from_the_new_plan():
    found = plan(age=3).renewed(torch.tensor([False, True]), plan(shift=0.01))
    assert found.age.tolist() == [3, 0]
    assert torch.equal(found.targets[0], plan().targets[0])
    assert torch.equal(found.targets[1], plan(shift=0.01).targets[1])
    assert all(torch.allclose(part, torch.tensor([0.0, 0.01])) for part in found.choice)
