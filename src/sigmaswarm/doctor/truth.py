"""Compare the fixes with the truth: delay of the truth's clock, delay of the fixes, and size of their errors."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import SMALL_SAMPLE
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.windows import Complex, regress, windows_of
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.drives.sensors import antenna_track, robust_std

CLOCK_STEP, FINE_STEP = 0.5, 0.01  # s, steps of the tried delays, and of those near the best delay
# Time over which a velocity is computed: in s, and in usual intervals between positions; the larger value applies
CLOCK_BASE, CLOCK_BASE_INTERVALS = 2.0, 2.0
# Longest interval between positions within this time: in s, and in usual intervals; the larger value applies
MAX_CLOCK_GAP, CLOCK_GAP_INTERVALS = 3.0, 1.5
MAX_SPEED = 150.0  # m/s, largest velocity that is compared
MIN_TIME = 20.0  # s, shortest time with both velocities
MIN_OVERLAP = 0.65  # smallest fraction of the shorter of the two tracks with both velocities
MIN_SPEED = 1.0  # m/s, lowest RMS speed
MIN_DELAY = 2.5  # s, smallest delay of a wrong clock; larger than the delay of a receiver
MAX_DIFFERENCE = 0.1  # largest relative difference of the velocities at the best delay: see `truth_delay`
# smallest ratio of the difference at other delays, and without a delay, to the difference at the best delay
MIN_RATIO = 3.0
PEAK_WIDTH = 10.0  # s; delays closer to the best delay do not count as other delays

WINDOW = 20.0  # s; within this time, lasting errors of the fixes are about constant
MIN_WINDOWS = 3
# Longest interval of the truth that is interpolated: in s, and in usual intervals; the larger value applies
MAX_GAP, GAP_INTERVALS = 0.5, 1.5
BASE = 0.5  # s, over which velocities are computed
MAX_ROUNDS = 10  # largest number of iterations
MAX_STEP = 0.3  # s, largest change of the delay in one iteration
CONVERGED = 1e-3  # s; a smaller change ends the iterations
STEP = 0.1  # s, smallest interval of the truth that replaces the fixes
MAX_REST = 0.2  # largest difference of fixes and truth in a window, relative to the path in it
MAX_TRUTH_SHARE = 0.5  # largest standard deviation of the truth, relative to the errors of the fixes


def truth_delay(time: Array, fixes: Complex, truth_time: Array, truth: Complex) -> float | None:
    """Find the delay of the truth's clock, s, from the truth (m,) and the fixes (n,), east + i north, m.

    Return None if no delay makes the velocities agree, or if several delays do. At a given delay, the relative
    difference of the velocities v and w is the sum of |v - w|^2 divided by the sum of |v|^2 + |w|^2, over the times at
    which both are known.
    """
    if min(len(time), len(truth_time)) < 3:
        return None
    usual = max(float(np.median(np.diff(t))) for t in (time, truth_time))
    (begin, v, known), (start, w, seen) = (
        _velocities(*track, usual) for track in ((time, fixes), (truth_time, truth))
    )
    if not known.any() or not seen.any():
        return None
    count = correlate(seen, known, method="fft")
    power = correlate(seen, np.abs(v) ** 2, method="fft") + correlate(np.abs(w) ** 2, known, method="fft")
    enough = count >= max(MIN_TIME / CLOCK_STEP, MIN_OVERLAP * min(known.sum(), seen.sum()))
    valid = enough & (power > 2 * MIN_SPEED**2 * count)
    products = correlate(w, v, method="fft").real
    apart = np.where(valid, 1 - 2 * products / np.where(valid, power, 1.0), np.inf)
    delays = (np.arange(len(apart)) - (len(v) - 1)) * CLOCK_STEP + start - begin
    best, none = int(np.argmin(apart)), int(np.argmin(np.abs(delays)))
    least = MIN_RATIO * max(float(apart[best]), 1e-6)
    others = apart[np.abs(delays - delays[best]) > PEAK_WIDTH]
    wrong = abs(delays[best]) >= MIN_DELAY
    without = np.inf
    if wrong and abs(delays[none]) < CLOCK_STEP:
        # The difference without a delay over the same fixes: a delay may only exclude a part with bad fixes.
        i = np.arange(len(v))
        at, there = i + none - (len(v) - 1), i + best - (len(v) - 1)
        both = (known > 0) & _inside(there, seen) & _inside(at, seen)
        one, other = v[both], w[at[both]]
        size = float(np.sum(np.abs(one) ** 2 + np.abs(other) ** 2))
        same = float(np.sum(np.abs(one - other) ** 2)) / max(size, 1e-12)
        without = min(float(apart[none]), same)
    if apart[best] >= MAX_DIFFERENCE or min(without, others.min(initial=np.inf)) <= least:
        return None
    near = delays[best] + np.arange(-CLOCK_STEP, CLOCK_STEP + FINE_STEP / 2, FINE_STEP)
    inside = (time + near[0] >= truth_time[0]) & (time + near[-1] <= truth_time[-1])

    def distance(delay: float) -> float:
        apart = fixes[inside] - _at(time[inside] + delay, truth_time, truth)
        return float(np.mean(np.abs(apart - np.mean(apart)) ** 2))

    return round(float(min(near, key=distance)), 2)


def _inside(index: NDArray[np.intp], known: Array) -> NDArray[np.bool_]:
    """Return True where an index is inside an array and its element is not 0."""
    inside = (index >= 0) & (index < len(known))
    return inside & (known[index.clip(0, len(known) - 1)] > 0)


def _velocities(time: Array, position: Complex, usual: float) -> tuple[float, Complex, Array]:
    """Return the first time, the velocities (k,), m/s, at steps of `CLOCK_STEP` s, and 1 where they are known, else 0.

    ``usual`` is the longer of the usual intervals of fixes and truth, s.
    """
    base = max(CLOCK_BASE, CLOCK_BASE_INTERVALS * usual)
    grid = np.arange(np.ceil(time[0] / CLOCK_STEP), np.floor(time[-1] / CLOCK_STEP) + 1) * CLOCK_STEP
    first, last = (np.asarray(grid + side * base / 2, np.float64) for side in (-1, 1))
    velocity = (_at(last, time, position) - _at(first, time, position)) / base
    # A velocity is unknown in intervals without positions.
    long = np.append(0, np.cumsum(np.diff(time) > max(MAX_CLOCK_GAP, CLOCK_GAP_INTERVALS * usual)))
    i, j = np.searchsorted(time, first), np.searchsorted(time, last, side="right") - 1
    inside = (first >= time[0]) & (last <= time[-1]) & (np.abs(velocity) < MAX_SPEED)
    known = inside & (long[np.clip(j + 1, 0, len(long) - 1)] == long[np.clip(i - 1, 0, len(long) - 1)])
    return float(grid[0]) if len(grid) else 0.0, velocity * known, known.astype(np.float64)


def _at(time: Array, known: Array, position: Complex) -> Complex:
    return np.interp(time, known, position.real) + 1j * np.interp(time, known, position.imag)


@dataclass(frozen=True)
class TruthFit:
    delay: float  # s, delay of the fixes relative to the truth's clock
    std: float  # s, standard deviation of `delay`
    # m per axis, robust standard deviations of the errors of the fixes: about zero, and about their median, which
    # another origin of the truth may displace; 0 if the truth is inaccurate
    error: float
    variation: float


def fit_truth(drive: Drive, course: Course) -> TruthFit | None:
    """Fit the delay of the fixes to the truth's velocity. Return None without enough truth.

    In each window, a constant represents lasting errors of the fixes.
    """
    if (truth := drive.truth) is None:
        return None
    time, (true_time, antenna) = course.time, antenna_track(drive, truth)
    if len(true_time) < 2:
        return None
    steps = np.diff(true_time)
    gap = np.clip(np.searchsorted(true_time, time) - 1, 0, len(steps) - 1)
    known = steps[gap] < max(MAX_GAP, GAP_INTERVALS * float(np.median(steps)))
    known &= (time > true_time[0] + MIN_DELAY) & (time < true_time[-1] - MIN_DELAY)
    rows = windows_of(time, known, WINDOW)
    if len(rows) < MIN_WINDOWS:
        return None
    delay = 0.0

    def at(times: Array) -> Complex:
        return _at(times, true_time, antenna)

    for _ in range(MAX_ROUNDS):
        off, when = course.position - at(time - delay), time - delay
        velocity = (at(when + BASE / 2) - at(when - BASE / 2)) / BASE
        own = [np.ones(rows.shape, dtype=np.complex128)]
        fit = regress(off[rows], [-velocity[rows]], own, np.ones(rows.shape), 4)
        step = float(np.clip(fit.solution[0], -MAX_STEP, MAX_STEP))
        delay += step
        if abs(step) < CONVERGED:
            break
    else:
        return None
    path = course.position[rows]
    if robust_std(fit.residual) > MAX_REST * robust_std(path - path.mean(axis=1, keepdims=True)):
        return None  # the truth is another path, or its clock is far off
    std = math.sqrt(fit.covariance[0, 0] * (1 + SMALL_SAMPLE / len(rows)))
    off = min((course.position[known] - at(time[known] - d) for d in (0.0, delay)), key=robust_std)
    error, variation = robust_std(off), robust_std(off - complex(np.median(off.real), np.median(off.imag)))
    if truth.std is not None and float(np.median(truth.std)) > MAX_TRUTH_SHARE * variation:
        error = variation = 0.0
    return TruthFit(delay, std, error, variation) if std > 0 and abs(delay) < MIN_DELAY else None


def truth_as_fixes(drive: Drive, fit: TruthFit) -> Drive:
    """Replace the fixes by the truth, whose errors are far smaller, on the clock of the fixes."""
    truth = drive.truth
    assert truth is not None
    time, antenna = antenna_track(drive, truth)
    every = max(round(STEP / float(np.median(np.diff(time)))), 1)
    x, y = (np.asarray(part[::every], np.float64) for part in (antenna.real, antenna.imag))
    return replace(drive, gps=Gps(time[::every] + fit.delay, x, y))
