from degraded_fakes import episode

from lerobot_dexflex.evaluation.reach.films import choose_episode, flat
from lerobot_dexflex.evaluation.reach.record import make_record


def record(method, index, dropped, cell="removal_2mm"):
    return make_record(
        episode(dropped=dropped),
        method=method,
        cell=cell,
        index=index,
        chain="",
        version="",
        group=(0, 4),
        traced=False,
    )


def test_the_first_episode_that_raw_drops_and_ours_does_not_is_filmed():
    raw = [record("raw", k, dropped) for k, dropped in enumerate((False, True, True, True))]
    ours = [record("dexflex", k, dropped) for k, dropped in enumerate((False, True, False, False))]
    assert choose_episode(raw + ours, "removal_2mm", "dexflex") == 2
    assert choose_episode(raw + ours, "removal_3mm", "dexflex") is None


def test_numbers_of_an_explanation_are_logged_by_path():
    explanation = {"score": 1, "branch": "pure", "contact_loss": {"index": 0.25}}
    assert flat(explanation) == {"score": 1.0, "contact_loss/index": 0.25}
