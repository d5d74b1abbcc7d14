"""Estimate the drift between the clocks of IMU and fixes from the delay of the course in turns along a drive."""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.verdicts import MIN_GAIN_TURN
from sigmaswarm.doctor.windows import integral, smoothed, without_lines
from sigmaswarm.doctor.yaw_fit import yaw_windows

ROUNDS = 8  # number of iterations
MAX_CHANGE = 0.7  # s, largest change of a delay in one iteration
OUTLIER_SIGMAS = 1.5  # standard deviations; larger residuals have less weight
OVERLAP = 2.0  # each fix lies in two windows, so the variance is that of half as many windows
MIN_SIGMAS = 5.5  # smallest ratio of the drift to its standard deviation
MIN_DRIFT = 2e-4  # smallest drift, s per s
MIN_CHANGE = 0.4  # s, smallest change of the delay over the drive
# smallest ratio of this change to the time in which the car travels as far as the standard deviation of a fix
MIN_NOISE_RATIO = 2.0
MAX_DRIFT = 0.01  # the linear model of the delay does not determine a larger drift
MIN_WINDOWS = 4.0  # smallest effective number of windows with turns
MIN_SPEED = 1.0  # m/s, smallest assumed speed v in c / v


@dataclass(frozen=True)
class ClockDrift:
    rate: float  # change of the delay of the fixes per s: negative if the IMU's clock is fast
    std: float
    change: float  # s, change of the delay over the drive


def clock_drift(evidence: Evidence) -> ClockDrift | None:
    """Fit a delay a + b t of the fixes, at which the gyro follows the course in all turns; None if b is insignificant.

    With the residual r of the course in windows and the yaw rate w at the delayed time, -r = w (da + t db + c / v). The
    course of a point at a distance c ahead of the rear axle leads the heading by w c / v, which is a delay of c / v: if
    the speed v in turns rises or falls over a drive, this delay would otherwise appear as a drift.
    """
    course, fit, yaw, imu = evidence.course, evidence.yaw_fit, evidence.yaw, evidence.drive.imu
    if course is None or fit is None or not yaw.known or fit.course_change < MIN_GAIN_TURN:
        return None
    rows = yaw_windows(course)
    if len(rows) < 4:
        return None
    rate = yaw.factor * getattr(imu, yaw.column)
    rate = rate - np.median(rate)
    turned, since = integral(imu.time, rate), course.time - float(course.time[rows].mean())
    within = course.time[rows] - course.time[rows].mean(axis=1, keepdims=True)
    weight = np.minimum(np.abs(course.velocity[rows]) / 10, 1.0)
    rest = without_lines(weight, within)
    seen, delay, length = (
        rest(course.angle[rows]),
        np.array([fit.delay, 0.0, 0.0]),
        float(np.ptp(course.time)),
    )
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

    for _ in range(ROUNDS):
        step, _ = _solve(*linearized(delay))
        largest = (
            abs(float(step[0]))
            + abs(float(step[1])) * length / 2
            + abs(float(step[2])) * float(np.median(pace))
        )
        delay = delay + step * min(1.0, MAX_CHANGE / max(largest, 1e-9))
    residual, slopes, trust = linearized(delay)
    std = float(np.sqrt(_solve(residual, slopes, trust)[1][1, 1]))
    power = np.sum(slopes**2, axis=1)  # (w, 3)
    spread = float(np.min((np.sum(power, axis=0) ** 2 / np.maximum(np.sum(power**2, axis=0), 1e-300))[:2]))
    drift, change = float(delay[1]), float(delay[1]) * length
    noise = evidence.noise / float(np.median(np.abs(course.velocity[rows])))  # s
    clear = abs(change) > max(MIN_CHANGE, MIN_NOISE_RATIO * noise) and spread >= MIN_WINDOWS
    known = max(MIN_SIGMAS * std, MIN_DRIFT) < abs(drift) < MAX_DRIFT
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
