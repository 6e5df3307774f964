import json
from typing import Any

import pytest
import torch
from interface_cases import STATE, TACTILE, drafts, hand_poses, observation

from lerobot_dexflex.controller import DexFlexController, HistoryBuffer, SelectionSettings
from lerobot_dexflex.controller.projection import project_draft
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.interfaces.dexflex import SLOW_PERIOD, DexFlexInterface
from lerobot_dexflex.interfaces.explanation import BRANCHES
from lerobot_dexflex.interfaces.raw import RawInterface

FEW = {"n_pure": 4, "n_seeded": 4, "nfe": 2, "project": False}


def draft_of(rows, seed=1):
    return drafts("dexflex", rows, seed).float()


def flex(controller, **switches) -> Any:
    return DexFlexInterface(controller, SelectionSettings(**{**FEW, **switches}))


def test_the_draft_alone_under_an_untrained_decoder_is_executed_bit_for_bit_as_raw_does():
    interface: Any = flex(DexFlexController(), n_pure=0, n_seeded=0, use_residual=True)
    raw: Any = RawInterface()
    for k in range(5):
        seen, draft = observation(2, k), draft_of(2, k)
        assert torch.equal(interface.step(seen, draft), raw.step(seen, draft))
        assert torch.equal(interface.command, raw.command)


def test_it_executes_the_selected_chunk_and_its_correction(controller):
    interface, seen, draft = flex(controller, use_residual=True), observation(2), draft_of(2)
    joints = interface.step(seen, draft.double())
    past = HistoryBuffer()
    state = controller.encode(past.observe(seen))
    selection = controller.select(state, draft, past.drafts, interface.settings)
    start = seen[STATE][:, -16:]
    tips = fingertips(start) + selection.chunk[:, 0]
    raw = solve_fingertips(tips, start)
    assert selection.residual.any()
    torch.testing.assert_close(joints, raw + selection.residual, rtol=0, atol=1e-6)
    moved = tips + fingertips(joints) - fingertips(raw)
    torch.testing.assert_close(interface.command, moved, rtol=0, atol=1e-7)


def test_the_output_gain_scales_what_is_executed():
    interface = flex(DexFlexController(), n_pure=0, n_seeded=0, output_gain=0.5)
    seen, draft = observation(1), draft_of(1)
    interface.step(seen, draft)
    half = fingertips(seen[STATE][:, -16:]) + 0.5 * draft[:, 0]
    torch.testing.assert_close(interface.command, half, rtol=0, atol=1e-9)


def test_a_prefix_of_two_executes_two_displacements_of_a_chunk_and_then_chooses_anew():
    interface = flex(DexFlexController(), n_pure=0, n_seeded=0, prefix=2)
    first, second, third = (draft_of(1, seed=k) for k in range(3))
    start = interface.start(observation(1))
    for k, draft in enumerate((first, second, third)):
        interface.step(observation(1, k), draft)
    moved = first[:, 0] + first[:, 1] + third[:, 0]
    torch.testing.assert_close(interface.command - start, moved.double(), rtol=0, atol=1e-9)


def test_a_reset_row_chooses_at_once_while_the_others_finish_their_prefix():
    interface = flex(DexFlexController(), n_pure=0, n_seeded=0, prefix=2)
    first, second = draft_of(2, seed=0), draft_of(2, seed=1)
    interface.step(observation(2), first)
    interface.reset(torch.tensor([True, False]))
    before = interface.start(observation(2))
    interface.step(observation(2), second)
    moved = torch.stack([second[0, 0], first[1, 1]])
    torch.testing.assert_close(interface.command - before, moved.double(), rtol=0, atol=1e-9)


def test_the_slow_token_is_renewed_every_eight_steps_and_after_a_reset(controller, monkeypatch):
    calls, original = [], controller.encode_slow
    monkeypatch.setattr(controller, "encode_slow", lambda history: calls.append(1) or original(history))
    interface = flex(controller)
    counts = []
    for k in range(2 * SLOW_PERIOD + 1):
        interface.step(observation(2, k), draft_of(2, k))
        counts.append(len(calls))
    assert counts == [1] * SLOW_PERIOD + [2] * SLOW_PERIOD + [3]
    interface.reset(torch.tensor([True, False]))
    interface.step(observation(2), draft_of(2))
    assert len(calls) == 4


def test_the_explanation_compares_the_chosen_chunk_with_the_raw_draft(controller):
    interface, draft = flex(controller), draft_of(2)
    assert interface.explanation is None
    interface.step(observation(2), draft)
    explanation = interface.explanation
    assert explanation is not None
    choice = explanation.choice
    assert choice is not None
    assert (choice.score >= choice.draft_score).all()
    own = choice.branch == BRANCHES.index("draft")
    assert torch.equal(own, choice.score == choice.draft_score)
    moved = interface.command - fingertips(observation(2)[STATE][:, -16:])
    asked = draft[:, 0].double()
    size = asked.flatten(1).norm(dim=1) + 0.002
    expected = (moved - asked).flatten(1).norm(dim=1) / size
    torch.testing.assert_close(explanation.intervention, expected)
    json.dumps(explanation.row(1), allow_nan=False)


def test_the_raw_draft_is_explained_alike_whether_or_not_it_is_a_candidate(controller):
    records = []
    for include in (True, False):
        interface = flex(controller, include_draft=include)
        interface.step(observation(3), draft_of(3))
        assert interface.explanation is not None
        assert interface.explanation.choice is not None
        records.append(interface.explanation.choice)
    for name in ("draft_score", "draft_contact_loss", "draft_grasp_loss"):
        torch.testing.assert_close(*(getattr(record, name) for record in records))
    assert not (records[1].branch == BRANCHES.index("draft")).any()


@pytest.mark.parametrize(
    ("switches", "branches"),
    [
        ({"n_seeded": 0, "include_draft": False}, {"pure"}),
        ({"n_pure": 0, "include_draft": False}, {"seeded"}),
        ({"n_pure": 0, "n_seeded": 0}, {"draft"}),
        ({"use_score": False}, {"pure", "seeded"}),
        ({"project": True, "contact_bias": 1e6}, {"contact"}),
        ({"project": True, "contact_bias": -1e6}, {"draft", "pure", "seeded"}),
    ],
)
def test_switches_decide_where_candidates_come_from(controller, switches, branches):
    interface = flex(controller, **switches)
    interface.step(observation(8), draft_of(8))
    assert interface.explanation is not None
    assert {interface.explanation.row(k)["branch"] for k in range(8)} <= branches


def test_the_contact_projection_is_executed_where_it_is_chosen():
    interface = flex(DexFlexController(), project=True, contact_bias=1e6)
    seen, draft = observation(2), draft_of(2)
    interface.step(seen, draft)
    past, settings = torch.zeros(2, 8, 4, 3), interface.settings.projection
    repaired = project_draft(draft, HistoryBuffer().observe(seen), past, settings)
    moved = interface.command - fingertips(seen[STATE][:, -16:])
    torch.testing.assert_close(moved, repaired[:, 0].double(), rtol=0, atol=1e-6)


@pytest.mark.parametrize("use_touch", [True, False])
def test_touch_matters_exactly_if_it_is_used(controller, use_touch):
    interfaces = [flex(controller, use_touch=use_touch) for _ in range(2)]
    other = {**observation(2), TACTILE: observation(2, seed=9)[TACTILE]}
    targets = [i.step(seen, draft_of(2)) for i, seen in zip(interfaces, (observation(2), other), strict=True)]
    assert torch.equal(*targets) is not use_touch


def test_a_hand_without_touch_acts_as_one_whose_touch_is_switched_off(controller):
    blind = {key: value for key, value in observation(2).items() if key != TACTILE}
    with_key, without = flex(controller, use_touch=False), flex(controller)
    assert torch.equal(with_key.step(observation(2), draft_of(2)), without.step(blind, draft_of(2)))


def test_the_choice_never_depends_on_the_previous_command(controller):
    choices = []
    for seed in (0, 5):
        interface = flex(controller)
        interface.start(observation(2), hand_poses(2, seed))
        interface.step(observation(2), draft_of(2))
        assert interface.explanation is not None
        choices.append(interface.explanation.choice)
    assert all(torch.equal(a, b) for a, b in zip(*choices, strict=True))


def test_the_same_seed_gives_the_same_targets_and_another_seed_others(controller):
    first, second, other = flex(controller), flex(controller), flex(controller, seed=1, include_draft=False)
    for k in range(3):
        seen, draft = observation(2, k), draft_of(2, k)
        targets = first.step(seen, draft)
        assert torch.equal(second.step(seen, draft), targets)
        assert not torch.equal(other.step(seen, draft), targets)


def test_a_controller_of_another_hand_or_draft_is_refused(controller, tmp_path):
    controller.save_pretrained(tmp_path)
    assert DexFlexInterface(tmp_path).step(observation(1), draft_of(1)).shape == (1, 16)
    config = json.loads((tmp_path / "config.json").read_text())
    for name, value in (("embodiment", "allegro"), ("rate", 10.0), ("draft_definition", "measured")):
        (tmp_path / "config.json").write_text(json.dumps({**config, name: value}))
        with pytest.raises(DexFlexError, match=rf"`{name}` '?{value}"):
            DexFlexInterface(tmp_path)
