"""Intervals and paired tests from scipy and statsmodels, and one test that may be looked at as it goes."""

import math
import warnings
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln
from scipy.stats import bootstrap, wilcoxon
from statsmodels.duration.survfunc import SurvfuncRight
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from lerobot_dexflex.errors import DexFlexError

SIGNIFICANT = 0.05
"""Below this adjusted p-value two methods are said to differ; intervals are of 95 %."""
_RESAMPLES = 9999


class Rate(NamedTuple):
    """A success rate with its Wilson 95 % interval, both in percent, named as LeRobot names them."""

    n_success: int
    n_episodes: int
    pc_success: float
    pc_success_ci95: tuple[float, float]


class Mean(NamedTuple):
    """A mean with its bootstrap 95 % interval; `ci95` is None for fewer than two values."""

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
    interval: Any = proportion_confint(k, n, alpha=SIGNIFICANT, method="wilson")
    return Rate(k, n, 100 * k / n, (100 * float(interval[0]), 100 * float(interval[1])))


def mean_interval(values: Sequence[float], seed: int = 0) -> Mean | None:
    """Return mean and bootstrap (BCa) interval, or None if there are no values.

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


def ratio_interval(first: Sequence[float], second: Sequence[float], seed: int = 0) -> Mean | None:
    """Return the ratio of two means, the interval from resampling pairs; None where it is undefined.

    Args:
        first: One number per episode.
        second: Of the same episodes.
        seed: Seed of the resampling.
    """
    if len(first) == 0 or np.mean(second) == 0:
        return None
    ratio = float(np.mean(first) / np.mean(second))
    pairs = np.column_stack([first, second]).astype(float)
    sums = _shares(seed, (len(pairs),))[0] @ pairs
    found = sums[sums[:, 1] > 0]
    if len(pairs) < 2 or len(found) < len(sums):
        return Mean(ratio, None, len(pairs))
    low, high = np.percentile(found[:, 0] / found[:, 1], [50 * SIGNIFICANT, 100 - 50 * SIGNIFICANT])
    return Mean(ratio, (float(low), float(high)), len(pairs))


def two_level_interval(groups: Sequence[NDArray[np.float64]], seed: int = 0) -> Mean:
    """Return the average of the groups' means, its interval from resampling trainings and then episodes.

    Every resample draws trainings, the same for all groups, and within each group episodes, the same for all
    of these trainings, because trainings share the episodes' initial states: the pigeonhole bootstrap (Owen
    2007, doi:10.1214/07-AOAS122). It errs towards wide intervals; drawing other episodes for each training
    would not cover what the initial states have in common. Of one training only episodes are drawn. A
    handful of trainings cannot tell how much trainings differ when that outweighs the episodes: with three,
    the percentile interval then covers less than 95 %.

    Args:
        groups: One array per task, shape (trainings, episodes); the number of episodes may differ.
        seed: Seed of the resampling, so that the same values always give the same interval.

    Raises:
        DexFlexError: If there is no group, one is empty, or they differ in trainings.
    """
    if len({len(group) for group in groups}) != 1 or min(group.size for group in groups) == 0:
        shapes = ", ".join(str(group.shape) for group in groups)
        raise DexFlexError(f"Groups must have shapes (trainings, episodes) of equal trainings. Got {shapes}.")
    trainings, *episodes = _shares(seed, (len(groups[0]), *(group.shape[1] for group in groups)))
    means = [
        np.einsum("rt,rt->r", trainings, shares @ np.asarray(group, float).T)
        for shares, group in zip(episodes, groups, strict=True)
    ]
    low, high = np.percentile(np.mean(means, axis=0), [50 * SIGNIFICANT, 100 - 50 * SIGNIFICANT])
    mean = float(np.mean([group.mean() for group in groups]))
    return Mean(mean, (float(low), float(high)), sum(group.size for group in groups))


@lru_cache(maxsize=4)
def _shares(seed: int, sizes: tuple[int, ...]) -> tuple[NDArray[np.float64], ...]:
    """Return for each n of `sizes` every item's share of each resample, shape (resamples, n), drawn in turn.

    Tables resample the same numbers of episodes again and again, so the last draws are kept.
    """
    rng = np.random.default_rng(seed)
    return tuple(rng.multinomial(n, np.full(n, 1 / n), size=_RESAMPLES) / n for n in sizes)


def median_time(seconds: Sequence[float], successes: Sequence[bool]) -> float | None:
    """Return the Kaplan-Meier median of the time to success [s]; None if half never got there.

    Args:
        seconds: Time to success, or until which an episode was seen without [s].
        successes: Whether it succeeded.
    """
    median = float(SurvfuncRight(np.asarray(seconds, float), np.asarray(successes, int)).quantile(0.5))
    return None if math.isnan(median) else median


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
    adjusted: Any = multipletests(p_values, alpha=SIGNIFICANT, method="holm")[1]
    return [float(p) for p in adjusted]
