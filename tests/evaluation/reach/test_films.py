import numpy as np
import pandas as pd
import torch
from degraded_fakes import row

from lerobot_dexflex.conventions import STATE
from lerobot_dexflex.evaluation.reach.films import _Observed, choose_episode, flat
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface


def test_the_first_episode_that_the_rival_drops_and_ours_does_not_is_filmed():
    fallen = {"raw": (False, True, True, True), "dexflex": (False, True, False, False)}
    rows = pd.DataFrame(
        row(method, "removal_2mm", 10 + k, dropped=dropped)
        for method, endings in fallen.items()
        for k, dropped in enumerate(endings)
    )
    assert choose_episode(rows, "removal_2mm", "raw", "dexflex") == 12
    assert choose_episode(rows, "removal_3mm", "raw", "dexflex") is None


def test_numbers_of_an_explanation_are_logged_by_path():
    explanation = {"score": 1, "branch": "pure", "contact_loss": {"index": 0.25}}
    assert flat(explanation) == {"score": 1.0, "contact_loss/index": 0.25}


def test_what_is_filmed_is_the_drafts_first_step_and_what_was_made_of_it():
    joints = torch.full((1, 16), 0.4, dtype=torch.float64)
    draft = 0.002 * torch.arange(1, 9, dtype=torch.float64)[None, :, None, None].expand(1, 8, 4, 3)
    observed = _Observed(make_interface(LEAP, "raw@0.5"))
    observed.step({STATE: joints}, draft)
    assert observed.change is not None
    seen = observed.change.row(0)
    np.testing.assert_allclose(seen.draft, 0.002)
    np.testing.assert_allclose(seen.selected, 0.001)
