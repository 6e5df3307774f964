"""What a plan holds, what its numbers weigh and how they are scaled."""

import pytest
import torch

from lerobot_dexflex.hands import LEAP
from lerobot_policy_dexflex.plan import FITTED_BATCHES, MIN_ANGLE_STD, MIN_LENGTH_STD, PlanLayout, PlanScale

ALL = ("joint", "commanded", "measured")


@pytest.mark.parametrize(
    ("learns", "size", "columns"),
    [
        (ALL, 47, {"joint": (7, 23), "commanded": (23, 35), "measured": (35, 47)}),
        (("measured",), 19, {"measured": (7, 19)}),
        (("measured", "joint"), 35, {"joint": (7, 23), "measured": (23, 35)}),
    ],
)
def test_a_plan_holds_the_arm_and_then_the_learned_parts_in_a_fixed_order(learns, size, columns):
    layout = PlanLayout(LEAP, 7, learns)
    assert layout.size == size
    for part, (first, end) in columns.items():
        assert layout.columns(part) == [*range(7), *range(first, end)]
    assert layout.angles().sum() == 7 + 16 * ("joint" in learns)


def test_the_arm_weighs_half_and_the_learned_parts_share_the_other_half():
    weights = PlanLayout(LEAP, 7, ALL).weights()
    shares = [weights[a:b].sum().item() for a, b in ((0, 7), (7, 23), (23, 35), (35, 47))]
    assert shares == pytest.approx([1 / 2, 1 / 6, 1 / 6, 1 / 6])
    assert PlanLayout(LEAP, 7, ["measured"]).weights()[7:].tolist() == pytest.approx([0.5 / 12] * 12)
    hand_alone = PlanLayout(LEAP, 0, ["joint", "measured"]).weights()
    assert [hand_alone[:16].sum().item(), hand_alone[16:].sum().item()] == pytest.approx([0.5, 0.5])


@pytest.fixture
def scale():
    return PlanScale(2, PlanLayout(LEAP, 7, ["measured"]))


def batches(n, rows=5):
    generator = torch.Generator().manual_seed(0)
    plans = 3 + torch.randn(n, rows, 2, 19, generator=generator)
    valid = torch.rand(n, rows, 2, generator=generator) < 0.7
    return plans, valid


def test_mean_and_deviation_of_several_batches_are_those_of_all_valid_steps_together(scale):
    plans, valid = batches(4)
    plans[~valid] = float("nan")
    for each, kept in zip(plans, valid, strict=True):
        scale.observe(each, kept)
    for step in range(2):
        seen = plans[:, :, step][valid[:, :, step]]
        torch.testing.assert_close(scale.mean[step], seen.mean(0))
        torch.testing.assert_close(scale.std[step], seen.std(0, correction=0))


def test_only_the_first_batches_count_and_a_new_training_begins_afresh(scale):
    plans, valid = batches(1)
    for _ in range(FITTED_BATCHES):
        scale.observe(plans[0], valid[0])
    mean = scale.mean.clone()
    scale.observe(plans[0] + 10, valid[0])
    assert torch.equal(scale.mean, mean)
    scale.begin()
    scale.observe(plans[0] + 10, valid[0])
    torch.testing.assert_close(scale.mean, mean + 10)


def test_what_does_not_move_keeps_a_smallest_scale_and_a_step_never_seen_its_own(scale):
    valid = torch.tensor([[True, False]] * 3)
    scale.observe(torch.full((3, 2, 19), 5.0), valid)
    assert scale.std[0, :7].tolist() == pytest.approx([MIN_ANGLE_STD] * 7)
    assert scale.std[0, 7:].tolist() == pytest.approx([MIN_LENGTH_STD] * 12)
    assert scale.mean.tolist() == [[5.0] * 19, [0.0] * 19]


def test_scaling_is_undone(scale):
    plans, valid = batches(1)
    scale.observe(plans[0], valid[0])
    torch.testing.assert_close(scale.inverse(scale(plans)), plans)
