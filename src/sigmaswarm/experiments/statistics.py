"""Statistics of repeated tuning runs: intervals of means and medians, paired tests, and correction for multiple tests.

Scores are arrays of shape (trials, drives). A score is NaN if the trial did not test on the drive. The bootstrap draws
n - 1 of n values (J. N. K. Rao and C. F. J. Wu, J. American Statistical Association 83, 1988). With n draws, the
variance of a mean would be too small by the factor (n - 1) / n.
"""

import math
import warnings
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
from scipy import stats

from sigmaswarm.arrays import Array

Interval = tuple[float, float]
RESAMPLES = 2000
LEVEL = 0.95


class Draws:
    """Random weights of drives and trials in bootstrap resamples; `weights` caches its results by its arguments."""

    def __init__(self, seed: int | np.random.Generator) -> None:
        self._seed = seed
        self._known: dict[Hashable, tuple[Array, Array]] = {}

    def weights(
        self, strata: Sequence[str], times: Array | None = None, trials: int = 1
    ) -> tuple[Array, Array]:
        """Return the weights of drives (see `_drive_weights`) and of trials (see `_weights`)."""
        key = trials, times if times is None else times.tobytes(), *strata
        if key not in self._known:
            rng = np.random.default_rng(self._seed)
            self._known[key] = _drive_weights(strata, rng, times), _weights(trials, rng)
        return self._known[key]


def trial_means(values: Array) -> Array:
    """Return the mean over each trial's drives, shape (trials,)."""
    return _mean_known(values, axis=1)


def drive_means(values: Array) -> Array:
    """Return the mean over each drive's trials, shape (drives,); NaN if no trial tested on the drive."""
    return _mean_known(values, axis=0)


def _mean_known(values: Array, axis: int) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows without values
        return np.asarray(np.nanmean(values, axis=axis))


def std(values: Array) -> float:
    """Return the standard deviation; NaN for fewer than two values, or if a value is not finite."""
    return float(np.std(values, ddof=1)) if len(values) > 1 and np.isfinite(values).all() else math.nan


def trial_interval(values: Array) -> Interval:
    """Return the interval mean +- 1.96 SD / sqrt(n) over the trials, as in the paper.

    The interval is too narrow for new drives: in simulated studies, its coverage is 45 to 91% (docs/study.md).
    """
    if not len(values):
        return math.nan, math.nan
    return _around_mean(values, 1.96 * std(values) / math.sqrt(len(values)))


def corrected_interval(values: Array, test_per_train: float) -> Interval:
    """Return the corrected resampled t interval (C. Nadeau and Y. Bengio, Machine Learning 52, 2003, section 3)."""
    n = len(values)
    if n < 2:
        return math.nan, math.nan
    error = std(values) * math.sqrt(1 / n + test_per_train)
    return _around_mean(values, float(stats.t.ppf((1 + LEVEL) / 2, n - 1)) * error)


def _around_mean(values: Array, half: float) -> Interval:
    return float(np.mean(values) - half), float(np.mean(values) + half)


def bootstrap(
    statistic: Callable[..., Array], columns: Sequence[Array], strata: Sequence[str], draws: Draws
) -> Interval:
    """Return the percentile interval of a statistic of paired columns, with drives resampled within their strata.

    ``statistic`` is called with the resampled means of each column, shape (RESAMPLES,).
    """
    n = len(columns[0])
    if n < 2 or not all(np.isfinite(column).all() for column in columns):
        return math.nan, math.nan
    weight, _ = draws.weights(strata)
    return _middle(statistic(*(weight @ column / n for column in columns)))


def crossed_bootstrap(values: Array, strata: Sequence[str], draws: Draws) -> Interval:
    """Return the percentile interval of the mean, with drives and trials resampled independently.

    The interval accounts for the choice of drives and the variation of the optimizer (A. B. Owen, The pigeonhole
    bootstrap, Annals of Applied Statistics 1, 2007). `levels` are resampled instead of scores, since the test drives of
    trials differ. With few trials or drives, percentile intervals are too narrow, so the tail probability is computed
    from Student's t (T. C. Hesterberg, The American Statistician 69, 2015).
    """
    known_values = ~np.isnan(values)
    kept, trials = known_values.any(axis=0), known_values.any(axis=1)
    if kept.sum() < 2 or trials.sum() < 2 or not np.isfinite(values[known_values]).all():
        return math.nan, math.nan
    drive_levels, trial_levels = levels(values[np.ix_(trials, kept)])
    own, n = [strata[i] for i in np.flatnonzero(kept).tolist()], len(trial_levels)
    times = known_values[:, kept].sum(axis=0).astype(np.float64)
    of_drives, of_trials = draws.weights(own, times, n)
    by_drive, by_trial = of_drives @ drive_levels / times.sum(), of_trials @ trial_levels / n
    variances = np.array([np.var(by_drive), np.var(by_trial)])
    freedom = np.array([max(len(own) - len(set(own)), 1), len(trial_levels) - 1])
    if not variances.any():
        return _middle(by_drive + by_trial)
    # Satterthwaite's degrees of freedom of the sum of both variances.
    together = float(variances.sum() ** 2 / np.sum(variances**2 / freedom))
    return _middle(by_drive + by_trial, float(stats.norm.cdf(stats.t.ppf((1 - LEVEL) / 2, together))))


def levels(values: Array) -> tuple[Array, Array]:
    """Return levels of drives (n,) and of trials (m,) whose sums fit the known scores (m, n) by least squares."""
    known = ~np.isnan(values)
    counted, filled = known.astype(np.float64), np.where(known, values, 0.0)
    share = counted / counted.sum(axis=0)  # weight of each trial in the levels of its drives
    normal = np.diag(counted.sum(axis=1)) - share @ counted.T
    trials = np.linalg.lstsq(normal, filled.sum(axis=1) - share @ filled.sum(axis=0), rcond=1e-9)[0]
    return (filled.sum(axis=0) - trials @ counted) / counted.sum(axis=0), trials


def _drive_weights(strata: Sequence[str], rng: np.random.Generator, times: Array | None = None) -> Array:
    """Return the weight of each drive in each resample, shape (RESAMPLES, n), drawn within each stratum.

    ``times``, shape (n,), is the number of trials of each drive. If every stratum has one drive, all drives form one
    stratum.
    """
    names = np.array(strata)
    times = np.ones(len(names)) if times is None else times
    groups = [np.flatnonzero(names == name) for name in dict.fromkeys(strata)]
    if max(len(group) for group in groups) < 2:
        groups = [np.arange(len(names))]
    weight = np.empty((RESAMPLES, len(names)))
    for group in groups:
        drawn = _weights(len(group), rng) * times[group]
        weight[:, group] = drawn * (times[group].sum() / drawn.sum(axis=1, keepdims=True))
    return weight


def _weights(n: int, rng: np.random.Generator) -> Array:
    """Draw n - 1 of n values in each resample. Return the weights of the values, with sum n, shape (RESAMPLES, n)."""
    if n == 1:
        return np.ones((RESAMPLES, 1))
    drawn = rng.integers(0, n, (RESAMPLES, n - 1)) + n * np.arange(RESAMPLES)[:, np.newaxis]
    counts = np.bincount(drawn.ravel(), minlength=RESAMPLES * n).reshape(RESAMPLES, n)
    return counts.astype(np.float64) * (n / (n - 1))


def _middle(values: Array, tail: float = (1 - LEVEL) / 2) -> Interval:
    """Return the quantiles ``tail`` and 1 - ``tail`` of the finite values."""
    values = values[np.isfinite(values)]
    if not len(values):
        return math.nan, math.nan
    low, high = np.quantile(values, [tail, 1 - tail])
    return float(low), float(high)


def improvement(tuned: Array | np.float64, manual: Array | np.float64) -> Array:
    """Return the paper's equation 5, (manual - tuned) / manual x 100, %; NaN where manual is 0."""
    m = np.where(manual > 0, manual, np.nan)
    return np.asarray(100 * (m - tuned) / m, dtype=np.float64)


def median_interval(values: Array) -> Interval:
    """Return a distribution-free interval of the median, from symmetric order statistics.

    W. J. Conover, Practical Nonparametric Statistics, 3rd ed., 1999, section 3.2. For fewer than six values, the
    interval is the whole range.
    """
    ordered, n = np.sort(values), len(values)
    # At each end, k values are outside of the interval. The interval misses the median with probability 2 cdf(k).
    k = max(int(stats.binom.ppf((1 - LEVEL) / 2, n, 0.5)) - 1, 0)
    return float(ordered[k]), float(ordered[n - 1 - k])


def signed_rank(own: Array, theirs: Array) -> float:
    """Return the p-value of the two-sided signed-rank test over pairs; 1 if no pair differs.

    An infinite cost is replaced by a value above all finite costs. F. Wilcoxon, Biometrics Bulletin 1, 1945.
    """
    finite = np.concatenate([own, theirs])
    finite = finite[np.isfinite(finite)]
    ceiling = 2 * np.abs(finite).max(initial=1.0)
    difference = np.where(np.isfinite(own), own, ceiling) - np.where(np.isfinite(theirs), theirs, ceiling)
    difference = difference[difference != 0]
    if not len(difference):
        return 1.0
    test: Any = stats.wilcoxon(difference)
    return float(test.pvalue)


def rank_biserial(difference: Array) -> float:
    """Return the rank-biserial correlation, -1 to 1. It is positive if negative differences have the larger rank sum.

    D. S. Kerby, Comprehensive Psychology 3, 2014.
    """
    nonzero = difference[difference != 0]
    if not len(nonzero):
        return 0.0
    ranks = stats.rankdata(np.abs(nonzero))
    return float(-np.sum(ranks * np.sign(nonzero)) / np.sum(ranks))


def holm(probabilities: Sequence[float]) -> list[float]:
    """Correct p-values for multiple tests (S. Holm, Scandinavian J. of Statistics 6, 1979)."""
    p = np.asarray(probabilities, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(np.maximum.accumulate((len(p) - np.arange(len(p))) * p[order]), 1.0)
    return adjusted.tolist()
