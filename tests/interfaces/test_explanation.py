import json

import pytest
import torch

from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.explanation import Choice, Explanation, relative_change

OK = (torch.zeros(1, 4, dtype=torch.int64), torch.zeros(1, dtype=torch.int64))
NO_SQUEEZE, HELD = torch.zeros(1, 4, 3), torch.zeros(1, 4, dtype=torch.bool)


def choice(branch=2):
    return Choice(
        branch=torch.tensor([branch]),
        score=torch.tensor([2.5]),
        draft_score=torch.tensor([-1.0]),
        contact_loss=torch.tensor([[0.1, 0.2, 0.1, 0.1]]),
        draft_contact_loss=torch.tensor([[0.1, 0.9, 0.1, 0.1]]),
        slip=torch.tensor([[0.1, 0.3, 0.1, 0.1]]),
        draft_slip=torch.tensor([[0.1, 0.6, 0.1, 0.1]]),
        grasp_loss=torch.tensor([0.25]),
        draft_grasp_loss=torch.tensor([0.75]),
    )


def test_a_row_is_plain_json_with_names_instead_of_indices():
    forces = torch.tensor([[[0.0, 3.0, 4.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -2.0, 0.0]]])
    row = Explanation(LEAP.finger_names, torch.tensor([0.5]), *OK, NO_SQUEEZE, HELD, forces, choice()).row(0)
    assert json.loads(json.dumps(row)) == row
    assert (row["branch"], row["draft_health"], row["score"]) == ("seeded", "ok", 2.5)
    assert list(row["contact_loss"]) == list(row["touch_health"])
    assert row["draft_grasp_loss"] == 0.75
    assert row["draft_slip"]["middle"] == pytest.approx(0.6)
    assert row["grip"] == {"index": 5.0, "middle": 0.0, "ring": 1.0, "thumb": 2.0}


def test_an_interface_without_candidates_explains_its_intervention_and_what_it_saw():
    row = Explanation(LEAP.finger_names, torch.tensor([0.5]), *OK, NO_SQUEEZE, HELD).row(0)
    assert set(row) == {"intervention", "touch_health", "draft_health", "squeeze", "free"}


def test_the_sentence_tells_what_the_draft_would_have_cost_and_which_touch_failed():
    touch = torch.tensor([[0, 0, 0, 2]])
    late = torch.tensor([1])
    squeeze = torch.zeros(1, 4, 3)
    squeeze[0, 2] = 0.003
    free = torch.tensor([[True, False, False, True]])
    sentence = Explanation(
        LEAP.finger_names, torch.tensor([0.5]), touch, late, squeeze, free, choice=choice()
    ).sentence(0)
    assert sentence == (
        "seeded chosen, changed the draft by 50 %; the draft would lose contact of middle; "
        "the draft would lose the grasp; index, thumb free; the squeeze of ring replaced; "
        "touch of thumb frozen; draft late"
    )


def test_an_intervention_is_relative_to_what_is_asked_and_finite_where_nothing_is():
    asked, selected = torch.zeros(2, 4, 3), torch.zeros(2, 4, 3)
    asked[0, 0] = torch.tensor([0.003, 0.0, 0.004])  # 5 mm are asked and 1 mm more is done: 1 / (5 + 2).
    selected[0, 0] = torch.tensor([0.003, 0.001, 0.004])
    selected[1, 2, 0] = 0.001  # Nothing is asked: 1 / 2.
    torch.testing.assert_close(relative_change(selected, asked), torch.tensor([1 / 7, 0.5]))
