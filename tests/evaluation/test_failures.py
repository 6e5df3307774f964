from dataclasses import replace

from lerobot_dexflex.evaluation.failures import count_failures
from lerobot_dexflex.evaluation.outcome import Outcome

STAGES = ("held", "lifted", "done")
EPISODE = Outcome("raw", 0, 0, (0, 1), False, 9, None, 1 / 3, 0.0, ((0, 0.0), (4, 1 / 3)), 0, 0.0, None)


def test_failures_are_told_by_their_end_and_the_furthest_stage():
    episodes = [
        EPISODE,
        replace(EPISODE, drops=1, progress_max=0.6667),
        replace(EPISODE, drops=2, progress_max=0.6667),
        replace(EPISODE, progress_max=0.0),
        replace(EPISODE, success=True, progress_max=1.0),
    ]
    assert count_failures(episodes, STAGES) == {
        "dropped, after: lifted": 2,
        "time out, after: held": 1,
        "time out, never held": 1,
    }
    assert next(iter(count_failures(episodes, STAGES))) == "dropped, after: lifted"


def test_a_task_without_named_stages_tells_the_progress():
    assert count_failures([EPISODE], ()) == {"time out, progress 0.33": 1}
