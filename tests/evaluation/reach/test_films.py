import pandas as pd
from degraded_fakes import row

from lerobot_dexflex.evaluation.reach.films import choose_episode, flat


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
