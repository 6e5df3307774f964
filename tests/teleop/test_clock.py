import itertools

import pytest

from lerobot_dexflex.teleop.clock import SteppedClock, SystemClock, beats


def test_ticks_come_at_50_hz_and_control_steps_at_20_hz():
    found = list(itertools.islice(beats(SteppedClock()), 0, 61))
    assert [round(1000 * beat.now) for beat in found[:7]] == [0, 20, 40, 50, 60, 80, 100]
    assert [round(1000 * beat.now) for beat in found if beat.control][:5] == [0, 50, 100, 150, 200]
    # 50 ticks and 20 control steps, of which every second comes with a tick.
    assert [beat.now for beat in found[::60]] == pytest.approx([0.0, 1.0])
    assert sum(beat.control for beat in found[:60]) == 20
    assert max(beat.late for beat in found) < 1e-9


class SlowClock(SteppedClock):
    """Every look at it costs time."""

    def wait(self, until):
        super().wait(until)
        self._now += 0.07


def test_who_is_slow_gets_fewer_beats_and_is_told_how_late_they_are():
    found = list(itertools.islice(beats(SlowClock()), 0, 10))
    steps = [b.now - a.now for a, b in itertools.pairwise(found)]
    assert min(steps) >= 0.07 - 1e-9
    assert all(beat.control for beat in found)
    assert found[-1].late == pytest.approx(0.07)


def test_the_systems_clock_waits_until_a_time_but_not_for_the_past():
    clock = SystemClock()
    start = clock.now()
    clock.wait(start + 0.03)
    assert 0.03 <= clock.now() - start < 0.3
    clock.wait(start)
    assert clock.now() - start < 0.3
