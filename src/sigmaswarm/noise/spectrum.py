"""Allan deviation (IEEE Std 952-1997, annex C), and fit of the noise model of an axis to the spectrum of its samples.

The two-sided spectral density is

    S(f) = N^2 + B^2 / (2 pi f) + K^2 / ((2 pi f)^2 + 1 / T^2)

with white noise N (angle or velocity random walk), flicker noise B (bias instability) and a bias with rate random walk
K. For finite T the bias is a first-order Gauss-Markov process with variance K^2 T / 2. The fit maximizes Whittle's
likelihood (1953) of the periodogram; the intervals are computed from the profile likelihood. Unlike straight lines
fitted to an Allan deviation, the likelihood separates overlapping processes, and shows which processes the log does not
determine.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.fft import prev_fast_len, rfft

from sigmaswarm.arrays import Array

FLICKER = 2 * math.log(2) / math.pi  # Allan variance of flicker noise / square of its coefficient
MARKOV_PEAK = 0.3811  # largest Allan variance of a unit Gauss-Markov process, at 1.89 correlation times
TIMES_PER_DECADE = 8  # averaging times per decade
# Ratio of longest stretch to longest averaging time; estimates at longer times scatter by more than half of their value
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
    factors = np.unique(np.round(np.logspace(0, decades, round(decades * TIMES_PER_DECADE) + 1)).astype(int))
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

    ``walk`` is the rate random walk of the bias, unit/sqrt(s), and ``time`` is its correlation time, s (inf for a
    random walk).
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


BAND = 0.1  # highest used frequency / sampling rate; the sensor's filter and the engine affect higher frequencies
# Number of frequencies up to which the band of a short log is extended, at most to half the sampling rate
MIN_FREQUENCIES = 200
# Lowest used frequency in periods per stretch; the subtracted trend contains most of the lower frequencies
MIN_PERIODS = 2
PER_DECADE = 24  # bands per decade of frequency, in which the periodogram is averaged
TAPER = 1.5  # number of neighboring frequencies that the sine taper makes equivalent to one independent value
DEVIANCE_95 = 5.99
"""Largest excess deviance inside a 95% interval: chi-square with two degrees of freedom.

The second degree of freedom is for the unknown correlation time. In simulations, 93 to 100% of the intervals contain
the true value (benchmarks/imu_noise.py).
"""
POINTS = 11  # number of values of a parameter in each pass over its likelihood profile
PASSES = 3  # number of refinements of each end of an interval
N_TIMES = 8  # number of finite correlation times
N_STEPS = 15  # number of steps of Fisher's scoring; enough for convergence
MIN_CORRELATION_TIME = 10.0  # s; noise with a shorter correlation time looks like a sensor's low-pass filter


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Averaged periodogram: frequencies (n,) in Hz, densities in unit^2/Hz, and numbers of independent values."""

    frequency: Array
    density: Array
    count: Array
    interval: float


@dataclass(frozen=True)
class Interval:
    """A value with its 95% interval. ``low`` is 0 if the log does not show that the value exceeds 0."""

    value: float
    low: float
    high: float


class NoiseFit(NamedTuple):
    """Fitted N, B, K and T (s); T is inf if the log does not show that T is finite."""

    white: Interval
    instability: Interval
    walk: Interval
    time: float


def spectrum_of(parts: Sequence[Array], interval: float) -> Spectrum:
    """Average the periodograms of stretches (n,) of one signal, after subtraction of their means and trends.

    The sine taper prevents the power of a drift from leaking to higher frequencies (Riedel and Sidorenko 1995).
    """
    duration = interval * sum(map(len, parts))
    highest = min(0.5, max(BAND, MIN_FREQUENCIES * interval / duration)) / interval
    frequencies, densities = list[Array](), list[Array]()
    for part in parts:
        n = int(prev_fast_len(len(part), real=True) or 1)
        time = np.arange(n) - (n - 1) / 2
        values = part[:n] - np.mean(part[:n])
        values -= time * (np.dot(time, values) / np.dot(time, time))
        values *= np.cos(np.pi / n * time)
        last = int(min(highest * n * interval, (n - 1) // 2))
        power = np.abs(np.asarray(rfft(values))[MIN_PERIODS : last + 1]) ** 2
        frequencies.append(np.arange(MIN_PERIODS, last + 1) / (n * interval))
        densities.append(power * interval * 2 / n)
    frequency, density = np.concatenate(frequencies), np.concatenate(densities)
    band = np.floor(PER_DECADE * np.log10(frequency / np.min(frequency))).astype(int)
    count = np.bincount(band)
    used = count > 0
    density, inverse = (np.bincount(band, v)[used] / count[used] for v in (density, frequency**-2.0))
    return Spectrum(inverse**-0.5, density, count[used] / TAPER, interval)


def fit(spectrum: Spectrum, duration: float) -> NoiseFit:
    """Fit the noise model to a spectrum. ``duration`` (s), the longest stretch, limits the correlation time."""
    s, angle = spectrum, 2 * np.pi * spectrum.frequency * spectrum.interval
    tried = N_TIMES if duration > 2 * MIN_CORRELATION_TIME else 0
    times = np.geomspace(MIN_CORRELATION_TIME, duration, tried)
    rates = np.concatenate([[0.0], 1 / times])
    flicker = s.interval / (2 * np.sin(angle / 2))
    shapes = np.array([[np.ones_like(angle), flicker, _walk(angle, s.interval, rate)] for rate in rates])
    variances, deviance = _smallest(s, np.zeros((len(rates), 1)), shapes)
    best = int(np.argmin(deviance))
    limit = float(deviance[best]) + DEVIANCE_95
    white, instability, walk = (_interval(s, shapes, k, float(variances[best, k]), limit) for k in range(3))
    return NoiseFit(white, instability, walk, math.inf if deviance[0] <= limit else 1 / float(rates[best]))


def _walk(angle: Array, interval: float, rate: float) -> Array:
    """Return the density of a sampled Gauss-Markov bias with K = 1.

    ``angle`` (n,) is in rad/sample, ``rate`` is 1/T in 1/s.
    """
    keep = math.exp(-rate * interval)
    return interval**2 / ((1 - keep) ** 2 + 4 * keep * np.sin(angle / 2) ** 2)


def _smallest(s: Spectrum, known: Array, shapes: Array) -> tuple[Array, Array]:
    """Minimize Whittle's deviance of the models ``known`` (..., n) + sum_k v_k ``shapes`` (..., k, n) over v >= 0.

    Each step of Fisher's scoring is a least-squares fit with the weights of the previous model.
    """
    sets = [list(c) for m in range(1, shapes.shape[-2] + 1) for c in combinations(range(shapes.shape[-2]), m)]
    size = np.sqrt(np.mean(shapes**2, axis=-1, keepdims=True))
    shapes = shapes / size
    variances = np.zeros(0)
    model = np.broadcast_to(s.density, np.broadcast_shapes(known.shape, shapes[..., 0, :].shape))
    for step in range(N_STEPS):
        weighted = shapes * (s.count / model**2)[..., None, :]
        matrix = weighted @ np.swapaxes(shapes, -1, -2)
        right = weighted @ (s.density - known)[..., None]
        variances = _least_squares(matrix, right[..., 0], sets)
        now = known + np.sum(variances[..., None] * shapes, axis=-2)
        now = np.maximum(now, 1e-6 * s.density)
        model = now if step else np.sqrt(now * model)
    deviance = 2 * np.sum(s.count * (np.log(model / s.density) + s.density / model - 1), axis=-1)
    return variances / size[..., 0], deviance


def _least_squares(matrix: Array, right: Array, sets: list[list[int]]) -> Array:
    """Solve normal equations (..., k, k), (..., k) for values >= 0, by trying each set of nonzero values."""
    best, gain = np.zeros_like(right), np.zeros(right.shape[:-1])
    for chosen in sets:
        part = matrix[..., chosen, :][..., :, chosen] * (1 + 1e-9 * np.eye(len(chosen)))
        solved = np.linalg.solve(part, right[..., chosen, None])[..., 0]
        gained = np.sum(solved * right[..., chosen], axis=-1)
        better = (solved >= 0).all(-1) & (gained > gain)
        candidate = np.zeros_like(right)
        candidate[..., chosen] = solved
        best, gain = np.where(better[..., None], candidate, best), np.where(better, gained, gain)
    return best


def _interval(s: Spectrum, shapes: Array, k: int, variance: float, limit: float) -> Interval:
    """Return the square root of a variance, with the interval at whose ends the deviance profile crosses a limit."""
    others = shapes[:, [i for i in range(3) if i != k]]
    own = shapes[:, k]

    def profile(values: Array) -> Array:
        known = values[:, None, None] ** 2 * own
        return np.min(_smallest(s, known, np.broadcast_to(others, (len(values), *others.shape)))[1], axis=1)

    top = math.sqrt(float(np.max(s.density / own[0])))
    value = math.sqrt(variance)
    high = _crossing(profile, np.geomspace(max(value, 1e-4 * top), 4 * top, POINTS), limit)
    if value == 0 or profile(np.zeros(1))[0] <= limit:
        return Interval(value, 0.0, high)
    return Interval(value, _crossing(profile, np.geomspace(value, 1e-3 * value, POINTS), limit), high)


def _crossing(profile: Callable[[Array], Array], grid: Array, limit: float) -> float:
    """Return the first value, interpolated on a grid, at which a profile that starts below a limit crosses it."""
    first, last, share = grid[0], grid[0], 0.0
    for _ in range(PASSES):
        excess = profile(grid) - limit
        above = np.flatnonzero(excess > 0)
        i = max(int(above[0]), 1) if len(above) else len(grid) - 1
        first, last = grid[i - 1], grid[i]
        share = excess[i - 1] / (excess[i - 1] - excess[i])
        grid = np.geomspace(first, last, POINTS)
    return float(first * (last / first) ** np.clip(share, 0, 1))
