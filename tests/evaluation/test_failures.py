import pandas as pd

from lerobot_dexflex.evaluation.failures import endings, failures

STAGES = ("held", "lifted", "done")
ROWS = pd.DataFrame(
    [
        {"success": False, "drops": 0.0, "progress": 0.3333},
        {"success": False, "drops": 1.0, "progress": 0.6667},
        {"success": False, "drops": None, "progress": 0.0},
        {"success": True, "drops": 1.0, "progress": 1.0},
    ]
)


def test_failures_are_told_by_their_end_and_the_furthest_stage():
    assert failures(ROWS, STAGES) == [
        "time out, after: held",
        "dropped, after: lifted",
        "time out, never held",
    ]


def test_a_task_without_named_stages_tells_the_progress():
    assert failures(ROWS.head(1), ()) == ["time out, progress 0.33"]


def test_an_episode_ends_with_success_even_if_the_object_was_dropped_before():
    assert endings(ROWS) == ["time out", "dropped", "time out", "success"]
