"""The noise of an IMU at rest: overlapping Allan deviation, and the noise parameters that explain it.

Each axis is white noise of density N and a bias: flicker noise B and a random walk K, or a first-order Gauss-Markov
process (IEEE Std 952-1997, annex C). They are fitted to the spectrum by maximum likelihood (P. Whittle, 1953) after a
linear drift is taken off; the intervals are those of the profile likelihood over both kinds of bias. The Allan
deviation is for the eye: its values at neighboring averaging times are too dependent for a fit with intervals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import detrend

from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Imu
from sigmaswarm.errors import InputError

Array = NDArray[np.float64]

AXES = {axis: "m/s2" if axis[0] == "a" else "rad/s" for axis in ("ax", "ay", "az", "gx", "gy", "gz")}
PER_DECADE = 10
"""Averaging times a decade."""
LONGEST = 1 / 5
"""The longest averaging time as a share of the record: the variance there has few degrees of freedom."""
MIN_REST = 60.0
"""s that a log must be at rest to show white noise."""
BIAS_REST = 3600.0
"""s at rest in one piece that show a bias."""
TAPERED = 1.94
"""Variance of a mean of neighboring bins of a Hann-tapered periodogram, relative to independent ones."""
CERTAIN = 3.84
"""-2 log likelihood above the best that bounds a 95% interval."""
CLEARLY = 6.0
"""-2 log likelihood by which one kind of bias must exceed the other to rule it out."""
CORRELATION_TIMES = 10.0 ** np.arange(0.5, 6.0, 1 / 8)
"""s of the Gauss-Markov bias that are tried, up to ten times the length of the log: then it is a random walk."""
LATTICE = 10.0 ** np.r_[-3:-1:9j, -0.9:0.9:37j, 1:2:5j]
"""Variances that are tried, relative to the best one."""
MARKOV_PEAK = 0.1908
"""Largest Allan variance of a Gauss-Markov process of unit variance, at 1.89 correlation times."""
FLICKER = 2 * math.log(2) / math.pi
QUANTIZED = 0.5
"""An axis whose steps exceed this many standard deviations is limited by its resolution."""
MOVES = 3.0
"""A second is in motion where an axis varies so many times more than in the calmest tenth of the log."""


@dataclass(frozen=True)
class Interval:
    """A value with its 95% interval; `value` 0 means that the log shows none, `high` then is the most it could hide."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis; `unit` is m/s2 or rad/s.

    Attributes
    ----------
    tau, deviation, error : ndarray, shape (k,)
        Averaging times (s), overlapping Allan deviation (unit), its relative standard error.
    white : Interval
        unit/sqrt(Hz): velocity or angle random walk.
    instability : Interval
        unit: bias instability, the lowest Allan deviation of the fit over 0.664.
    walk : Interval
        unit/sqrt(s): random walk of the bias; of a Gauss-Markov bias std sqrt(2 / correlation time).
    bias_std : Interval
        unit: of a Gauss-Markov bias.
    correlation_time : float
        s: of that bias; 0 where flicker and a random walk explain the log as well.
    drift : float
        unit/s: a trend in one direction, as with temperature; 0 where there is none.
    remarks : tuple of str
        What the log does not show, and faults of the axis.
    """

    axis: str
    unit: str
    white: Interval
    instability: Interval
    walk: Interval
    bias_std: Interval
    correlation_time: float = 0.0
    drift: float = 0.0
    remarks: tuple[str, ...] = ()
    tau: Array = field(default_factory=lambda: np.empty(0))
    deviation: Array = field(default_factory=lambda: np.empty(0))
    error: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class ImuNoise:
    """Noise of the axes of an IMU, from `duration` s at rest, sampled at `rate` Hz."""

    name: str
    rate: float
    duration: float
    axes: dict[str, AxisNoise] = field(default_factory=dict[str, AxisNoise])

    def value(self, axis: str, parameter: str, missing: float = math.nan) -> float:
        """Return a parameter of an axis, or `missing` without that axis."""
        value = getattr(self.axes[axis], parameter) if axis in self.axes else missing
        return value.value if isinstance(value, Interval) else float(value)

    def mean(self, sensor: str, parameter: str) -> float:
        """RMS of a parameter over the axes of the accelerometer ("a") or gyro ("g"); NaN without such axes."""
        values = [self.value(axis, parameter) for axis in self.axes if axis[0] == sensor]
        return math.sqrt(float(np.mean(np.square(values)))) if values else math.nan


def imu_noise(imu: Imu, name: str = "log") -> ImuNoise:
    """Find the noise of an IMU from a log at rest, or from the standstills of a drive.

    Parameters
    ----------
    imu : Imu
        Samples at a constant rate.
    name : str
        Of the log, for messages.

    Raises
    ------
    InputError
        The log is too short, in motion, or has gaps throughout.
    """
    columns = {axis: np.asarray(getattr(imu, axis)) for axis in AXES if getattr(imu, axis) is not None}
    if len(imu.time) < 2:
        raise InputError(
            f"{name}: the IMU has {len(imu.time)} samples; record at least {MIN_REST:g} s at rest"
        )
    interval = float(np.median(np.diff(imu.time)))
    parts = rest(imu.time, columns, interval)
    duration = sum(p.stop - p.start for p in parts) * interval
    if duration < MIN_REST:
        length = imu.time[-1] - imu.time[0]
        why = "is too short" if length < MIN_REST else "moves, or has gaps, too often"
        raise InputError(
            f"{name}: {length:.0f} s of which {duration:.0f} s at rest without a gap; the log {why}: "
            f"record at least {MIN_REST:g} s, better an hour, with the IMU on a firm table"
        )
    axes = {axis: _axis_noise(axis, [values[p] for p in parts], interval) for axis, values in columns.items()}
    return ImuNoise(name, 1 / interval, duration, axes)


def rest(time: Array, columns: dict[str, Array], interval: float) -> list[slice]:
    """Return the parts at rest without gaps, of at least 10 s: seconds in which no axis varies much more than usual."""
    size = max(round(1 / interval), 2)
    cuts = np.flatnonzero(np.diff(time) > 1.5 * interval) + 1
    pieces = [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), len(time)]) if b - a >= size]
    seconds = [
        slice(p.start + k * size, p.start + (k + 1) * size)
        for p in pieces
        for k in range((p.stop - p.start) // size)
    ]
    if not seconds:
        return []
    starts = np.array([s.start for s in seconds])
    calm = np.ones(len(seconds), dtype=bool)
    for values in columns.values():
        spread = np.array([values[s].std() for s in seconds])
        level = np.array([values[s].mean() for s in seconds])
        usual = np.quantile(spread, 0.1) + np.finfo(float).tiny
        step = np.abs(np.diff(level, prepend=level[0]))
        calm &= (spread < MOVES * usual) & (step < MOVES * max(usual, float(np.median(spread))))
    parts: list[slice] = []
    for k in np.flatnonzero(calm):
        start = int(starts[k])
        if parts and parts[-1].stop == start:
            parts[-1] = slice(parts[-1].start, start + size)
        else:
            parts.append(slice(start, start + size))
    for piece in pieces:  # the last, unfinished second of a piece follows its calm last whole one
        for k, part in enumerate(parts):
            if piece.start <= part.start and 0 < piece.stop - part.stop < size:
                parts[k] = slice(part.start, piece.stop)
    return [p for p in parts if (p.stop - p.start) * interval >= 10.0]


@cached
def _second_differences(theta: Array, m: int) -> float:
    """Sum the squared second differences of an integral over m samples."""
    total = 0.0
    for i in range(len(theta) - 2 * m):
        d = theta[i + 2 * m] - 2.0 * theta[i + m] + theta[i]
        total += d * d
    return total


def allan_variance(parts: Sequence[Array], interval: float) -> tuple[Array, Array, Array]:
    """Return averaging times (s), overlapping Allan variances, and their degrees of freedom for white noise.

    Parts are pooled by their numbers of differences.

    Source: IEEE Std 952-1997, annex C; degrees of freedom from W. J. Riley, Handbook of Frequency Stability Analysis
    (NIST SP 1065), 2008, section 5.4.
    """
    longest = max(len(p) for p in parts)
    last = max(longest * LONGEST, 1.0)
    sizes = np.unique(np.round(10.0 ** np.arange(0, math.log10(last) + 1e-9, 1 / PER_DECADE)).astype(int))
    integrals = [np.concatenate([[0.0], np.cumsum(p - p.mean())]) for p in parts]
    variances, freedom = np.empty(len(sizes)), np.empty(len(sizes))
    for k, m in enumerate(sizes):
        usable = [t for t in integrals if len(t) > 2 * m]
        terms = sum(len(t) - 2 * m for t in usable)
        variances[k] = sum(_second_differences(t, m) for t in usable) / (2.0 * m * m * terms)
        freedom[k] = sum(max(_freedom(len(t), m), 1.0) for t in usable)
    return sizes * interval, variances, freedom


def _freedom(n: int, m: int) -> float:
    """Degrees of freedom of an overlapping variance of white frequency noise, n integrals."""
    return (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m * m / (4 * m * m + 5)


@dataclass(frozen=True)
class _Spectrum:
    """Two-sided power spectral densities (unit^2/Hz) in bands, their mean frequencies and numbers of bins."""

    frequency: Array
    density: Array
    count: Array
    interval: float

    def of_white(self) -> Array:
        return np.ones_like(self.frequency)

    def of_flicker(self) -> Array:
        return self.interval / (2 * np.sin(math.pi * self.frequency * self.interval))

    def of_walk(self) -> Array:
        return self.of_flicker() ** 2

    def of_markov(self, time: float) -> Array:
        """A Gauss-Markov bias of unit variance."""
        keep = math.exp(-self.interval / time)
        cosine = np.cos(2 * math.pi * self.frequency * self.interval)
        return self.interval * (1 - keep**2) / (1 - 2 * keep * cosine + keep**2)

    def misfit(self, fitted: Array) -> float:
        """-2 log likelihood."""
        return float(2 / TAPERED * np.sum(self.count * (self.density / fitted + np.log(fitted))))

    def fit(self, columns: Array, fixed: Array | float = 0.0) -> tuple[Array, float]:
        """Return variances (not negative) of processes, beside a fixed density, and the misfit."""
        fitted, terms = self.density + fixed, np.zeros(columns.shape[1])
        for _ in range(12):  # scoring: least squares with the weights of the last fit
            weight = np.sqrt(self.count) / fitted
            scale = np.linalg.norm(columns * weight[:, None], axis=0)
            terms = nnls(columns * weight[:, None] / scale, (self.density - fixed) * weight)[0] / scale
            last, fitted = fitted, np.maximum(columns @ terms + fixed, 1e-6 * self.density)
            if np.max(np.abs(fitted / last - 1)) < 1e-6:
                break
        return terms, self.misfit(fitted)


def _spectrum(values: Array, interval: float) -> _Spectrum:
    """Hann-tapered periodogram without mean and trend; the first bins each, the others in 12 bands an octave."""
    n = len(values)
    taper = np.hanning(n + 2)[1:-1]
    power = np.abs(np.fft.rfft(detrend(values) * taper)) ** 2 * interval / np.sum(taper**2)
    bins = np.arange(3, len(power) - 1)
    bands = np.unique(
        np.r_[bins[:32], np.round(2 ** np.arange(5.2, math.log2(len(power)), 1 / 12))].astype(int)
    )
    bands = bands[bands < bins[-1]]
    count = np.diff(np.append(bands, bins[-1] + 1)).astype(float)
    mean = np.add.reduceat(power[: bins[-1] + 1], bands) / count
    frequency = np.add.reduceat(np.arange(bins[-1] + 1.0), bands) / count / (n * interval)
    return _Spectrum(frequency, mean, count, interval)


@dataclass(frozen=True)
class _Region:
    """Parameters of the best fit, and the lowest and highest ones that are likely enough."""

    best: Array
    low: Array
    high: Array
    correlation_time: float


def _region(spectrum: _Spectrum, length: float) -> _Region:
    """White noise, instability, walk and Gauss-Markov deviation: values and intervals over both kinds of bias."""
    tried: list[tuple[float, float, Array]] = []  # misfit, correlation time, parameters

    def add(columns: Array, time: float, fixed: Sequence[int]) -> None:
        """Try a kind of bias: the best fit, and fits in which the variance of one process has a given value."""
        terms, misfit = spectrum.fit(columns)
        tried.append((misfit, time, _parameters(terms, time, length)))
        for j in fixed:
            others = np.delete(columns, j, axis=1)
            usual = terms[j] or float(np.min(spectrum.density / columns[:, j]))
            for value in (0.0, *usual * LATTICE):
                rest, misfit = spectrum.fit(others, value * columns[:, j])
                tried.append((misfit, time, _parameters(np.insert(rest, j, value), time, length)))

    add(np.stack([spectrum.of_white(), spectrum.of_flicker(), spectrum.of_walk()], axis=1), 0.0, (1, 2))
    for time in CORRELATION_TIMES[
        (20 * spectrum.interval < CORRELATION_TIMES) & (10 * length > CORRELATION_TIMES)
    ]:
        add(np.stack([spectrum.of_white(), spectrum.of_markov(time)], axis=1), time, (1,))
    kinds = [[t for t in tried if (t[1] > 0) == markov] for markov in (False, True)]
    tops = [min(kind, key=lambda t: t[0]) for kind in kinds]
    best = min(tops, key=lambda t: t[0])
    likely = np.array(
        [
            p
            for kind, top in zip(kinds, tops, strict=True)
            if top[0] < best[0] + CLEARLY
            for m, _, p in kind
            if m < top[0] + CERTAIN
        ]
    )
    low, high = np.fmin.reduce(likely), np.fmax.reduce(likely)
    white = 1.96 * math.sqrt(TAPERED / spectrum.count.sum()) / 2
    low[0], high[0] = low[0] * (1 - white), high[0] * (1 + white)
    return _Region(np.nan_to_num(best[2]), np.nan_to_num(low), np.nan_to_num(high, nan=math.inf), best[1])


def _parameters(terms: Array, time: float, length: float) -> Array:
    """White noise, bias instability, random walk and deviation of a Gauss-Markov bias."""
    white, bias = math.sqrt(terms[0]), math.sqrt(terms[1])
    if not time:
        return np.array([white, bias, math.sqrt(terms[2]), math.nan])
    seen = math.sqrt(MARKOV_PEAK / FLICKER) if 1.89 * time < length else 0.0
    return np.array([white, bias * seen, bias * math.sqrt(2 / time), bias])


def _axis_noise(axis: str, parts: list[Array], interval: float) -> AxisNoise:
    whole, unit = np.concatenate(parts), AXES[axis]
    remarks = _faults(axis, whole)
    if whole.std() == 0:
        nothing = Interval(0.0, 0.0, math.inf)
        return AxisNoise(axis, unit, nothing, nothing, nothing, nothing, remarks=tuple(remarks))
    tau, variance, freedom = allan_variance(parts, interval)
    longest = max(parts, key=len)
    length = len(longest) * interval
    region = _region(_spectrum(longest, interval), length)
    values = zip(region.best.tolist(), region.low.tolist(), region.high.tolist(), strict=True)
    white, instability, walk, bias_std = (
        Interval(b, lo, hi) if lo > 0 < b else Interval(0.0, 0.0, hi) for b, lo, hi in values
    )
    drift = _drift(longest, interval, math.hypot(region.best[2] * math.sqrt(length), 3 * region.best[1]))
    if drift:
        remarks.append(f"{axis} drifts by {drift * length:+.2g} {unit} over the log, as with temperature")
    return AxisNoise(
        axis,
        unit,
        white,
        instability,
        walk,
        bias_std,
        region.correlation_time if bias_std.value else 0.0,
        drift,
        tuple(remarks),
        tau,
        np.sqrt(variance),
        1 / np.sqrt(2 * freedom),
    )


def _drift(values: Array, interval: float, usual: float) -> float:
    """Slope (unit/s) of a trend that explains nine tenths of the minute means and exceeds the bias's usual change."""
    size = max(round(60 / interval), 1)
    means = values[: len(values) // size * size].reshape(-1, size).mean(axis=1)
    if len(means) < 10:
        return 0.0
    time = np.arange(len(means)) * size * interval
    slope = float(np.polyfit(time, means, 1)[0])
    explained = float(np.corrcoef(time, means)[0, 1]) ** 2
    change = abs(slope) * len(values) * interval
    return slope if explained > 0.9 and change > 4 * usual else 0.0


def flicker(rng: np.random.Generator, n: int) -> Array:
    """Noise with a spectral density of 1 / (2 pi f): its Allan variance is 2 ln 2 / pi at every averaging time.

    Source: N. J. Kasdin, Discrete simulation of colored noise, Proceedings of the IEEE 83(5), 1995.
    """
    k = np.arange(1, 2 * n)
    response = np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])
    shocks = rng.standard_normal(
        2 * n
    )  # the first half is the past, without which the noise would begin at zero
    size = 2 ** math.ceil(math.log2(4 * n))
    return np.fft.irfft(np.fft.rfft(shocks, size) * np.fft.rfft(response, size), size)[n : 2 * n]


def _faults(axis: str, whole: Array) -> list[str]:
    """Faults of an axis that its noise parameters would hide: constant, quantized or saturated."""
    values = np.unique(whole[:200_000])
    spread, unit = float(whole.std()), AXES[axis]
    if spread == 0:
        return [f"{axis} is constant at {whole[0]:.6g} {unit}: no sensor, or a range that is too coarse"]
    faults: list[str] = []
    step = float(np.min(np.diff(values))) if len(values) > 1 else 0.0
    if step > QUANTIZED * spread and len(values) < 100:
        faults.append(
            f"{axis} is quantized in steps of {step:.3g} {unit}: its white noise is that of the steps"
        )
    for end, name in ((whole.max(), "largest"), (whole.min(), "smallest")):
        share = float(np.mean(whole == end))
        if len(values) > 20 and share > 0.01 and abs(end - np.median(whole)) > 2 * spread:
            faults.append(
                f"{axis} is saturated: {share:.0%} of its samples are the {name} value, {end:.4g} {unit}"
            )
    return faults
