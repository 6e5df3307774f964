import contextlib

import gymnasium
import numpy as np
import pytest
from counting_task import STEPS

from lerobot_dexflex.envs.registration import NAMESPACE
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.recording.attempt import attempt_path, load_attempt
from lerobot_dexflex.recording.staging import staging_folder
from lerobot_dexflex.teleop.clock import SteppedClock
from lerobot_dexflex.teleop.config import TeleopConfig
from lerobot_dexflex.teleop.hands import Hands
from lerobot_dexflex.teleop.keys import HELP
from lerobot_dexflex.teleop.session import Rules, Session
from lerobot_dexflex.teleop.shelf import Shelf
from lerobot_dexflex.teleop.view import NoView


class TypedKeys:
    """Keys that are pressed at times [s]. Satisfies `Keys`."""

    def __init__(self, clock, times):
        self._clock, self._left = clock, sorted(times.items())

    def pressed(self):
        while self._left and self._left[0][0] <= self._clock.now() + 1e-6:
            yield self._left.pop(0)[1]


class StillLeader:
    """Keeps the robot where it is, for some commands. Satisfies `Leader`."""

    def __init__(self, commands=10_000, ready=True):
        self.ready, self._left = ready, commands
        self.begun, self.told = [], []

    @property
    def over(self):
        return self._left <= 0

    def begin(self, env, index):
        self.begun.append(index)

    def tick(self, now):
        pass

    def command(self):
        self._left -= 1
        return None if self._left < 0 else Command(np.zeros(23), np.zeros(23), np.zeros((8, 4, 3)))

    def toggle(self):
        self.told.append("toggle")

    def calibrate(self):
        self.told.append("calibrate")


class SeenView(NoView):
    """Remembers what it saw. Satisfies `View`."""

    def __init__(self):
        self.seen = []

    def begin(self, index, recorded):
        self.seen.append((index, recorded))

    def watch(self, env, observation, info, motion):
        self.seen.append("step")

    def end(self, ending, steps):
        self.seen.append((ending, steps))


@pytest.fixture
def config(counting_task, tmp_path):
    return TeleopConfig(counting_task, episodes=5, root=tmp_path / "live", interface="raw", view="none")


@pytest.fixture
def play(config):
    """Returns a function that plays a session until a time; 0 s is the first control step."""

    def playing(keys, until=100.0, leader=None, view=None, **rules):
        clock, said = SteppedClock(), []
        leader = leader or StillLeader()
        env = gymnasium.make(f"{NAMESPACE}/{config.task}", disable_env_checker=True, max_episode_steps=-1)
        with contextlib.closing(env):
            typed = TypedKeys(clock, {**keys, until: "q"})
            session = Session(
                env,
                leader,
                Hands(make_interface(LEAP, "raw")),
                Shelf(config, []),
                typed,
                view or NoView(),
                Rules(config.episodes, **rules),
                said.append,
            )
            session.run(clock)
        return session, said, stored(config)

    return playing


def stored(config):
    paths = sorted(staging_folder(config.root).glob("attempt_*.npz"))
    return [load_attempt(path) for path in paths]


def test_an_episode_begins_and_is_kept_by_key(play):
    """s at 0.5 s; the steps at 0.5, 0.55, 0.6 and 0.65 s; k at 0.7 s."""
    _, said, [attempt] = play({0.5: "s", 0.7: "k"}, until=1.0)
    assert (attempt.index, attempt.seed, attempt.steps) == (0, 0, 4)
    assert (attempt.kept, attempt.success) == (True, False)
    assert [len(values) for values in attempt.frames.values()] == [4] * len(attempt.frames)
    np.testing.assert_array_equal(attempt.frames["observation.state"][:, 0], np.arange(4) / 16)
    assert "Attempt 0 is recorded. k keeps it, d discards it." in said
    assert "Kept (not solved): 1 of 5 episodes." in said


def test_a_discarded_episode_is_counted_and_not_kept_and_the_next_has_another_start(play):
    _, said, attempts = play({0.5: "s", 0.7: "d", 1.0: "s", 1.2: "k"}, until=2.0, seed=4)
    assert [(a.index, a.seed, a.kept, bool(a.frames)) for a in attempts] == [
        (0, 4, False, False),
        (1, 5, True, True),
    ]
    assert "Discarded (not solved): 0 of 5 episodes." in said


def test_an_episode_that_is_over_waits_for_the_decision_and_the_simulation_stands(play):
    view = SeenView()
    _, said, [attempt] = play({0.0: "s", 5.0: "k"}, until=6.0, view=view)
    assert "The episode is over: success. k keeps it, d discards it." in said
    assert (attempt.steps, attempt.success, attempt.kept) == (STEPS, True, True)
    recorded = view.seen[view.seen.index((0, True)) :]
    assert recorded[: STEPS + 2] == [(0, True), *["step"] * STEPS, ("success", STEPS)]


def test_an_episode_ends_at_the_time_limit(play):
    _, said, [attempt] = play({0.0: "s", 1.0: "d"}, until=2.0, max_steps=5)
    assert "The episode is over: time out. k keeps it, d discards it." in said
    assert attempt.steps == 5


def test_practice_has_no_time_limit_and_is_not_kept(play):
    _, said, attempts = play({}, until=2.0, max_steps=3)
    assert attempts == []
    assert said == []


def test_keys_that_make_no_sense_now_are_explained_and_change_nothing(play):
    session, said, attempts = play({0.2: "k", 0.3: "d", 0.4: "x", 0.499: "s", 0.5: "k"}, until=0.52)
    assert said.count(HELP) == 4  # The last: there is nothing to keep yet.
    assert attempts == []
    assert session.phase == "record"


def test_who_quits_loses_the_episode_under_way_only(play):
    _, said, attempts = play({0.0: "s", 0.2: "k", 0.5: "s"}, until=0.8)
    assert [attempt.index for attempt in attempts] == [0]
    assert said[-1] == "The episode under way is not kept."


def test_the_session_ends_when_enough_is_kept(play, config):
    config.episodes = 2
    keys = {0.0: "s", 0.2: "k", 0.5: "s", 0.7: "k", 1.0: "s"}
    session, said, attempts = play(keys)
    assert session.over
    assert len(attempts) == 2
    assert said[-1] == "Kept (not solved): 2 of 2 episodes."


def test_hands_free_success_decides(play):
    """Seeds 2 and 3 fail and run out of time."""
    session, _, attempts = play({}, hands_free=True, max_steps=12)
    assert session.over
    assert [(a.seed, a.kept, a.steps) for a in attempts] == [
        (0, True, 9),
        (1, True, 9),
        (2, False, 12),
        (3, False, 12),
        (4, True, 9),
        (5, True, 9),
        (6, True, 9),
    ]


def test_nothing_is_recorded_before_the_leader_is_ready(play):
    _, said, attempts = play({0.5: "s", 0.8: "k"}, until=1.0, leader=StillLeader(ready=False))
    assert attempts == []
    assert said[0] == "Not yet: the hand is not calibrated."
    _, _, attempts = play({}, until=1.0, leader=StillLeader(ready=False), hands_free=True)
    assert attempts == []


def test_when_the_stream_ends_the_episode_is_decided_and_then_the_session_is_over(play):
    session, said, [attempt] = play({0.2: "s", 5.0: "k"}, leader=StillLeader(commands=10))
    assert "The episode is over: no more commands. k keeps it, d discards it." in said
    assert (attempt.kept, attempt.steps) == (True, 6)
    assert session.over
    assert said[-1] == "The stream has ended."


def test_hands_free_the_end_of_the_stream_ends_the_session(play):
    session, said, [attempt] = play({}, leader=StillLeader(commands=5), hands_free=True)
    assert (attempt.kept, attempt.steps) == (False, 5)
    assert session.over
    assert said[-1] == "The stream has ended."


def test_the_leader_is_told_of_its_keys_and_of_every_start(play):
    leader = StillLeader()
    play({0.1: "space", 0.2: "o", 0.3: "s", 0.5: "k"}, until=0.6, leader=leader)
    assert leader.told == ["toggle", "calibrate"]
    assert leader.begun == [0, 0, 1]  # Practice, the attempt, practice of the next.


def test_a_second_session_goes_on_after_the_first(play, config):
    play({0.0: "s", 0.2: "k", 0.5: "s", 0.6: "d"}, until=0.8)
    _, said, attempts = play({0.0: "s", 0.2: "k"}, until=0.8)
    assert [(a.index, a.kept) for a in attempts] == [(0, True), (1, False), (2, True)]
    assert "Kept (not solved): 2 of 5 episodes." in said
    assert attempt_path(staging_folder(config.root), 2).is_file()


def test_what_was_killed_when_enough_was_kept_only_has_to_be_written(play, config):
    config.episodes = 1
    play({0.0: "s", 0.2: "k"})
    session, said, attempts = play({0.0: "s", 0.2: "k"})
    assert (session.over, session.ticks, said, len(attempts)) == (True, 0, [], 1)


def test_late_ticks_are_counted(play, monkeypatch):
    class SlowClock(SteppedClock):
        def wait(self, until):
            super().wait(until)
            self._now += 0.07

    monkeypatch.setitem(globals(), "SteppedClock", SlowClock)
    session, _, _ = play({}, until=1.0)
    assert session.ticks == pytest.approx(14, abs=2)
    assert session.late == session.ticks
