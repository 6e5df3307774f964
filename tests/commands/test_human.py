"""People of every level: what stays with them, what changes from step to step, how they press."""

import itertools

import numpy as np
import pytest

from lerobot_dexflex.commands.human import HumanErrors, Person, Wander
from lerobot_dexflex.commands.levels import LEVELS, TREMOR_CORRELATION
from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.hands import LEAP, SHARPA

STEPS = 400
NAMES = list(LEVELS)


def person(name, seed=0, hand=LEAP):
    return HumanErrors(hand, LEVELS[name], np.random.default_rng(seed))


def offsets(name, seed=0, steps=STEPS, hand=LEAP):
    human, found = person(name, seed, hand), []
    for _ in range(steps):
        human.advance()
        found.append(human.offset)
    return np.array(found)


def test_levels_grow_worse_and_stay_within_what_people_do():
    for better, worse in itertools.pairwise(NAMES):
        a, b = LEVELS[better], LEVELS[worse]
        assert (a.tremor, a.jitter, a.drift) < (b.tremor, b.jitter, b.drift)
        for small, large in ((a.scale, b.scale), (a.squeeze, b.squeeze)):
            assert large[0] < small[0] < 1 < small[1] < large[1]
        assert a.delay[1] <= b.delay[1]
        assert a.lost[1] <= b.lost[1]
        assert a.every[0] >= b.every[0]
    for level in LEVELS.values():
        assert 1 <= level.delay[0] <= level.delay[1] <= 3
        assert level.scale[0] >= 0.8
        assert level.scale[1] <= 1.25
        assert level.squeeze[0] >= 0.5
        assert level.squeeze[1] <= 2
        assert level.lost[0] >= 0.2
        assert level.lost[1] <= 0.6
        assert level.every[0] >= 5
        assert level.every[1] <= 10
        assert level.reaction[0] >= 0.3
        assert level.reaction[1] <= 0.6


@pytest.mark.parametrize("name", NAMES)
def test_people_differ_and_fill_the_ranges_of_their_level(name):
    level = LEVELS[name]
    people = [Person.draw(level, np.random.default_rng(seed)) for seed in range(200)]
    assert {p.delay for p in people} == set(range(level.delay[0], level.delay[1] + 1))
    for values, (low, high) in (
        ([p.scale for p in people], level.scale),
        ([p.squeeze for p in people], level.squeeze),
    ):
        assert low <= min(values) < low * 1.05
        assert high / 1.05 < max(values) <= high
        assert np.mean(np.log(values)) == pytest.approx((np.log(low) + np.log(high)) / 2, abs=0.06)


@pytest.mark.parametrize("name", NAMES)
def test_offsets_have_the_size_of_the_table(name):
    level = LEVELS[name]
    found = np.concatenate([offsets(name, seed) for seed in range(20)])
    expected = np.sqrt(level.tremor**2 + level.jitter**2 + level.drift**2)
    assert found.std() == pytest.approx(expected, rel=0.15)


def test_offsets_are_smooth_tremor_is_fast_and_drift_is_slow():
    rng = np.random.default_rng(0)

    def correlation(wander, lag):
        values = np.array([wander.step() for _ in range(4000)]).reshape(4000, -1)
        return np.mean([np.corrcoef(v[:-lag], v[lag:])[0, 1] for v in values.T])

    assert correlation(Wander(LEAP, rng, 1.0, TREMOR_CORRELATION), 1) == pytest.approx(
        TREMOR_CORRELATION, abs=0.05
    )
    found = offsets("novice", steps=4000).reshape(4000, -1)
    steps = np.diff(found, axis=0).std() / found.std()
    assert steps < 0.5  # White noise: 1.41.
    late = [np.corrcoef(v[:-40], v[40:])[0, 1] for v in found.T]  # After 2 s: the drift's share.
    assert 0.2 < np.mean(late) < 0.7


@pytest.mark.parametrize("hand", [LEAP, SHARPA], ids=lambda hand: hand.name)
def test_fingers_have_their_own_errors(hand):
    found = offsets("typical", steps=4000, hand=hand)
    assert found.shape == (4000, hand.n_fingers, 3)
    between = np.corrcoef(found[:, :, 0].T)[np.triu_indices(hand.n_fingers, 1)]
    assert np.abs(between).max() < 0.5


def test_tremor_lies_above_8_hz():
    wander = Wander(LEAP, np.random.default_rng(1), 1.0, TREMOR_CORRELATION)
    values = np.array([wander.step()[0, 0] for _ in range(8192)])
    power = np.abs(np.fft.rfft(values)) ** 2
    hertz = np.fft.rfftfreq(len(values), CONTROL_PERIOD)
    assert power[hertz > 8].sum() > 0.6 * power.sum()


@pytest.mark.parametrize("hand", [LEAP, SHARPA], ids=lambda hand: hand.name)
@pytest.mark.parametrize("name", NAMES)
def test_a_finger_is_lost_now_and_then_for_as_long_as_the_table_says(name, hand):
    level = LEVELS[name]
    onsets, lengths, fingers = [], [], set()
    for seed in range(10):
        human, begun = person(name, seed, hand), []
        for step in range(STEPS * 2):
            if human.advance():
                begun.append(step)
                lengths.append(0)
                fingers.add(human.finger)
            if human.finger is not None:
                lengths[-1] += 1
                assert human.left > 0
        if human.finger is not None:  # Still lost at the end.
            lengths.pop()
        onsets += np.diff(begun).tolist()
    seconds = np.array(onsets) * CONTROL_PERIOD
    assert level.every[0] - 0.05 <= seconds.min() < seconds.max() <= level.every[1] + 0.05
    assert level.lost[0] <= min(lengths) * CONTROL_PERIOD + 1e-9
    assert max(lengths) * CONTROL_PERIOD <= level.lost[1] + 1e-9
    assert fingers == set(range(hand.n_fingers))


@pytest.mark.parametrize("name", NAMES)
def test_the_squeeze_stays_until_a_slip_is_seen_and_is_right_soon_after(name):
    level = LEVELS[name]
    for seed in range(20):
        human = person(name, seed)
        before = [human.squeeze(False) for _ in range(30)]
        assert len(set(before)) == 1
        assert level.squeeze[0] <= before[0] <= level.squeeze[1]
        after = [human.squeeze(slipping) for slipping in [True] + [False] * 20]
        assert np.abs(np.diff(np.abs(np.array([before[0], *after]) - 1))).max() < 0.2
        right = next(k for k, value in enumerate(after) if value == pytest.approx(1))
        assert level.reaction[0] - 1e-9 <= (right + 1) * CONTROL_PERIOD <= level.reaction[1] + 1e-9


def test_a_slip_changes_no_other_number():
    calm, slipping = person("novice", 3), person("novice", 3)
    for step in range(200):
        calm.squeeze(False)
        slipping.squeeze(step == 20)
        assert calm.advance() == slipping.advance()
        np.testing.assert_array_equal(calm.offset, slipping.offset)


def test_a_person_stays_and_the_episode_changes():
    human = person("typical", 5)
    traits, first, squeeze = human.person, human.offset, human.squeeze(False)
    human.advance()
    first = human.offset
    human.restart()
    human.advance()
    assert human.person == traits
    assert np.abs(human.offset - first).max() > 1e-5
    assert human.squeeze(False) != squeeze
    assert human.squeeze(False) == pytest.approx(squeeze, rel=0.4)  # A habit.


def test_a_seed_repeats_a_person_and_another_is_someone_else():
    np.testing.assert_array_equal(offsets("typical", 7), offsets("typical", 7))
    assert np.abs(offsets("typical", 7) - offsets("typical", 8)).max() > 1e-4
    assert person("typical", 7).person == person("typical", 7).person != person("typical", 8).person
