"""Regression of the course on the integrated gyro and its interpretation: column, sign, unit, delay of the fixes."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.windows import Regression, integral, regress, smoothed, windows_of, without_lines
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive, Imu

WINDOW = 20.0  # s: long enough for turns, and so short that the integral of a bias is a straight line
# Fraction of the variance of the course's changes that gz must explain so that no other column is tried
SUFFICIENT_SHARE = 0.7
MIN_LEAD = 0.3  # smallest lead of another column over gz in the explained fraction
# m, mean and standard deviation of the antenna's distance ahead of the rear axle, which does not slide sideways. The
# antenna's course changes earlier, by the time in which the car drives this distance.
ANTENNA_DISTANCE = (0.8, 0.8)
MIN_DELAY_STD = 0.1  # s, smallest standard deviation of the delay as a prior
# Relative change of the gain, if the delay is ignored, above which the fit does not separate gain and delay. In a slow
# turn after a standstill, gains of correct gyros were 1.3 to 1.7 with delays of 0.7 to 1.1 s, and 1.04 to 1.15 without
# a delay.
MAX_DELAY_EFFECT = 0.1
DELAYS = np.arange(-2.5, 2.51, 0.1)  # s, delays of the fixes to try

DEGREE = math.pi / 180
# A gain within this ratio of 1 or pi/180, with either sign, is read as exactly 1 or pi/180
FACTOR_TOLERANCE = 1.35
# Smallest explained fraction of the course's changes if the gain is below `MIN_GAIN_SIGMAS` standard deviations
MIN_EXPLAINED = 0.2
MAX_RANGE = 4  # binary logarithm of the largest ratio of two ranges of a gyro
MIN_GAIN_ERROR = 0.1  # smallest reported relative difference of a gain from a factor
# rad, RMS change of the course within 20 s below which the course is mostly noise
MIN_GAIN_TURN = 0.05
# rad, RMS change of the course within 20 s above which it determines column, sign and unit of the gyro. Below it, any
# interpretation other than gz in rad/s must exceed `MIN_GAIN_SIGMAS` or `LARGE_SHARE`, and no other factor is accepted:
# on 3 of 342 windows of 60 s in real drives, a lane change in a city led to gains of -1.3, 1.4 and 1.6.
CLEAR_GAIN_TURN = 0.1
LARGE_SHARE = 0.5  # fraction of the variance of the course's changes that a column explains
# Ratio of a gain to its standard deviation above which a column may explain a small fraction of the course's changes.
# In a city, most of these changes are errors of the fixes.
MIN_GAIN_SIGMAS = 12.0
# Multiple of `MIN_GAIN_SIGMAS` above which a column that explains a small fraction follows the course. In windows of 60
# s, wrong gains reached 1.2 times `MIN_GAIN_SIGMAS`; in a drive of 40 min with many wrong fixes, the right gain reaches
# 4.8 times `MIN_GAIN_SIGMAS`.
MIN_FOLLOWING_RATIO = 3.0


@dataclass(frozen=True, eq=False)
class YawFit:
    """Fit of the course to the integral of a gyro column: course = gain x integral, delayed by ``delay``."""

    column: str
    gain: float  # 1 for the yaw rate of the car in rad/s
    std: float  # standard deviation of the gain
    share: float  # fraction of the variance of the course's changes that the column explains, 0 to 1
    delay: float  # s, delay of the fixes
    delay_std: float  # s, standard deviation of `delay`
    course_change: float  # rad, RMS change of the course within windows
    undelayed: float  # gain of a fit without a delay

    @property
    def separates_delay(self) -> bool:
        return abs(self.undelayed - self.gain) < MAX_DELAY_EFFECT * abs(self.gain)

    @property
    def delay_prior(self) -> tuple[float, float]:
        """The delay and its standard deviation, s, as a prior for other fits."""
        return self.delay, math.hypot(self.delay_std, MIN_DELAY_STD)


def fit_yaw(drive: Drive, course: Course) -> YawFit | None:
    """Fit gz, or another column that explains the course clearly better. Return None if the car hardly moves."""
    rows = yaw_windows(course)
    if not len(rows):
        return None
    own = fit_column(drive, course, "gz", rows)
    if own.share > SUFFICIENT_SHARE:
        return own
    names = [name for name in ("gx", "gy") if getattr(drive.imu, name) is not None]
    better = max([own, *(fit_column(drive, course, name, rows) for name in names)], key=lambda fit: fit.share)
    return better if better.share > own.share + MIN_LEAD else own


def yaw_windows(course: Course) -> NDArray[np.intp]:
    """Return the indices (w, n) of windows in which the car moves."""
    interval = course.interval
    length = min(WINDOW, np.count_nonzero(course.moving) * interval - interval)
    return windows_of(course.time, course.moving, length)


def fit_column(
    drive: Drive, course: Course, column: str, rows: NDArray[np.intp], tried: Array = DELAYS
) -> YawFit:
    """Fit course = gain x (integral until ``delay`` s ago) + a straight line in each window."""
    time = drive.imu.time
    rate: Array = getattr(drive.imu, column)
    rate = rate - np.median(rate)
    turned = integral(time, rate)
    angle = course.angle[rows] + 0j
    t = course.time[rows] - course.time[rows].mean(axis=1, keepdims=True)
    own, speed = [np.ones_like(angle), t + 0j], np.abs(course.velocity[rows])
    weight = speed / 10

    def delayed(values: Array, delay: float) -> Array:
        return smoothed(time, values, course.time - delay, course.span)[rows]

    def at(delay: float, rounds: int = 4, gain: float | None = None) -> Regression:
        columns = [delayed(turned, delay) + 0j]
        if gain is not None:
            columns.append(-gain * delayed(rate, delay) + 0j)
        return regress(angle, columns, own, weight, rounds)

    rest = without_lines(weight, t)
    seen = rest(course.angle[rows])

    def misfit(delay: float) -> float:
        column = rest(delayed(turned, delay))
        return float(
            np.mean(np.abs(seen - np.vdot(column, seen) / max(np.vdot(column, column), 1e-300) * column))
        )

    delay, delay_std = float(tried[0] if len(tried) == 1 else min(tried, key=misfit)), 0.0
    for _ in range(4):
        joint = at(delay, gain=float(at(delay).solution[0]))
        # If the car never turns, the column is zero, and so is its covariance.
        delay_std = math.sqrt(joint.covariance[1, 1]) or math.inf
        delay += float(np.clip(joint.solution[1], -0.1, 0.1))
    fit = at(delay)
    turning = delayed(rate, delay) ** 2
    slowness = float(np.sum(turning / speed) / max(np.sum(turning), 1e-12))  # s/m, in turns
    flat = regress(angle, [np.zeros_like(angle)], own, weight, 1)
    left, whole = (float(np.sum(np.abs(weight * r.residual) ** 2)) for r in (fit, flat))
    gain, std = float(fit.solution[0]), float(np.sqrt(fit.covariance[0, 0]))
    delay += ANTENNA_DISTANCE[0] * slowness
    delay_std = float(np.hypot(delay_std, ANTENNA_DISTANCE[1] * slowness))
    change, undelayed = float(np.sqrt(np.mean(np.abs(flat.residual) ** 2))), float(at(0.0).solution[0])
    return YawFit(column, gain, std, 1 - left / max(whole, 1e-12), delay, delay_std, change, undelayed)


@dataclass(frozen=True)
class Yaw:
    """The yaw rate in rad/s, as a column times a factor."""

    column: str = "gz"
    factor: float = 1.0
    known: bool = False  # True if the drive determines column and factor

    def rate(self, imu: Imu) -> Array:
        return self.factor * getattr(imu, self.column)


def yaw_of(fit: YawFit | None, imu: Imu) -> Yaw:
    """Find column, sign and unit of the gyro from the course.

    If the course does not show them, the result is gz in rad/s. A factor that no unit explains is accepted only if
    three conditions hold: the column clearly follows the course, the gain hardly depends on the delay, and the axes are
    level, since a tilt reduces the rate.
    """
    size = abs(fit.gain) / max(fit.std, 1e-12) if fit else 0.0
    if fit is None or size < 6 or (fit.share < MIN_EXPLAINED and size < MIN_GAIN_SIGMAS):
        return Yaw()
    fitting = _units_of(fit.gain)
    follows = size > (1 if fit.share > SUFFICIENT_SHARE else MIN_FOLLOWING_RATIO) * MIN_GAIN_SIGMAS
    follows = follows and fit.separates_delay and not _units_of(fit.undelayed)
    if not fitting and follows and fit.course_change > CLEAR_GAIN_TURN and _is_level(imu):
        exponent = round(math.log2(abs(fit.gain)))
        power = math.copysign(2.0**exponent, fit.gain)
        another_range = abs(exponent) <= MAX_RANGE and abs(fit.gain / power - 1) < MIN_GAIN_ERROR
        fitting = [power if another_range else fit.gain]
    clear = size > MIN_GAIN_SIGMAS or fit.share > LARGE_SHARE or fit.course_change > CLEAR_GAIN_TURN
    if not fitting or not (clear or (fit.column, fitting[0]) == ("gz", 1.0)):
        return Yaw()
    return Yaw(fit.column, fitting[0], known=True)


def _units_of(gain: float) -> list[float]:
    """Return the factors to rad/s (units with sign) that explain a gain, or nothing if no unit does."""
    return [f for f in (1.0, -1.0, DEGREE, -DEGREE) if 1 / FACTOR_TOLERANCE < gain / f < FACTOR_TOLERANCE]


def _is_level(imu: Imu) -> bool:
    up = GRAVITY if imu.az is None else float(np.median(imu.az))
    return math.hypot(np.median(imu.ax), np.median(imu.ay)) < abs(up)
