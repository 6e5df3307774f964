"""The contact projection passes rigid motions, damps what fingers do against each other, keeps contact."""

import dataclasses

import pytest
import torch

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import contact_projection
from lerobot_dexflex.interfaces.contact_projection import PAST_DRAFTS, WINDOW, Grasp, ProjectionSettings

PLAIN = ProjectionSettings(
    gain=1.0,
    free_gain=1.0,
    internal_gain=0.0,
    closing_gain=1.0,
    speed=1.0,
    squeeze_gain=0.0,
    return_speed=0.0,
)
JOINTS = torch.tensor(LEAP.nominal_joints, dtype=torch.float64)[None]
TIPS = fingertips(LEAP, JOINTS)
INWARD = pads(LEAP, JOINTS)[1]


def grasp(loads: list[float], missing: tuple[int, ...] = (), before: list[float] | None = None) -> Grasp:
    """Return a still hand whose fingers carry these loads [N], and carried others `before` the last step."""
    past = torch.tensor(before or loads, dtype=torch.float64).repeat(1, WINDOW, 1)
    past[:, 0] = torch.tensor(loads)
    hidden = torch.zeros(1, 4, dtype=torch.bool)
    hidden[0, list(missing)] = True
    return Grasp(JOINTS, TIPS, past, hidden, torch.zeros(1, PAST_DRAFTS, 4, 3, dtype=torch.float64))


def project(
    draft: torch.Tensor, seen: Grasp, settings: ProjectionSettings, past: torch.Tensor | None = None
) -> torch.Tensor:
    """Project a draft that follows `past` ones, or still ones."""
    return contact_projection.project_draft(
        LEAP, draft, seen._replace(drafts=draft * 0 if past is None else past), settings
    )


def held(displacement: torch.Tensor) -> torch.Tensor:
    """Make a displacement (1, 4, 3) at once and stay there."""
    return torch.cat([displacement[:, None], torch.zeros(1, 7, 4, 3, dtype=torch.float64)], 1)


def plan(displacement: torch.Tensor) -> torch.Tensor:
    """Make a displacement (1, 4, 3) in every step."""
    return displacement[:, None].expand(-1, 8, -1, -1)


def inward_part(moved: torch.Tensor) -> torch.Tensor:
    """Return displacements toward the object [m]. Shape (4,)."""
    return (moved * INWARD).sum(-1)[0]


def rigid() -> torch.Tensor:
    """Return a small common motion of all tips [m]."""
    turn = torch.tensor([0.02, -0.01, 0.03], dtype=torch.float64)
    arms = TIPS - TIPS.mean(1, keepdim=True)
    return torch.tensor([0.001, 0.0, -0.001]) + torch.cross(turn.expand_as(arms), arms, dim=-1)


def near(found: torch.Tensor, expected: torch.Tensor, atol: float = 1e-9) -> None:
    torch.testing.assert_close(found, expected, atol=atol, rtol=0)


@pytest.mark.parametrize("loads", [[1.0] * 4, [0.0, 1.0, 1.0, 1.0]], ids=str)
def test_a_rigid_motion_of_the_object_passes(loads):
    near(project(held(rigid()), grasp(loads), PLAIN), rigid(), atol=1e-5)


def test_the_fit_is_that_of_least_squares():
    generator = torch.Generator().manual_seed(0)
    moves = torch.randn(1, 4, 3, dtype=torch.float64, generator=generator)
    weights = torch.tensor([[1.0, 0.0, 1.0, 1.0]], dtype=torch.float64)
    found = contact_projection.rigid_motion(moves, TIPS, weights)
    rows = []
    for tip in TIPS[0]:
        x, y, z = tip.tolist()
        cross = torch.tensor([[0, z, -y], [-z, 0, x], [y, -x, 0]], dtype=torch.float64)
        rows.append(torch.cat([torch.eye(3, dtype=torch.float64), cross], 1))
    jacobian = torch.stack(rows)  # (4, 3, 6)
    loaded = [0, 2, 3]
    twist = torch.linalg.lstsq(jacobian[loaded].flatten(0, 1), moves[0, loaded].flatten()[:, None]).solution
    near(found[0], (jacobian @ twist)[..., 0], atol=0.02)  # The regularisation costs as much, of 1.


def test_fingers_working_against_each_other_are_damped_and_may_close():
    closer = -0.05 * (TIPS - TIPS.mean(1, keepdim=True))  # No rigid motion brings tips closer.
    along = (closer * INWARD).sum(-1, keepdim=True)
    closing, beside = along.clamp(min=0) * INWARD, closer - along * INWARD
    near(project(held(closer), grasp([1.0] * 4), PLAIN), closing, atol=1e-5)
    half = dataclasses.replace(PLAIN, internal_gain=0.5)
    near(project(held(closer), grasp([1.0] * 4), half), closing + beside / 2, atol=1e-5)


def test_loaded_fingers_do_not_open_the_grasp():
    settings = dataclasses.replace(PLAIN, internal_gain=1.0)
    apart = held(-0.002 * INWARD)
    rest = project(apart, grasp([1.0] * 4), settings) - project(apart, grasp([1.0] * 4), PLAIN)
    assert inward_part(rest).min() > -1e-9  # Without the common motion.


def test_a_hand_without_a_grasp_is_left_alone():
    touching, draft = grasp([1.0, 0.0, 0.0, 0.0]), held(5 * rigid())
    near(project(draft, touching, ProjectionSettings()), draft[:, 0])
    lost = grasp([1.0, 0.0, 0.0, 0.0], before=[1.0] * 4)  # Held a moment ago.
    slower = project(draft, lost, ProjectionSettings())
    assert (slower.norm(dim=-1) < draft[:, 0].norm(dim=-1)).any()


def test_it_lets_go_where_the_drafts_insist():
    opening, four = -0.008 * INWARD, grasp([1.0] * 4)
    insisting = opening[:, None].expand(-1, PAST_DRAFTS, -1, -1)
    near(project(held(opening), four, ProjectionSettings(), past=insisting), opening)
    one = insisting.clone()
    one[:, :, 2:] = 0.0  # Two fingers are no release.
    for past in (None, one):
        moved = project(held(opening), four, ProjectionSettings(), past=past)
        assert inward_part(moved).max() > -0.0015


def test_a_plan_to_let_go_is_followed_at_once_and_a_held_draft_must_insist():
    opening, four = -0.004 * INWARD, grasp([1.0] * 4)
    near(project(plan(opening), four, ProjectionSettings()), opening)
    assert inward_part(project(held(opening), four, ProjectionSettings())).min() > -0.0015
    opening[:, 2:] = 0.0  # Two fingers are no release.
    moved = project(plan(opening), four, ProjectionSettings())
    assert (moved - opening).norm(dim=-1).max() > 1e-3


def test_what_a_plan_does_within_the_grasp_passes():
    firm = grasp([2.0] * 4)
    turn = torch.tensor([0.0, 0.0, 1e-3], dtype=torch.float64)  # One finger slides on the object.
    slide = torch.zeros(1, 4, 3, dtype=torch.float64)
    slide[:, 1] = turn - (turn * INWARD[0, 1]).sum() * INWARD[0, 1]
    settings = dataclasses.replace(PLAIN, planned_gain=1.0)
    near(project(plan(slide), firm, settings), slide, atol=1e-6)
    assert (project(held(slide), firm, settings) - slide).norm(dim=-1).max() > 1e-4
    opening = -1e-3 * INWARD * torch.tensor([1.0, 0, 0, 0], dtype=torch.float64)[:, None]
    near(project(plan(opening), firm, settings), opening, atol=1e-6)
    loose = project(plan(opening), grasp([0.5, 2.0, 2.0, 2.0]), settings)
    assert (loose - opening).norm(dim=-1).max() > 1e-4


def test_no_finger_is_faster_than_the_limit():
    slow = dataclasses.replace(PLAIN, speed=0.0005)
    speed = project(held(5 * rigid()), grasp([1.0, 1.0, 1.0, 0.0]), slow).norm(dim=-1)
    torch.testing.assert_close(speed, torch.full_like(speed, 0.0005))


def test_a_finger_that_lost_the_object_returns():
    settings = dataclasses.replace(PLAIN, return_speed=0.001)
    seen = grasp([0.0, 1.0, 1.0, 0.0], before=[1.0, 1.0, 1.0, 0.0])
    found = inward_part(project(held(0 * TIPS), seen, settings))
    near(found, torch.tensor([1e-3, 0.0, 0.0, 0.0]).double(), atol=1e-9)
    for k, returns in ((1, True), (2, False), (3, True), (4, False)):  # Now, 1 and 3 steps ago are recent.
        seen = grasp([0.0, 1.0, 1.0, 0.0])
        seen.loads[0, k, 0] = 1.0
        assert (inward_part(project(held(0 * TIPS), seen, settings))[0] > 0) == returns


def test_too_little_load_is_pressed_and_too_much_relieved():
    settings = dataclasses.replace(PLAIN, squeeze_gain=1e-4, preload=1.0)
    found = inward_part(project(held(0 * TIPS), grasp([0.2, 1.0, 3.0, 0.0]), settings))
    near(found, torch.tensor([0.8e-4, 0.0, -2e-4, 0.0]).double(), atol=1e-7)


def test_a_firm_finger_may_open_a_little_and_a_loose_one_not_at_all():
    settings = dataclasses.replace(PLAIN, internal_gain=0.2, opening_load=1.0)
    opening, seen = held(-1e-3 * INWARD), grasp([1.5, 0.5, 1.5, 1.5])
    outward = inward_part(project(opening, seen, PLAIN) - project(opening, seen, settings))
    assert outward[1].abs() < 1e-9
    assert (outward[[0, 2, 3]] > 1e-5).all()


def test_a_squeeze_that_the_draft_asks_for_is_never_relieved():
    settings = dataclasses.replace(PLAIN, squeeze_gain=1e-4, preload=1.0)
    pressing = held(1e-3 * INWARD)
    alone = project(pressing, grasp([8.0] * 4), dataclasses.replace(settings, squeeze_gain=0.0))
    near(project(pressing, grasp([8.0] * 4), settings), alone)
    assert (inward_part(project(-pressing, grasp([8.0] * 4), settings)) < -1e-4).all()


def test_a_finger_without_touch_counts_as_free_and_without_any_only_gain_and_limit_are_left():
    settings = ProjectionSettings(free_gain=0.5, speed=1.0, squeeze_gain=1e-4)
    blind = grasp([1.0] * 4, missing=(0, 1, 2, 3))
    near(project(held(rigid()), blind, settings), 0.5 * rigid())
    one = grasp([1.0] * 4, missing=(2,))
    free = grasp([1.0, 1.0, 0.0, 1.0])
    near(project(held(rigid()), one, settings), project(held(rigid()), free, settings))


@pytest.mark.parametrize("rows", [2, 5, 16, 33])
def test_rows_do_not_depend_on_each_other_to_the_last_bit(rows):
    generator = torch.Generator().manual_seed(rows)

    def draw(*shape: int, size: float = 0.002) -> torch.Tensor:
        return size * torch.randn(rows, *shape, dtype=torch.float64, generator=generator)

    joints = JOINTS + draw(16, size=0.1)
    loads = draw(WINDOW, 4, size=1.0).clamp(min=0)
    seen = Grasp(joints, fingertips(LEAP, joints), loads, draw(4) > 0.002, draw(PAST_DRAFTS, 4, 3))
    asked, settings = draw(8, 4, 3), ProjectionSettings()
    together = contact_projection.project_draft(LEAP, asked, seen, settings)
    for k in range(rows):
        alone = Grasp(*[part[k : k + 1] for part in seen])
        assert torch.equal(
            contact_projection.project_draft(LEAP, asked[k : k + 1], alone, settings)[0], together[k]
        )


def test_negative_settings_are_refused():
    with pytest.raises(DexFlexError, match="return_speed"):
        ProjectionSettings(return_speed=-1.0)
