"""What DexFlex chooses, how long it keeps to it, and what it says of it."""

import json

import pytest
import torch
from interface_cases import STATE, TACTILE, observation
from learned_cases import draft_of, flex, joints_of, noisy, tips_of

from lerobot_dexflex.controller import DexFlexController, HistoryBuffer, SelectionSettings
from lerobot_dexflex.conventions import FINGERTIPS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.dexflex import SLOW_PERIOD, DexFlexInterface, ablated
from lerobot_dexflex.interfaces.explanation import BRANCHES
from lerobot_dexflex.interfaces.registry import INTERFACES

ROUNDING = {"rtol": 0, "atol": 1e-12}


@pytest.fixture(scope="module")
def untrained():
    torch.manual_seed(0)
    return DexFlexController()


def test_no_selection_executes_the_draft_exactly(controller):
    interface = flex(controller, "noselection", prefix=1)
    for k in range(5):
        interface.step(observation(2, k), draft_of(2, k))
        torch.testing.assert_close(interface.motion, draft_of(2, k)[:, 0], **ROUNDING)
        assert interface.explanation.intervention.max() < 1e-9
        assert interface.explanation.row(0)["branch"] == "draft"


def test_an_untrained_controller_is_usable(untrained):
    interface = DexFlexInterface(LEAP, untrained)
    assert interface.settings.n_candidates == 36
    assert torch.isfinite(interface.step(observation(2), draft_of(2))).all()


def test_it_moves_by_the_selected_chunk(controller):
    interface, seen, draft = flex(controller, include_draft=False), observation(2), draft_of(2)
    interface.step(seen, draft)
    past = HistoryBuffer(LEAP)
    state = controller.encode(past.observe({**seen, FINGERTIPS: tips_of(seen).flatten(1)}))
    selection = controller.select(state, draft.float(), past.drafts, interface.settings)
    torch.testing.assert_close(interface.motion, selection.chunk[:, 0].double(), rtol=0, atol=1e-7)
    assert (interface.motion - draft[:, 0]).abs().max() > 1e-4


def test_a_prefix_follows_the_plans_positions_wherever_the_tips_are_meanwhile():
    interface = flex(DexFlexController(), "noselection", prefix=3)
    draft, later = draft_of(2, 0), draft_of(2, 1)
    places = tips_of(observation(2, 0))[:, None] + draft
    for k in range(3):
        seen = observation(2, k)
        interface.step(seen, draft if k == 0 else later)
        torch.testing.assert_close(interface.motion, places[:, k] - tips_of(seen), **ROUNDING)
    interface.step(observation(2, 3), later)
    torch.testing.assert_close(interface.motion, later[:, 0], **ROUNDING)


def test_a_kept_plan_is_an_intervention_where_the_new_draft_differs():
    interface = flex(DexFlexController(), "noselection", prefix=2)
    seen, first = observation(1), torch.full((1, 8, 4, 3), 0.001, dtype=torch.float64)
    interface.step(seen, first)
    interface.step(seen, -first)  # 1 mm back is asked, 1 mm on is done: 2 mm per axis, 12 axes.
    expected = 0.002 * 12**0.5 / (0.001 * 12**0.5 + 0.002)
    assert interface.explanation.intervention.item() == pytest.approx(expected)


def test_a_reset_row_chooses_at_once_while_the_others_finish_their_prefix():
    interface = flex(DexFlexController(), "noselection", prefix=2)
    first, second, seen = draft_of(2, seed=0), draft_of(2, seed=1), observation(2)
    interface.step(seen, first)
    interface.reset(torch.tensor([True, False]))
    interface.step(seen, second)
    torch.testing.assert_close(interface.motion, torch.stack([second[0, 0], first[1, 1]]), **ROUNDING)
    interface.step(seen, first)  # Their prefixes end in different steps from now on.
    torch.testing.assert_close(interface.motion, torch.stack([second[0, 1], first[1, 0]]), **ROUNDING)


def test_late_drafts_go_on_along_the_remembered_positions_and_then_hold_the_last():
    interface = flex(DexFlexController(), "noselection", prefix=1)
    draft, seen = draft_of(2, size=0.001), observation(2)
    places = tips_of(seen)[:, None] + draft
    interface.step(seen, draft)
    for late in range(1, 12):
        seen[STATE] = seen[STATE] + 0.002  # The hand is somewhere else by now.
        interface.step(seen, None)
        expected = places[:, min(late, 7)] - tips_of(seen)
        torch.testing.assert_close(interface.motion, expected, **ROUNDING)
        assert interface.explanation.row(1)["draft_health"] == "late"


def test_late_drafts_from_the_start_hold_the_hand_where_it_was_then():
    interface, seen = flex(DexFlexController(), "noselection", prefix=1), observation(1)
    interface.step(seen, None)
    assert not interface.motion.any()
    moved = {**seen, STATE: seen[STATE] + 0.01}
    interface.step(moved, None)
    torch.testing.assert_close(interface.motion, tips_of(seen) - tips_of(moved), **ROUNDING)


@pytest.mark.parametrize("size", [0.5, 1e6])
def test_a_wild_draft_is_clipped_for_its_row_and_said_so(size):
    interface, draft = flex(DexFlexController(), "noselection", prefix=1), draft_of(2)
    draft[1] = size
    interface.step(observation(2), draft)
    torch.testing.assert_close(interface.motion[0], draft[0, 0], **ROUNDING)
    assert 0.01 < interface.motion[1].max() <= 0.1
    assert [interface.explanation.row(k)["draft_health"] for k in range(2)] == ["ok", "clipped"]
    assert interface.explanation.sentence(1).endswith("draft clipped")


def test_the_slow_token_is_renewed_every_eight_steps_and_after_a_reset(controller, monkeypatch):
    calls, original = [], controller.encode_slow
    monkeypatch.setattr(controller, "encode_slow", lambda history: calls.append(1) or original(history))
    interface, counts = flex(controller), []
    for k in range(2 * SLOW_PERIOD + 1):
        interface.step(observation(2, k), draft_of(2, k))
        counts.append(len(calls))
    assert counts == [1] * SLOW_PERIOD + [2] * SLOW_PERIOD + [3]
    interface.reset(torch.tensor([True, False]))
    interface.step(observation(2), draft_of(2))
    assert len(calls) == 4


@pytest.mark.parametrize("ablation", ["", "noslow"])
def test_what_is_longer_ago_than_the_frames_matters_exactly_through_the_slow_token(controller, ablation):
    scores = []
    for elsewhere in (0.0, 0.6):
        interface = flex(controller, ablation)
        for k in range(SLOW_PERIOD + 1):
            seen = noisy(observation(1), k)
            if k == 0:
                seen[STATE] = seen[STATE] + elsewhere
            interface.step(seen, draft_of(1))
        scores.append(interface.explanation.choice.score)
    assert torch.equal(*scores) is (ablation == "noslow")


def test_earlier_drafts_matter_to_the_score(controller):
    scores = []
    for seed in (1, 2):
        interface = flex(controller, prefix=1)
        interface.step(observation(1), draft_of(1, seed))
        interface.step(observation(1), draft_of(1))
        scores.append(interface.explanation.choice.draft_score)
    assert not torch.equal(*scores)


@pytest.mark.parametrize("ablation", ["", "notouch"])
def test_touch_matters_exactly_if_it_is_used(controller, ablation):
    interfaces = [flex(controller, ablation) for _ in range(2)]
    other = {**observation(2), TACTILE: observation(2, seed=9)[TACTILE]}
    targets = [i.step(seen, draft_of(2)) for i, seen in zip(interfaces, (observation(2), other), strict=True)]
    assert torch.equal(*targets) is (ablation == "notouch")


def test_a_hand_without_touch_acts_as_one_whose_touch_is_switched_off(controller):
    blind = {key: value for key, value in observation(2).items() if key != TACTILE}
    off, without = flex(controller, "notouch"), flex(controller)
    for _ in range(3):
        assert torch.equal(off.step(observation(2), draft_of(2)), without.step(blind, draft_of(2)))


def test_the_choice_never_depends_on_the_previous_command(controller):
    choices = []
    for jump in (0.0, 0.3):
        interface = flex(controller)
        interface._hand.look(observation(2))
        interface._hand.execute(joints_of(observation(2)) + jump)
        interface.step(observation(2), draft_of(2))
        choices.append(interface.explanation.choice)
    assert all(torch.equal(a, b) for a, b in zip(*choices, strict=True))


def test_the_explanation_compares_the_chosen_chunk_with_the_raw_draft(controller):
    interface, draft = flex(controller), draft_of(4)
    assert flex(controller).explanation is None
    interface.step(observation(4), draft)
    explanation, choice = interface.explanation, interface.explanation.choice
    assert (choice.score >= choice.draft_score).all()
    own = choice.branch == BRANCHES.index("draft")
    assert torch.equal(own, choice.score == choice.draft_score)
    assert not own.all()
    change = (interface.motion - draft[:, 0]).flatten(1).norm(dim=1)
    expected = change / (draft[:, 0].flatten(1).norm(dim=1) + 0.002)
    torch.testing.assert_close(explanation.intervention, expected)
    row = explanation.row(1)
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    assert all(0 <= value <= 1 for value in (*row["slip"].values(), row["grasp_loss"]))


def test_the_raw_draft_is_explained_alike_whether_or_not_it_is_a_candidate(controller):
    records = []
    for include in (True, False):
        interface = flex(controller, include_draft=include)
        interface.step(observation(3), draft_of(3))
        records.append(interface.explanation.choice)
    for name in ("draft_score", "draft_contact_loss", "draft_slip", "draft_grasp_loss"):
        torch.testing.assert_close(*(getattr(record, name) for record in records))
    assert not (records[1].branch == BRANCHES.index("draft")).any()


@pytest.mark.parametrize(
    ("ablation", "switches", "branches"),
    [
        ("noselection", {}, {"draft"}),
        ("nopure", {}, {"draft", "seeded", "finger"}),
        ("noseeded", {}, {"pure"}),
        ("nofinger", {}, {"draft", "pure", "seeded"}),
        ("", {"hysteresis": 1e6, "include_draft": False}, {"seeded"}),
        ("noscore", {}, {"pure", "seeded", "finger"}),
        ("", {"hysteresis": 1e6, "n_seeded": 0}, {"draft"}),
        ("", {"n_pure": 0, "n_seeded": 0, "include_draft": False}, {"finger"}),
    ],
)
def test_ablations_and_switches_decide_where_candidates_come_from(controller, ablation, switches, branches):
    interface = flex(controller, ablation, **switches)
    interface.step(observation(8), draft_of(8))
    assert {interface.explanation.row(k)["branch"] for k in range(8)} <= branches


def test_every_ablation_lacks_its_part_and_as_few_others_as_possible():
    whole = SelectionSettings()
    assert ablated(whole, "") == whole
    for name in INTERFACES["dexflex"].ablations:
        settings = ablated(whole, name)
        assert settings != whole
        if name != "noselection":
            assert settings.n_candidates == whole.n_candidates == 36
    with pytest.raises(DexFlexError, match=r"Unknown ablation 'nothing'. Valid: .*notouch"):
        ablated(whole, "nothing")


def test_without_the_score_the_proposal_nearest_to_the_draft_is_executed(controller):
    interface, seen, draft = flex(controller, "noscore"), observation(1), draft_of(1)
    interface.step(seen, draft)
    past = HistoryBuffer(LEAP)
    state = controller.encode(past.observe({**seen, FINGERTIPS: tips_of(seen).flatten(1)}))
    proposed = controller.propose(state, draft.float(), interface.settings).chunks[0, 1:, :2]
    nearest = (proposed - draft[0, :2]).square().sum((1, 2, 3)).argmin()
    torch.testing.assert_close(interface.motion[0], proposed[nearest, 0].double(), rtol=0, atol=1e-7)
