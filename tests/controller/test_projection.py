"""The contact projection passes rigid motions, damps what fingers do against each other, keeps contact."""

import dataclasses

import pytest
import torch

from lerobot_dexflex.controller import History, projection
from lerobot_dexflex.controller.settings import ProjectionSettings
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import NOMINAL_JOINTS
from lerobot_dexflex.hand.kinematics import fingertips, pads

PLAIN = ProjectionSettings(
    gain=1.0,
    free_gain=1.0,
    internal_gain=0.0,
    closing_gain=1.0,
    speed=1.0,
    squeeze_gain=0.0,
    return_speed=0.0,
)
JOINTS = torch.tensor(NOMINAL_JOINTS, dtype=torch.float64)[None]
TIPS = fingertips(JOINTS)
INWARD = pads(JOINTS)[1]


def history(loads: list[float], missing: tuple[int, ...] = (), before: list[float] | None = None) -> History:
    """Return a still hand whose fingers carry these loads [N], and carried others `before` the last step."""
    tactile = torch.zeros(1, 4, 4, 10, 6)
    tactile[..., 5, 3] = torch.tensor(before or loads)
    tactile[:, 0, :, 5, 3] = torch.tensor(loads)
    hidden = torch.zeros(1, 4, dtype=torch.bool)
    hidden[0, list(missing)] = True
    return History(
        JOINTS.float()[:, None].expand(1, 4, 16),
        TIPS.float()[:, None].expand(1, 4, 4, 3),
        torch.tensor([[0.0, 0.0, -1.0]]),
        tactile,
        hidden,
        torch.tensor(before or loads).expand(1, 8, 4),
        TIPS.float()[:, None].expand(1, 8, 4, 3),
        torch.zeros(1, dtype=torch.bool),
    )


def project_draft(
    draft: torch.Tensor, seen: History, settings: ProjectionSettings, past: torch.Tensor | None = None
) -> torch.Tensor:
    """Project a draft that follows `past` ones, or still ones."""
    return projection.project_draft(
        draft, seen, torch.zeros(len(draft), 8, 4, 3) if past is None else past, settings
    )


def held(displacement: torch.Tensor) -> torch.Tensor:
    """Hold a displacement (1, 4, 3) over the horizon."""
    return displacement[:, None].expand(-1, 8, -1, -1)


def rigid() -> torch.Tensor:
    """Return a small common motion of all tips [m]."""
    turn = torch.tensor([0.02, -0.01, 0.03], dtype=torch.float64)
    arms = TIPS - TIPS.mean(1, keepdim=True)
    return held(torch.tensor([0.001, 0.0, -0.001]) + torch.cross(turn.expand_as(arms), arms, dim=-1))


def test_a_rigid_motion_of_the_object_passes():
    moved = project_draft(rigid(), history([1.0] * 4), PLAIN)
    torch.testing.assert_close(moved, rigid(), atol=1e-5, rtol=0)


def test_fingers_working_against_each_other_are_damped_and_may_close():
    closer = held(-0.05 * (TIPS - TIPS.mean(1, keepdim=True)))  # No rigid motion brings tips closer.
    along = (closer * INWARD[:, None]).sum(-1, keepdim=True)
    closing, beside = along.clamp(min=0) * INWARD[:, None], closer - along * INWARD[:, None]
    damped = project_draft(closer, history([1.0] * 4), PLAIN)
    torch.testing.assert_close(damped, closing, atol=1e-5, rtol=0)
    half = project_draft(closer, history([1.0] * 4), dataclasses.replace(PLAIN, internal_gain=0.5))
    torch.testing.assert_close(half, closing + beside / 2, atol=1e-5, rtol=0)


def test_loaded_fingers_do_not_open_the_grasp():
    settings = dataclasses.replace(PLAIN, internal_gain=1.0)
    apart = -0.002 * INWARD[:, None].expand(1, 8, 4, 3)
    moved = project_draft(apart, history([1.0] * 4), settings)
    rest = moved - project_draft(apart, history([1.0] * 4), PLAIN)  # Without the common motion.
    assert (rest * INWARD[:, None]).sum(-1).min() > -1e-9


def test_a_hand_without_a_grasp_is_left_alone():
    touching = history([1.0, 0.0, 0.0, 0.0])
    draft = 5 * rigid()
    torch.testing.assert_close(project_draft(draft, touching, ProjectionSettings()), draft, atol=1e-9, rtol=0)
    lost = touching._replace(slow_loads=history([1.0] * 4).slow_loads)  # Held a moment ago.
    slower = project_draft(draft, lost, ProjectionSettings())
    assert (slower.norm(dim=-1) < draft.norm(dim=-1)).any()


def test_it_lets_go_where_the_drafts_insist():
    open_hand = -0.008 * INWARD[:, None].expand(1, 8, 4, 3)
    four = history([1.0] * 4)
    insisting = project_draft(open_hand, four, ProjectionSettings(), past=open_hand)
    torch.testing.assert_close(insisting, open_hand, atol=1e-9, rtol=0)
    one = open_hand.clone()
    one[:, :, 2:] = 0.0  # Two fingers are no release.
    for past in (None, one):
        moved = project_draft(open_hand, four, ProjectionSettings(), past=past)
        assert -(moved * INWARD[:, None]).sum(-1).min() < 0.0015


def plan(displacement: torch.Tensor) -> torch.Tensor:
    """Return a draft (1, 8, 4, 3) that begins with half of a displacement (1, 4, 3) and goes on with it."""
    steps = displacement[:, None].repeat(1, 8, 1, 1)
    steps[:, 0] /= 2
    return steps


def test_a_plan_to_let_go_is_followed_at_once_and_a_held_draft_must_insist():
    opening, four = -0.004 * INWARD, history([1.0] * 4)
    leaving = plan(opening)
    moved = project_draft(leaving, four, ProjectionSettings())
    torch.testing.assert_close(moved, leaving, atol=1e-9, rtol=0)
    moved = project_draft(held(opening), four, ProjectionSettings())
    assert -(moved * INWARD[:, None]).sum(-1).min() < 0.0015
    opening[:, 2:] = 0.0  # Two fingers are no release.
    moved = project_draft(plan(opening), four, ProjectionSettings())
    assert (moved - plan(opening)).norm(dim=-1).max() > 1e-3


def test_what_a_plan_does_within_the_grasp_passes():
    firm = history([2.0] * 4)
    turn = torch.tensor([0.0, 0.0, 1e-3], dtype=torch.float64)  # One finger slides on the object.
    slide = torch.zeros(1, 4, 3, dtype=torch.float64)
    slide[:, 1] = turn - (turn * INWARD[0, 1]).sum() * INWARD[0, 1]
    settings = dataclasses.replace(PLAIN, planned_gain=1.0)
    torch.testing.assert_close(project_draft(plan(slide), firm, settings), plan(slide), atol=1e-6, rtol=0)
    assert (project_draft(held(slide), firm, settings) - held(slide)).norm(dim=-1).max() > 1e-4
    opening = -1e-3 * INWARD * torch.tensor([1.0, 0, 0, 0], dtype=torch.float64)[:, None]
    torch.testing.assert_close(project_draft(plan(opening), firm, settings), plan(opening), atol=1e-6, rtol=0)
    loose = project_draft(plan(opening), history([0.5, 2.0, 2.0, 2.0]), settings)
    assert (loose - plan(opening)).norm(dim=-1).max() > 1e-4


def test_no_finger_is_faster_than_the_limit():
    moved = project_draft(
        5 * rigid(), history([1.0, 1.0, 1.0, 0.0]), dataclasses.replace(PLAIN, speed=0.0005)
    )
    speed = moved.norm(dim=-1)
    torch.testing.assert_close(speed, torch.full_like(speed, 0.0005))


def test_a_finger_that_lost_the_object_returns():
    settings = dataclasses.replace(PLAIN, return_speed=0.001)
    still = torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    moved = project_draft(still, history([0.0, 1.0, 1.0, 0.0], before=[1.0, 1.0, 1.0, 0.0]), settings)
    toward = (moved * INWARD[:, None]).sum(-1)[0, 0]
    torch.testing.assert_close(
        toward, torch.tensor([1e-3, 0.0, 0.0, 0.0], dtype=torch.float64), atol=1e-9, rtol=0
    )


def test_too_little_load_is_pressed_and_too_much_relieved():
    settings = dataclasses.replace(PLAIN, squeeze_gain=1e-4, preload=1.0)
    still = torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    moved = project_draft(still, history([0.2, 1.0, 3.0, 0.0]), settings)
    toward = (moved * INWARD[:, None]).sum(-1)[0, 0]
    torch.testing.assert_close(
        toward, torch.tensor([0.8e-4, 0.0, -2e-4, 0.0], dtype=torch.float64), atol=1e-7, rtol=0
    )


def test_a_firm_finger_may_open_a_little_and_a_loose_one_not_at_all():
    settings = dataclasses.replace(PLAIN, internal_gain=0.2, opening_load=1.0)
    opening, seen = held(-1e-3 * INWARD), history([1.5, 0.5, 1.5, 1.5])
    difference = project_draft(opening, seen, PLAIN) - project_draft(opening, seen, settings)
    outward = (difference * INWARD[:, None]).sum(-1)[0, 0]
    assert outward[1].abs() < 1e-9
    assert (outward[[0, 2, 3]] > 1e-5).all()


def test_a_squeeze_that_the_draft_asks_for_is_never_relieved():
    settings = dataclasses.replace(PLAIN, squeeze_gain=1e-4, preload=1.0)
    pressing = held(1e-3 * INWARD)
    servoed = project_draft(pressing, history([8.0] * 4), settings)
    alone = project_draft(pressing, history([8.0] * 4), dataclasses.replace(settings, squeeze_gain=0.0))
    torch.testing.assert_close(servoed, alone, atol=1e-9, rtol=0)
    opening = project_draft(-pressing, history([8.0] * 4), settings)
    assert ((opening * INWARD[:, None]).sum(-1) < -1e-4).all()


def test_without_touch_only_gain_and_limit_are_left():
    settings = ProjectionSettings(free_gain=0.5, speed=1.0)
    moved = project_draft(rigid(), history([1.0] * 4, missing=(0, 1, 2, 3)), settings)
    torch.testing.assert_close(moved, 0.5 * rigid(), atol=1e-9, rtol=0)


def test_rows_do_not_depend_on_each_other():
    both = History(
        *[torch.cat([a, b]) for a, b in zip(history([1.0] * 4), history([0.0, 2, 2, 2]), strict=True)]
    )
    together = project_draft(torch.cat([rigid(), 2 * rigid()]), both, ProjectionSettings())
    alone = project_draft(2 * rigid(), history([0.0, 2, 2, 2]), ProjectionSettings())
    torch.testing.assert_close(together[1:], alone, atol=1e-12, rtol=0)


def test_negative_settings_are_refused():
    with pytest.raises(DexFlexError, match="return_speed"):
        ProjectionSettings(return_speed=-1.0)
