"""Compare the fixes with the truth: delay of the fixes, and size of their errors."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import SMALL_SAMPLE
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.truth_clock import MIN_DELAY
from sigmaswarm.doctor.windows import Complex, regress, windows_of
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.drives.sensors import antenna_track

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


@dataclass(frozen=True)
class TruthFit:
    delay: float  # s, delay of the fixes relative to the truth's clock
    std: float  # s, standard deviation of `delay`
    # m per axis, robust standard deviations of the errors of the fixes: about zero, and about their median, which
    # another origin of the truth may displace; 0 if the truth is inaccurate
    error: float
    variation: float


def fit_truth(drive: Drive, course: Course) -> TruthFit | None:
    """Fit the delay of the fixes to the truth's velocity; return None without enough truth.

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
        return np.interp(times, true_time, antenna.real) + 1j * np.interp(times, true_time, antenna.imag)

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
    if _spread(fit.residual) > MAX_REST * _spread(path - path.mean(axis=1, keepdims=True)):
        return None  # the truth is another path, or its clock is far off
    std = math.sqrt(fit.covariance[0, 0] * (1 + SMALL_SAMPLE / len(rows)))
    off = min((course.position[known] - at(time[known] - d) for d in (0.0, delay)), key=_spread)
    error, variation = _spread(off), _spread(off - complex(np.median(off.real), np.median(off.imag)))
    if truth.std is not None and float(np.median(truth.std)) > MAX_TRUTH_SHARE * variation:
        error = variation = 0.0
    return TruthFit(delay, std, error, variation) if std > 0 and abs(delay) < MIN_DELAY else None


def truth_as_fixes(drive: Drive, fit: TruthFit) -> Drive:
    """Replace the fixes by the truth, which has far smaller errors, on the clock of the fixes."""
    truth = drive.truth
    assert truth is not None
    time, antenna = antenna_track(drive, truth)
    every = max(round(STEP / float(np.median(np.diff(time)))), 1)
    x, y = (np.asarray(part[::every], np.float64) for part in (antenna.real, antenna.imag))
    return replace(drive, gps=Gps(time[::every] + fit.delay, x, y))


def _spread(off: Complex) -> float:
    return float(np.median(np.abs(np.concatenate([off.real.ravel(), off.imag.ravel()]))) / 0.6745)
