import gymnasium
import pytest
from evaluation_fakes import ENV_ID, CountEnv, FakeController

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.rollout import run_group


def environments(n):
    return [gymnasium.make(ENV_ID, disable_env_checker=True) for _ in range(n)]


def inner(env) -> CountEnv:
    assert isinstance(env.unwrapped, CountEnv)
    return env.unwrapped


def test_rows_end_on_their_own_and_the_rest_goes_on():
    # `lucky` drops in the first step of odd seeds and needs several steps in even ones.
    odd, even = run_group(environments(2), FakeController("lucky"), [1, 2])
    assert (odd.steps, odd.success) == (1, False)
    assert even.steps > 3
    assert even.success


def test_the_time_limit_ends_an_episode_without_success():
    [recorder] = run_group(environments(1), FakeController("still"), [0])
    assert (recorder.steps, recorder.success) == (8, False)


def test_the_watcher_of_a_row_sees_its_reset_and_every_step():
    class Watcher:
        def __init__(self):
            self.progress, self.motions = [], []

        def watch(self, env, observation, info, motion):
            self.progress.append(info["progress"])
            self.motions.append(motion)

        def close(self, outcome):
            raise AssertionError("A group does not know who acted.")

    watcher = Watcher()
    recorders = run_group(environments(2), FakeController("good"), [0, 1], {1: [watcher]})
    assert len(watcher.progress) == recorders[1].steps + 1
    assert watcher.progress[0] == 0
    assert watcher.progress[-1] == 1
    assert watcher.motions[0] is None
    assert watcher.motions[1].draft.shape == (4, 3)


def test_an_environment_without_success_in_its_info_is_refused(monkeypatch):
    monkeypatch.setattr(CountEnv, "_info", lambda self, dropped: {"progress": 0.0})
    with pytest.raises(DexFlexError, match=r"Missing: \['is_success'\]"):
        run_group(environments(1), FakeController("good"), [0])


def test_cameras_are_rendered_for_the_steps_in_which_the_controller_looks_and_for_watchers():
    class Glancer(FakeController):
        def reset(self, seeds):
            super().reset(seeds)
            self.step, self.asked = 0, []

        @property
        def looks(self):
            return self.step % 2 == 0

        def act(self, observation, task):
            self.step += 1
            return super().act(observation, task)

    class Watcher:
        def watch(self, env, observation, info, motion):
            seen[1].append(inner(env).seeing)

        def close(self, outcome):
            pass

    class Noting(gymnasium.Wrapper):
        def step(self, action):
            seen[0].append(inner(self.env).seeing)
            return super().step(action)

    seen = [], []
    both = environments(2)
    for env in both:
        inner(env).seeing = True
    run_group([Noting(both[0]), both[1]], Glancer("still"), [0, 1], {1: [Watcher()]})
    assert seen[0] == [False, True] * 4
    assert seen[1] == [True] * 9
