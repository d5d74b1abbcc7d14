"""Statistics of repeated runs: a median's interval, paired tests, and many tests at once."""

from typing import Any

import numpy as np
from scipy import stats

from sigmaswarm.drives.drive import Array


def median_interval(values: Array, confidence: float = 0.95) -> tuple[float, float]:
    """An interval for the median, whatever the distribution: two of the sorted values.

    The narrowest symmetric pair of order statistics that covers the median with at least this confidence (W. J.
    Conover, Practical Nonparametric Statistics, 3rd ed., 1999, section 3.2); lowest and highest where no pair does,
    as with fewer than six values at 95%.
    """
    ordered = np.sort(values)
    n = len(ordered)
    k = 0  # how many values are cut at each end
    while 2 * stats.binom.cdf(k, n, 0.5) <= 1 - confidence:
        k += 1
    return float(ordered[k]), float(ordered[n - 1 - k])


def wilcoxon(ours: Array, theirs: Array) -> float:
    """Probability of such differences or larger ones if neither is better: two-sided signed-rank test over pairs.

    F. Wilcoxon, Individual comparisons by ranking methods, Biometrics Bulletin 1, 1945. Infinite costs count as the
    largest of all; pairs without a difference are left out, and 1 is returned if no pair is left.
    """
    finite = np.concatenate([ours, theirs])
    finite = finite[np.isfinite(finite)]
    ceiling = 2 * np.abs(finite).max(initial=1.0)
    difference = np.where(np.isfinite(ours), ours, ceiling) - np.where(np.isfinite(theirs), theirs, ceiling)
    difference = difference[difference != 0]
    if not len(difference):
        return 1.0
    test: Any = stats.wilcoxon(difference)
    return float(test.pvalue)


def holm(probabilities: Array) -> Array:
    """Probabilities of many tests, corrected so that one false alarm among all of them is as rare as in one test.

    S. Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6, 1979.
    """
    m = len(probabilities)
    order = np.argsort(probabilities, kind="stable")
    grown = np.maximum.accumulate(probabilities[order] * (m - np.arange(m)))
    corrected = np.empty(m)
    corrected[order] = np.minimum(grown, 1.0)
    return corrected
