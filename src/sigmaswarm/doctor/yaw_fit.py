"""Regression of the course on the integrated gyro: column, gain, and the fixes' delay."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.windows import Regression, integral, regress, smoothed, windows_of
from sigmaswarm.drives.drive import Array, Drive

WINDOW = 20.0
"""s: long enough for turns, and short enough that a gyro's bias gives a straight line."""
EXPLAINED = 0.7
"""Share of the course's changes: a column that explains more is the right one, and others are not tried."""
CLEARLY_BETTER = 0.3
"""Share of them that another column must explain in addition."""
AHEAD = (0.8, 0.8)
"""m, mean and deviation.

How far the antenna is before the rear axle, which does not slide sideways. The course there turns earlier than the car,
by the distance between the two.
"""
LATENESS = np.arange(-2.5, 2.51, 0.1)
"""s by which fixes may be late, tried one after the other."""


@dataclass(frozen=True, eq=False)
class YawFit:
    """A fit of the course to one of the gyro's columns, integrated: course = gain x turned, later by ``late``."""

    column: str
    gain: float  # 1 for a column that turns as the car does
    std: float  # of the gain
    share: float  # of the course's changes that the column explains, 0 to 1
    late: float  # s, by which the fixes are late
    late_std: float  # s
    course_change: float  # rad, how much the course changes within windows, RMS


def fit_yaw(drive: Drive, course: Course) -> YawFit | None:
    """The fit of the column that explains the course best; None where the car hardly drives."""
    rows = yaw_windows(course)
    if not len(rows):
        return None
    own = fit_column(drive, course, "gz", rows)
    if own.share > EXPLAINED:
        return own
    names = [name for name in ("gx", "gy") if getattr(drive.imu, name) is not None]
    better = max([own, *(fit_column(drive, course, name, rows) for name in names)], key=lambda fit: fit.share)
    return better if better.share > own.share + CLEARLY_BETTER else own


def yaw_windows(course: Course) -> NDArray[np.intp]:
    """Indices (w, n) of the fixes of windows in which the car moves."""
    interval = float(np.median(np.diff(course.time)))
    length = min(WINDOW, np.count_nonzero(course.moving) * interval - interval)
    return windows_of(course.time, course.moving, length)


def fit_column(
    drive: Drive, course: Course, column: str, rows: NDArray[np.intp], tried: Array = LATENESS
) -> YawFit:
    """Course = gain x (turned until ``late`` s ago) + each window's own straight line."""
    time = drive.imu.time
    rate: Array = getattr(drive.imu, column)
    rate = rate - np.median(rate)
    turned = integral(time, rate)
    angle = course.angle[rows] + 0j
    t = course.time[rows] - course.time[rows].mean(axis=1, keepdims=True)
    own, speed = [np.ones_like(angle), t + 0j], np.abs(course.velocity[rows])
    weight = speed / 10

    def delayed(values: Array, late: float) -> Array:
        return smoothed(time, values, course.time - late, course.span)[rows]

    def at(late: float, rounds: int = 4, gain: float | None = None) -> Regression:
        columns = [delayed(turned, late) + 0j]
        if gain is not None:
            columns.append(-gain * delayed(rate, late) + 0j)
        return regress(angle, columns, own, weight, rounds)

    late, late_std = float(tried[0]), 0.0
    if len(tried) > 1:
        late = float(min(tried, key=lambda late: at(float(late), 1).cost))
    for _ in range(4):
        joint = at(late, gain=float(at(late).solution[0]))
        # A car that never turns shows nothing of the clock: the column is zero, and so is its covariance.
        late_std = math.sqrt(joint.covariance[1, 1]) or math.inf
        late += float(np.clip(joint.solution[1], -0.1, 0.1))
    fit = at(late)
    turning = delayed(rate, late) ** 2
    slowness = float(np.sum(turning / speed) / max(np.sum(turning), 1e-12))  # s/m, in turns
    flat = regress(angle, [np.zeros_like(angle)], own, weight, 1)
    left, whole = (float(np.sum(np.abs(weight * r.residual) ** 2)) for r in (fit, flat))
    return YawFit(
        column,
        float(fit.solution[0]),
        float(np.sqrt(fit.covariance[0, 0])),
        1 - left / max(whole, 1e-12),
        late + AHEAD[0] * slowness,
        float(np.hypot(late_std, AHEAD[1] * slowness)),
        float(np.sqrt(np.mean(np.abs(flat.residual) ** 2))),
    )
