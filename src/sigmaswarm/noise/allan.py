"""Overlapping Allan deviation of samples, and Allan deviation of the noise model (IEEE Std 952-1997, annex C)."""

import math
from collections.abc import Sequence

import numpy as np

from sigmaswarm.arrays import Array

FLICKER = 2 * math.log(2) / math.pi  # Allan variance of flicker noise / square of its coefficient
MARKOV_PEAK = 0.3811  # largest Allan variance of a unit Gauss-Markov process, at 1.89 correlation times
PER_DECADE = 8  # averaging times per decade
# Ratio of longest stretch to longest averaging time; estimates at longer times scatter by more than half
MIN_STRETCH_RATIO = 5
PIECE = 32_768  # samples per batch, which fits into the processor's cache


def allan_deviation(parts: Sequence[Array], interval: float) -> tuple[Array, Array]:
    """Estimate the overlapping Allan deviation of stretches of one signal.

    Parameters
    ----------
    parts : sequence of array (n,)
        Stretches without gaps; their squared differences are pooled.
    interval : float
        Interval between samples, s.

    Returns
    -------
    tau, deviation : array (m,)
        Averaging times (s) and the deviation in the unit of the signal.
    """
    most = max(map(len, parts)) // MIN_STRETCH_RATIO
    decades = math.log10(max(most, 1))
    factors = np.unique(np.round(np.logspace(0, decades, round(decades * PER_DECADE) + 1)).astype(int))
    squares, counts = np.zeros(len(factors)), np.zeros(len(factors))
    for part in parts:
        phase = np.concatenate([[0.0], np.cumsum(part - np.mean(part))])
        for k, m in enumerate(factors[2 * factors <= len(part)]):
            squares[k] += _squares(phase, int(m))
            counts[k] += len(phase) - 2 * m
    used = counts > 0
    tau = factors[used] * interval
    return tau, np.sqrt(squares[used] / (2 * counts[used])) / factors[used]


def _squares(phase: Array, m: int) -> float:
    """Return the sum of the squared second differences over ``m`` samples."""
    total, count = 0.0, len(phase) - 2 * m
    for first in range(0, count, PIECE):
        last = min(first + PIECE, count)
        difference = phase[first + 2 * m : last + 2 * m] - phase[first + m : last + m]
        difference -= phase[first + m : last + m]
        difference += phase[first:last]
        total += float(np.sum(np.square(difference, out=difference)))
    return total


def model_parts(tau: Array, white: float, instability: float, walk: float, time: float) -> tuple[Array, ...]:
    """Return the Allan deviations (m,) of white noise, of flicker noise, and of a bias.

    ``walk``: rate random walk of the bias, unit/sqrt(s); ``time``: its correlation time, s (inf: a random walk).
    """
    r = tau / time
    if math.isinf(time):
        share = tau / 3
    else:
        series = r / 3 - r**2 / 4  # for small r, where the exact formula loses all digits
        exact = (r - 1.5 + 2 * np.exp(-r) - 0.5 * np.exp(-2 * r)) / np.maximum(r, 1e-9) ** 2
        share = time * np.where(r < 1e-3, series, exact)
    flicker = np.full(len(tau), instability * math.sqrt(FLICKER))
    return white / np.sqrt(tau), flicker, walk * np.sqrt(share)
