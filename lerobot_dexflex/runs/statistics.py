"""Intervals and paired tests from scipy and statsmodels, and one test that may be looked at as it goes."""

import math
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import betaln
from scipy.stats import bootstrap, wilcoxon
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from lerobot_dexflex.errors import DexFlexError

_ALPHA = 0.05
_RESAMPLES = 9999


class Rate(NamedTuple):
    """A success rate with its Wilson 95 % interval, both in percent, named as LeRobot names them."""

    n_success: int
    n_episodes: int
    pc_success: float
    pc_success_ci95: tuple[float, float]


class Mean(NamedTuple):
    """A mean with its bootstrap (BCa) 95 % interval; `ci95` is None for fewer than two values."""

    mean: float
    ci95: tuple[float, float] | None
    n: int


class PairedTest(NamedTuple):
    """Exact two-sided McNemar test on paired episodes."""

    only_first: int
    """Episodes that only the first of the two solved."""
    only_second: int
    p_value: float


class RankTest(NamedTuple):
    """Two-sided Wilcoxon signed-rank test on paired numbers."""

    gain: Mean
    """Mean of second - first."""
    p_value: float


def success_rate(successes: Sequence[bool]) -> Rate:
    """Return the rate of successes with its Wilson interval.

    Raises:
        DexFlexError: If there are no episodes.
    """
    n, k = len(successes), int(sum(successes))
    if n == 0:
        raise DexFlexError("A success rate needs at least one episode. Got none.")
    interval: Any = proportion_confint(k, n, alpha=_ALPHA, method="wilson")
    return Rate(k, n, 100 * k / n, (100 * float(interval[0]), 100 * float(interval[1])))


def mean_interval(values: Sequence[float], seed: int = 0) -> Mean | None:
    """Return mean and bootstrap interval, or None if there are no values.

    Args:
        values: One number per episode.
        seed: Seed of the resampling, so that the same values always give the same interval.
    """
    if len(values) == 0:
        return None
    mean = float(np.mean(values))
    if len(values) < 2:
        return Mean(mean, None, len(values))
    if np.ptp(values) == 0:
        return Mean(mean, (mean, mean), len(values))
    rng = np.random.default_rng(seed)
    with warnings.catch_warnings():
        # Resamples of few distinct values may coincide; scipy warns, the interval stays defined.
        warnings.simplefilter("ignore", RuntimeWarning)
        interval = bootstrap((np.asarray(values, float),), np.mean, n_resamples=_RESAMPLES, rng=rng)
    low, high = interval.confidence_interval
    return Mean(mean, (float(low), float(high)), len(values))


def paired_test(first: Sequence[bool], second: Sequence[bool]) -> PairedTest:
    """Compare two methods on the same episodes, in the same order.

    Raises:
        DexFlexError: If the two sequences differ in length.
    """
    if len(first) != len(second):
        raise DexFlexError(f"Paired outcomes must have equal length. Got {len(first)} and {len(second)}.")
    a, b = np.asarray(first, bool), np.asarray(second, bool)
    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    table = [[int((a & b).sum()), only_a], [only_b, int((~a & ~b).sum())]]
    result: Any = mcnemar(table, exact=True)
    return PairedTest(only_a, only_b, float(result.pvalue))


def paired_e_value(only_first: int, only_second: int, prior: float = 1.0) -> float:
    """Return the E-value of discordant pairs: evidence against "either is as likely" at any number of pairs.

    Under that hypothesis `E_n = 2^n B(a + k, a + n - k) / B(a, a)` of k of n pairs is a non-negative
    martingale of mean 1, so that by Ville's inequality it ever exceeds 1/alpha with probability alpha at
    most: n may grow after a look. min(1, 1 / E) is a p-value, which a fixed-n test beats where n was fixed.

    Args:
        only_first: Episodes that only the first of two methods solved.
        only_second: Episodes that only the second solved.
        prior: a, of the Beta distribution of the chance that the first wins a discordant pair.
    """
    n = only_first + only_second
    log = n * math.log(2) + betaln(prior + only_first, prior + only_second) - betaln(prior, prior)
    return math.exp(min(float(log), 700.0))


def rank_test(first: Sequence[float], second: Sequence[float]) -> RankTest:
    """Compare a number of two methods on the same episodes, in the same order; ties count for neither.

    Raises:
        DexFlexError: If the two sequences differ in length or are empty.
    """
    if len(first) != len(second) or len(first) == 0:
        raise DexFlexError(
            f"Paired numbers must have equal length, at least 1. Got {len(first)} and {len(second)}."
        )
    gains = np.subtract(second, first)
    mean = mean_interval(gains.tolist())
    assert mean is not None
    if not gains.any():
        return RankTest(mean, 1.0)
    result: Any = wilcoxon(gains, zero_method="wilcox")
    return RankTest(mean, float(result.pvalue))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted by Holm for a family of tests, in the order given."""
    if len(p_values) == 0:
        return []
    adjusted: Any = multipletests(p_values, alpha=_ALPHA, method="holm")[1]
    return [float(p) for p in adjusted]
