"""Estimate offset and drift between the clocks of IMU and fixes.

The offset is the delay of the fixes that the fits show, up to 2.5 s. With an IMU of six axes, `leveled_delay` is more
accurate, since the gyro measures the changes of tilt. `acceleration_fit` explains these changes by a constant per
window, so its windows must be short. Windows of twice this length contain larger changes of speed, which determine the
delay. `search_offset` finds offsets of up to 40 s, at which the turns of the gyro match those of the course.
`clock_drift` fits the delay of the course in turns along a drive.
"""

import math
from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import (
    DELAYS,
    DIAGONAL_TOLERANCE,
    MIN_VARIED,
    SMALL_SAMPLE,
    AccelerationFit,
    PlanarMounting,
    expected_matrix,
    gyro_heading,
    usable_windows,
)
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.mounting import level_rotation, rotate_imu
from sigmaswarm.doctor.windows import Complex, integral, regress, smoothed, with_prior, without_lines
from sigmaswarm.doctor.yaw_fit import DEGREE, MIN_GAIN_TURN, Yaw, YawFit, yaw_windows
from sigmaswarm.doctor.yaw_fit import DELAYS as YAW_DELAYS
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive

MIN_OFFSET = 0.1  # s, smallest reported offset; the receiver's noise hides smaller offsets
# Ratios of an offset to its standard deviation: note, warning with repair, serious
OFFSET_SIGMAS = (2.5, 3.3, 5.5)
MAX_CONTRADICTION = 3.0  # standard deviations by which two estimates of the offset may differ

LEVELED_WINDOW = 20.0  # s, length of a window
# Smallest number of windows. With the four windows of a minute, the residuals hardly show the standard deviation: in
# two of 2,400 minutes without an offset, the result exceeded 4.5 standard deviations.
MIN_LEVELED_WINDOWS = 7
# Prior means and standard deviations, by index of the unknown: scale k, yaw of the IMU (rad), and coordinates of l (m)
PRIORS = {1: (1.0, DIAGONAL_TOLERANCE), 2: (0.0, 0.1), 7: (0.0, 0.5), 8: (0.0, 0.5)}
MAX_ROUNDS = 10  # largest number of iterations
MAX_CORRECTION = 0.3  # s, largest change of the delay in one iteration
CONVERGED = 2e-3  # s; a smaller change ends the iterations

MAX_OFFSET = 40.0  # s; GPS time minus UTC (18 s) and the start-up of most receivers are shorter
SEARCH_STEP = 0.1  # s, step of the tried offsets
PEAK_WIDTH = 4.0  # s, distance from the best offset within which other offsets belong to the same peak
TURN_INTERVAL = 5.0  # s, interval over which turns are compared
MIN_SEARCH_SHARE = 0.8  # smallest fraction of the variance of the turns that the best offset explains
MIN_SHARE_LEAD = 0.15  # smallest lead in this fraction over offsets outside of the peak
# Alternative to the lead: smallest ratio of the unexplained fraction of any other offset to that of the best offset. If
# turns repeat, other offsets may also explain a large fraction.
MIN_UNEXPLAINED_RATIO = 4.0
MIN_PAIRS = 20  # smallest number of pairs of fixes: see `_pairs`
MIN_SEARCH_TURN = 0.15  # rad, smallest RMS change of the course within `TURN_INTERVAL`

DRIFT_ROUNDS = 8  # number of iterations
MAX_CHANGE = 0.7  # s, largest change of a delay in one iteration
OUTLIER_SIGMAS = 1.5  # standard deviations; larger residuals have less weight
OVERLAP = 2.0  # each fix lies in two windows, so the variance is that of half as many windows
MIN_DRIFT_SIGMAS = 5.5  # smallest ratio of the drift to its standard deviation
MIN_DRIFT = 2e-4  # smallest drift, s per s
MIN_CHANGE = 0.4  # s, smallest change of the delay over the drive
# smallest ratio of this change to the time in which the car travels as far as the standard deviation of a fix
MIN_NOISE_RATIO = 2.0
MAX_DRIFT = 0.01  # the linear model of the delay does not determine a larger drift
MIN_DRIFT_WINDOWS = 4.0  # smallest effective number of windows with turns
MIN_SPEED = 1.0  # m/s, smallest assumed speed v in c / v


@dataclass(frozen=True)
class ClockOffset:
    """Delay of the fixes, its standard deviation, and the largest tried delay, s."""

    delay: float = 0.0
    std: float = math.inf
    max_offset: float = 0.0

    @property
    def least(self) -> float:
        """Smallest delay, s, that is reported as a clock offset."""
        return max(MIN_OFFSET, OFFSET_SIGMAS[0] * self.std)

    @property
    def visible(self) -> float | None:
        """Smallest offset, s, that is detected with a probability of 95%; None if it exceeds the tried delays."""
        offset = self.least + 1.65 * self.std
        return offset if offset < self.max_offset else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Bounds, s, that include the offset with a probability of 95% or more; None beyond the tried delays."""
        half = max(MIN_OFFSET, 2 * self.std)
        low, high = self.delay - half, self.delay + half
        return (low, high) if max(-low, high) < self.max_offset else None

    def refined(self, delay: float, std: float) -> "ClockOffset":
        """Return another estimate from the same data if it is more accurate and agrees with this one; else this one."""
        agrees = abs(delay - self.delay) < MAX_CONTRADICTION * math.hypot(std, self.std)
        return ClockOffset(delay, std, self.max_offset) if std < self.std and agrees else self


def clock_of(
    yaw_fit: YawFit | None, yaw: Yaw, acceleration: AccelerationFit | None, mount: PlanarMounting | None
) -> ClockOffset:
    """Combine the delays that accelerometers and gyro show. Their difference increases the standard deviation."""
    found: list[tuple[float, float]] = []
    max_offset = float(DELAYS[-1])
    if acceleration and mount and any(mount.known) and acceleration.varied > MIN_VARIED:
        # The delay and its standard deviation, given M: the conditional Gaussian of the fit.
        (expected,), slack = expected_matrix(mount.axes, mount.unit, np.array([mount.angle]))
        covariance = acceleration.covariance
        gain = np.linalg.solve(covariance[:4, :4] + slack, covariance[:4, 4])
        delay = acceleration.delay + gain @ (expected - acceleration.matrix.ravel())
        found.append((float(delay), math.sqrt(max(covariance[4, 4] - gain @ covariance[:4, 4], 1e-6))))
    if yaw_fit is not None and yaw.known and yaw_fit.share > 0.5:
        found.append((yaw_fit.delay, yaw_fit.delay_std))
        max_offset = float(YAW_DELAYS[-1])
    if not found:
        return ClockOffset()
    weight = np.array([1 / std**2 for _, std in found])
    delay = float(weight @ [delay for delay, _ in found] / weight.sum())
    chi = float(weight @ [(value - delay) ** 2 for value, _ in found]) / max(len(found) - 1, 1)
    return ClockOffset(delay, math.sqrt(max(chi, 1.0) / weight.sum()), max_offset)


def leveled_delay(drive: Drive, course: Course, delay: float) -> tuple[float, float] | None:
    """Estimate the delay of the fixes and its standard deviation, s. Return None if the drive has too little motion.

    The acceleration, east + i north, is

        k e^(i theta) (ax + i ay) + e^(i theta) b - i g phi,   phi = integral of e^(i theta) (gx + i gy + c)

    with the tilt phi. An error l of the lever arm adds e^(i theta) l to the path. k, b, c and l are common to all
    windows. Each window has its own parabola, for its initial position, speed and tilt. The IMU must have the vehicle's
    axes.

    ``delay`` is the initial value, s.
    """
    imu, rows = drive.imu, usable_windows(drive.imu.time, course, LEVELED_WINDOW)
    if imu.gx is None or imu.gy is None or len(rows) < MIN_LEVELED_WINDOWS:
        return None
    force, rates = imu.ax + 1j * imu.ay, imu.gx - np.median(imu.gx) + 1j * (imu.gy - np.median(imu.gy))
    t = course.time[rows] - course.time[rows].mean(axis=1, keepdims=True)
    own = [(t / np.ptp(t)) ** k + 0j for k in range(3)]
    common = np.array([1.0, 0.0, 0.0])  # k, b and c; complex after the first round
    for _ in range(MAX_ROUNDS):
        at, heading = course.time - delay, np.exp(1j * gyro_heading(imu.time, course, imu.gz, delay))
        tilt, drift = (-1j * GRAVITY * integral(imu.time, heading * rate) for rate in (rates, 1.0 + 0j))
        once = [integral(imu.time, a) for a in (tilt, heading * force, heading, drift)]
        leaning, *moved = (np.interp(at, imu.time, integral(imu.time, v))[rows] for v in once)
        known, *speeds = (np.interp(at, imu.time, v)[rows] for v in once)
        speed = known + sum(k * v for k, v in zip(common, speeds, strict=True))
        paths: list[Complex] = [*moved, np.interp(at, imu.time, heading)[rows] + 0j]
        columns = [-speed, *(factor * path for path in paths for factor in (1.0, 1j))]
        fixes = course.position[rows] - complex(*drive.lever_arm) * paths[-1]
        fit = regress(fixes - leaning, columns, own, np.ones(t.shape), 4)
        solution, covariance = fit.solution, fit.covariance * (1 + SMALL_SAMPLE / len(rows))
        for k, (mean, std) in PRIORS.items():
            solution, covariance = with_prior(solution, covariance, k, mean, std)
        common = solution[1:7:2] + 1j * solution[2:8:2]
        step = float(np.clip(solution[0], -MAX_CORRECTION, MAX_CORRECTION))
        delay += step
        if abs(step) < CONVERGED:
            break
    else:
        return None
    varied = fit.unexplained(0) / math.sqrt(t.size)
    return (delay, math.sqrt(covariance[0, 0])) if varied > MIN_VARIED else None


def search_offset(drive: Drive, course: Course, *, scaled: bool = False) -> float | None:
    """Find the delay of the fixes, s; None if no delay is significant.

    If ``scaled``, also accept any factor of the yaw rate, and a yaw rate in column gx or gy.
    """
    imu, at = drive.imu, course.time
    first, last = _pairs(course)
    if len(first) < MIN_PAIRS:
        return None
    turn = course.angle[last] - course.angle[first]
    whole = float(np.sum((turn - turn.mean()) ** 2))
    if np.sqrt(np.mean((turn - np.mean(turn)) ** 2)) < MIN_SEARCH_TURN:
        return None
    # The rate about the vertical for any mounting, or gz if the IMU lacks one of the six axes.
    planar = imu.az is None or imu.gx is None or imu.gy is None
    rates = [imu.gz if planar else rotate_imu(imu, level_rotation(imu)).gz]
    if scaled and not planar:
        rates += [rate for rate in (imu.gx, imu.gy) if rate is not None]
    totals = [integral(imu.time, rate) for rate in rates]

    def explained(lag: float, total: Array) -> float:
        start, end = at[first] - lag, at[last] - lag
        inside = (start >= imu.time[0]) & (end <= imu.time[-1])
        if np.count_nonzero(inside) < max(MIN_PAIRS, len(turn) / 3):
            return 0.0
        seen = np.interp(end[inside], imu.time, total) - np.interp(start[inside], imu.time, total)
        seen, true = seen - seen.mean(), turn[inside] - turn[inside].mean()
        power = float(true @ true)
        if power < 0.3 * whole:
            return 0.0
        factors = (
            [float(true @ seen) / max(float(seen @ seen), 1e-12)] if scaled else [1.0, -1.0, DEGREE, -DEGREE]
        )
        return max(1 - float(np.sum((true - k * seen) ** 2)) / power for k in factors)

    lags = np.arange(-MAX_OFFSET, MAX_OFFSET + SEARCH_STEP / 2, SEARCH_STEP)
    found = np.array([max(explained(lag, total) for total in totals) for lag in lags])
    best = int(np.argmax(found))
    others = found[np.abs(lags - lags[best]) > PEAK_WIDTH]
    clearly = min(others.max() + MIN_SHARE_LEAD, 1 - (1 - others.max()) / MIN_UNEXPLAINED_RATIO)
    return float(lags[best]) if found[best] >= max(MIN_SEARCH_SHARE, clearly) else None


def _pairs(course: Course) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of pairs of fixes about 5 s apart between which the car never stops."""
    interval = course.interval
    step = max(round(TURN_INTERVAL / interval), 1)
    first = np.arange(max(len(course.time) - step, 0))
    moves = np.append(0, np.cumsum(course.moving))
    first = first[moves[first + step + 1] - moves[first] == step + 1] if len(first) else first
    first = first[course.time[first + step] - course.time[first] < 1.5 * max(TURN_INTERVAL, interval)]
    return first, first + step


@dataclass(frozen=True)
class ClockDrift:
    rate: float  # change of the delay of the fixes per s: negative if the IMU's clock is fast
    std: float
    change: float  # s, change of the delay over the drive


def clock_drift(drive: Drive, course: Course, fit: YawFit, yaw: Yaw, fix_noise: float) -> ClockDrift | None:
    """Fit a delay a + b t of the fixes with which the gyro follows the course in all turns; None if b is insignificant.

    With the residual r of the course in windows and the yaw rate w at the delayed time, -r = w (da + t db + c / v). The
    course of a point at a distance c ahead of the rear axle leads the heading by w c / v, as if the delay were c / v.
    Without the term c / v, a speed v in turns that rises or falls over a drive would appear as a drift. ``fix_noise``
    is the noise from fix to fix, m.
    """
    imu, rows = drive.imu, yaw_windows(course)
    if not yaw.known or fit.course_change < MIN_GAIN_TURN or len(rows) < 4:
        return None
    rate = yaw.rate(imu)
    rate = rate - np.median(rate)
    turned, since = integral(imu.time, rate), course.time - float(course.time[rows].mean())
    within = course.time[rows] - course.time[rows].mean(axis=1, keepdims=True)
    weight = np.minimum(np.abs(course.velocity[rows]) / 10, 1.0)
    rest = without_lines(weight, within)
    seen, length = rest(course.angle[rows]), float(np.ptp(course.time))
    delay = np.array([fit.delay, 0.0, 0.0])
    pace = 1.0 / np.maximum(np.abs(course.velocity), MIN_SPEED)  # s/m

    def linearized(delay: Array) -> tuple[Array, Array, Array]:
        """Return the residuals (w, n), their slopes (w, n, 3) in a, b and c, and the robust weights (w, n)."""
        at = course.time - delay[0] - delay[1] * since - delay[2] * pace
        column = rest(smoothed(imu.time, turned, at, course.span)[rows])
        gain = float(np.vdot(column, seen).real) / max(float(np.vdot(column, column).real), 1e-12)
        turning = -gain * smoothed(imu.time, rate, at, course.span)
        residual, size = seen - gain * column, np.abs(seen - gain * column)
        trust = np.minimum(1.0, OUTLIER_SIGMAS / 0.6745 * np.median(size) / np.maximum(size, 1e-12))
        slopes = [rest((turning * factor)[rows]) for factor in (np.ones_like(since), since, pace)]
        return residual, np.stack(slopes, axis=-1), trust

    for _ in range(DRIFT_ROUNDS):
        step, _ = _solve(*linearized(delay))
        a, b, c = np.abs(step).tolist()
        largest = a + b * length / 2 + c * float(np.median(pace))
        delay = delay + step * min(1.0, MAX_CHANGE / max(largest, 1e-9))
    residual, slopes, trust = linearized(delay)
    std = float(np.sqrt(_solve(residual, slopes, trust)[1][1, 1]))
    power = np.sum(slopes**2, axis=1)  # (w, 3)
    spread = float(np.min((np.sum(power, axis=0) ** 2 / np.maximum(np.sum(power**2, axis=0), 1e-300))[:2]))
    drift, change = float(delay[1]), float(delay[1]) * length
    noise = fix_noise / float(np.median(np.abs(course.velocity[rows])))  # s
    clear = abs(change) > max(MIN_CHANGE, MIN_NOISE_RATIO * noise) and spread >= MIN_DRIFT_WINDOWS
    known = max(MIN_DRIFT_SIGMAS * std, MIN_DRIFT) < abs(drift) < MAX_DRIFT
    return ClockDrift(drift, std, change) if clear and known else None


def _solve(residual: Array, slopes: Array, trust: Array) -> tuple[Array, Array]:
    """Return the correction of a, b and c (3,), and its covariance (3, 3) from a jackknife over windows.

    A covariance from the residuals would be too small, since the fit reduces the residuals of windows with a large
    leverage.
    """
    weighted = trust[:, :, None] * slopes
    inverse = np.linalg.inv(np.einsum("wni,wnj->ij", weighted, slopes) + 1e-9 * np.eye(3))
    step = inverse @ np.einsum("wni,wn->i", weighted, residual)
    of_windows = np.sum(weighted * (residual - slopes @ step)[:, :, None], axis=1)
    others = np.eye(3) - np.einsum("wni,wnj->wij", weighted, slopes) @ inverse
    of_windows = np.linalg.solve(others + 1e-9 * np.eye(3), of_windows[:, :, None])[:, :, 0]
    return step, OVERLAP * inverse @ of_windows.T @ of_windows @ inverse
