"""Progress that never falls, and a success that must hold."""

from lerobot_dexflex.envs.stages import SETTLED_STEPS, furthest_progress, has_settled


def test_a_task_is_settled_after_so_many_solved_steps_in_a_row():
    memory = {}
    assert not any(has_settled(memory, True) for _ in range(SETTLED_STEPS - 1))
    assert not has_settled(memory, False)
    assert [has_settled(memory, True) for _ in range(SETTLED_STEPS)] == [False] * (SETTLED_STEPS - 1) + [True]


def test_progress_is_that_of_the_furthest_stage_and_never_falls():
    memory = {}
    seen = [(0, 0, 0, 0), (1, 0, 0, 0), (0, 0, 1, 0), (1, 1, 0, 0), (0, 0, 0, 0), (0, 0, 0, 1)]
    found = [furthest_progress(memory, [bool(stage) for stage in stages]) for stages in seen]
    assert found == [0, 0.25, 0.75, 0.75, 0.75, 1]
