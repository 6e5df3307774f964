from math import comb

import numpy as np
import pytest

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.statistics import (
    holm,
    mean_interval,
    median_time,
    paired_e_value,
    paired_test,
    ratio_interval,
    success_rate,
    two_level_interval,
)


def test_half_of_a_hundred_has_the_wilson_interval_derived_by_hand():
    # z^2 = 3.8415, n = 100, p = 1/2: centre 1/2, half width z sqrt(p(1-p)/n + z^2/4n^2) / (1 + z^2/n)
    # = 1.95996 sqrt(0.0025 + 0.00009604) / 1.038415 = 0.09617
    rate = success_rate([True, False] * 50)
    assert (rate.n_success, rate.n_episodes, rate.pc_success) == (50, 100, 50.0)
    assert rate.pc_success_ci95 == pytest.approx((40.383, 59.617), abs=1e-3)


def test_no_success_in_ten_still_leaves_room_above():
    # The upper bound is z^2 / (n + z^2) = 3.8415 / 13.8415.
    assert success_rate([False] * 10).pc_success_ci95 == pytest.approx((0, 27.753), abs=1e-3)


def test_a_rate_of_no_episodes_is_refused():
    with pytest.raises(DexFlexError, match="at least one episode"):
        success_rate([])


def test_mcnemar_counts_discordant_pairs_only():
    # 6 against 1 of 7 discordant pairs: p = 2 (C(7,0) + C(7,1)) / 2^7 = 16/128.
    first = [True] * 6 + [False] + [True] * 20
    second = [False] * 6 + [True] + [True] * 20
    assert paired_test(first, second) == (6, 1, pytest.approx(0.125))


def test_equal_outcomes_are_no_evidence():
    assert paired_test([True, False], [True, False]).p_value == 1


def test_unequal_lengths_cannot_be_paired():
    with pytest.raises(DexFlexError, match="3 and 2"):
        paired_test([True] * 3, [True] * 2)


def test_the_e_value_of_few_pairs_is_that_derived_by_hand():
    # a = 1: E = 2^n k! (n-k)! / (n+1)!. 6 against 1: 2^7 * 720 / 40320 = 16/7. 3 against 0: 8/4. a = 1/2,
    # 1 against 0: 2 B(3/2, 1/2) / B(1/2, 1/2) = 2 (pi/2) / pi = 1: a single pair says nothing.
    assert paired_e_value(6, 1) == pytest.approx(16 / 7)
    assert paired_e_value(1, 6) == paired_e_value(6, 1)
    assert paired_e_value(3, 0) == pytest.approx(2.0)
    assert paired_e_value(0, 0) == 1.0
    assert paired_e_value(1, 0, prior=0.5) == pytest.approx(1.0)


def test_the_e_value_is_a_fair_bet_where_both_are_alike():
    # Mean over all 2^n outcomes of n fair coins, n = 12: a martingale's mean stays 1.
    assert sum(comb(12, k) * paired_e_value(k, 12 - k) for k in range(13)) / 2**12 == pytest.approx(1)


def test_holm_steps_down_and_keeps_the_order():
    # Sorted 0.01, 0.03, 0.04 times 3, 2, 1 gives 0.03, 0.06, 0.04, made monotone: 0.03, 0.06, 0.06.
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([]) == []


def test_the_bootstrap_agrees_with_the_normal_interval_of_a_mean_and_repeats_itself():
    # 0 .. 9 ten times: mean 4.5, standard error sqrt(8.25 / 100) = 0.287, so 4.5 -+ 0.563.
    values = [float(k % 10) for k in range(100)]
    result = mean_interval(values)
    assert result is not None
    assert result.mean == 4.5
    assert result.ci95 == pytest.approx((3.937, 5.063), abs=0.05)
    assert mean_interval(values) == result


def test_degenerate_samples_have_no_made_up_interval():
    assert mean_interval([]) is None
    assert mean_interval([2.0]) == (2.0, None, 1)
    assert mean_interval([2.0, 2.0]) == (2.0, (2.0, 2.0), 2)


def test_a_ratio_is_that_of_the_means_and_its_interval_holds_the_pairs_together():
    first, second = [2.0, 4.0, 6.0, 8.0], [1.0, 2.0, 3.0, 4.0]
    assert ratio_interval(first, second) == (2.0, (2.0, 2.0), 4)
    found = ratio_interval(first, second[::-1])
    assert found is not None
    assert found.ci95 is not None
    assert found.ci95[0] < found.mean == 2.0 < found.ci95[1]


def test_a_ratio_to_nothing_is_undefined():
    assert ratio_interval([1.0, 2.0], [0.0, 0.0]) is None
    assert ratio_interval([], []) is None
    assert ratio_interval([1.0, 2.0], [0.0, 1.0]) == (3.0, None, 2)


def test_the_two_level_interval_is_of_the_average_of_groups_and_repeatable():
    groups = [np.array([[0.0, 1.0], [1.0, 1.0]]), np.zeros((2, 5))]
    found = two_level_interval(groups)
    assert (found.mean, found.n) == (0.375, 14)
    assert found == two_level_interval(groups)


def test_one_training_has_the_interval_of_its_episodes():
    # 50 of 100: the standard error is 5 points, the percentile interval 0.5 -+ 1.96 * 0.05.
    found = two_level_interval([np.repeat([[0.0, 1.0]], 50, axis=1)])
    assert found.ci95 == pytest.approx((0.402, 0.598), abs=0.011)


def test_trainings_that_disagree_widen_the_interval_however_many_episodes():
    groups = [np.array([[0.0] * 500, [1.0] * 500])]
    # Both draws the same training in half of the resamples: 0 or 1.
    assert two_level_interval(groups).ci95 == pytest.approx((0.0, 1.0))


def test_initial_states_that_decide_widen_the_interval_however_many_trainings():
    states = np.repeat([[0.0, 1.0]], 25, axis=1)  # (1, 50)
    one, many = two_level_interval([states]).ci95, two_level_interval([np.tile(states, (20, 1))]).ci95
    assert many == pytest.approx(one, abs=0.03)


@pytest.mark.parametrize("trainings", [1, 3])
def test_the_two_level_interval_covers_the_true_difference(trainings):
    rng, hits, n = np.random.default_rng(0), 0, 60
    spread = 0.05 if trainings > 1 else 0.0
    for _ in range(n):
        rates = rng.normal([[0.5], [0.7]], spread, (3, trainings, 2, 1))  # (tasks, trainings, methods, 1)
        solved = rng.random((3, trainings, 2, 40)) < rates
        interval = two_level_interval(list(1.0 * solved[:, :, 1] - solved[:, :, 0])).ci95
        assert interval is not None
        hits += interval[0] <= 0.2 <= interval[1]
    # Of 60 intervals of 95 %, fewer than 51 cover with a probability below 1e-3.
    assert hits >= 51


def test_groups_of_different_trainings_are_refused():
    with pytest.raises(DexFlexError, match=r"\(2, 3\), \(1, 3\)"):
        two_level_interval([np.zeros((2, 3)), np.zeros((1, 3))])


def test_the_median_time_counts_failures_as_later():
    assert median_time([4.0, 6.0, 8.0, 16.0, 16.0], [True, True, True, False, False]) == 8.0
    assert median_time([4.0, 6.0, 16.0, 16.0, 16.0], [True, True, False, False, False]) is None
