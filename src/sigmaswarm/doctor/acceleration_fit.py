"""Regression of the path on the accelerations: axes, units, scale, tilt, and delay of the fixes.

In windows of several seconds, the IMU determines the path, integrated from an unknown position and velocity:

    p(t) = p0 + v0 t + double integral of e^(i theta) (M u + b),   u = (ax, ay) as recorded

Vectors (2,) are also complex numbers, x + i y. The fixes show this path with a delay of ``delay`` s. The heading theta
is estimated from course and gyro. M (2, 2) and ``delay`` are common to all windows; p0, v0 and b (tilt, slope, bias)
differ between windows. The mean of b is also fitted. For a log without faults, M is the identity.
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.windows import Complex, Regression, integral, regress, smoothed, windows_of, with_prior
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import white_noise

WINDOW = 10.0  # s: long enough to contain accelerations, short enough for constant tilt and slope
BIAS_SPREAD = (0.1, 0.5)  # m/s2, bounds of the spread of b (tilt, slope, bias) between windows
# The covariance is multiplied by 1 + SMALL_SAMPLE / k, where k is the number of windows
SMALL_SAMPLE = 8.0
MIN_NOISE = 0.03  # m, smallest assumed noise of the IMU's path over several seconds

DELAYS = np.arange(-0.8, 0.81, 0.1)  # s, delays of the fixes to try
DRIFT_SPAN = 6.0  # s, standard deviation of the Gaussian window in which the gyro's integral is aligned with the course
BIN = 3.0  # s, length of the bins to which this window is applied

# m/s, smallest `AccelerationFit.varied` that determines the delay; noise of the IMU causes up to 0.04 m/s
MIN_VARIED = 0.1
# Smallest decrease in chi-square for which another interpretation replaces the recorded one. Also the largest
# chi-square of an interpretation in g (logs in g have 4), since in steady circles, the forces hardly exceed the noise
# and do not determine the unit.
MIN_LEAD = 16.0
# Tolerance of the off-diagonal elements of M, for slip, and for tilt in maneuvers
OFF_DIAGONAL_TOLERANCE = 0.05
# Tolerance of the diagonal elements of M: roll and pitch of the body add 5 to 10% to the acceleration
DIAGONAL_TOLERANCE = 0.12
MAX_ELEMENT_STD = 0.25  # standard deviation of an element of M below which the drive determines it
MAX_RECORDED_ANGLE = math.radians(5)  # rad, largest rotation about z without a penalty
ANGLES = np.radians(np.arange(-40.0, 40.5, 0.5))


@dataclass(frozen=True, eq=False)
class AccelerationFit:
    matrix: Array  # (2, 2), M: maps the recorded (ax, ay) to accelerations forward and left, m/s2
    covariance: Array  # (5, 5), of the rows of M, one after the other, and of `delay`
    delay: float  # s, delay of the fixes
    bias_std: Array  # (2,) m/s2, of the mean of b; in steady circles b is hardly distinguishable from M
    bias: Array  # (k, 2) m/s2, forward and left, b of each window
    rows: NDArray[np.intp]  # (k, n), the fixes of each window
    residual: Complex  # (k, n) m, east + i north
    varied: float  # m/s, RMS of the velocity that no other unknown explains; 0 on a circle at constant speed


def _off_course(time: Array, course: Course, rate: Array, delay: float) -> tuple[Array, Array]:
    """Return the gyro's integral (n,), rad, and the course minus this integral where the car moves, rad."""
    turned = integral(time, rate)
    seen = course.moving
    return turned, course.angle[seen] - smoothed(time, turned, course.time[seen] - delay, course.span)


def gyro_heading(time: Array, course: Course, rate: Array, delay: float) -> Array:
    """Return the heading (n,), rad, at the IMU's times: the gyro's integral, aligned with the course near each time.

    ``rate`` (n,) is the yaw rate, rad/s, with correct sign and unit. ``delay`` is the delay of the fixes, s.
    """
    turned, off = _off_course(time, course, rate + gyro_drift(time, course, rate, delay), delay)
    at, speed = course.time[course.moving], np.abs(course.velocity[course.moving])
    jump = np.append(0.0, np.cumsum(np.round(np.diff(off) / (2 * np.pi)))) * 2 * np.pi
    off = off - jump  # the course may turn by whole circles while the car is stationary
    bin_of = ((at - at[0]) // BIN).astype(np.intp)
    bell = np.exp(-0.5 * (np.arange(-6, 7) * BIN / DRIFT_SPAN) ** 2)
    # The course of a faster car is more accurate.
    weight, total = (np.convolve(np.bincount(bin_of, v), bell)[6:-6] for v in (speed, speed * off))
    middles = at[0] - delay + BIN * (np.arange(len(weight)) + 0.5)
    return turned + np.interp(time, middles[weight > 0], (total / np.maximum(weight, 1e-12))[weight > 0])


def gyro_drift(time: Array, course: Course, rate: Array, delay: float) -> float:
    """Return the negative gyro bias, rad/s, estimated from the drift between the course and the integrated yaw rate."""
    _, off = _off_course(time, course, rate, delay)
    step = max(round(DRIFT_SPAN / course.interval), 1)
    if len(off) <= step:
        return 0.0
    at = course.time[course.moving]
    return float(np.median((off[step:] - off[:-step]) / (at[step:] - at[:-step])))


def fit_acceleration(
    drive: Drive, course: Course, rate: Array, tried: Array = DELAYS, known: tuple[float, float] | None = None
) -> AccelerationFit | None:
    """Fit the IMU's path to the fixes. Return None if no window is usable.

    ``rate`` (n,) is the yaw rate, rad/s. ``tried`` contains initial values of the delay, s. ``known`` is the delay with
    its standard deviation, s, from other data, since turns at constant speed hardly distinguish the delay from M.
    """
    rows = usable_windows(drive.imu.time, course, WINDOW)
    if not len(rows):
        return None
    fit = _Fit(drive, course, rate, rows, known)
    first = tried[0] if len(tried) == 1 else min(tried, key=lambda delay: fit.at(float(delay), rounds=1).cost)
    delay = float(first)
    for k in range(10):
        found = fit.at(delay)
        step = 1.0
        if k > 1:  # the column of the delay needs M and the biases, which the first rounds find
            step = float(np.clip(fit.solved(found, delay)[0][4], -0.2, 0.2))
            delay += step
        if abs(step) < 1e-3:
            break
        fit.learn(found, delay)
    found = fit.at(delay)
    fit.learn(found, delay)
    solution, covariance = fit.solved(found, delay)
    matrix = solution[:4].reshape(2, 2)
    bias_std = np.sqrt(np.diag(covariance)[5:])
    rest = found.residual[:, :-1]
    varied = found.unexplained(4) / np.sqrt(rest.size)
    return AccelerationFit(matrix, covariance[:5, :5], delay, bias_std, fit.bias, rows, rest, varied)


def usable_windows(imu: Array, course: Course, longest: float) -> NDArray[np.intp]:
    """Return the fixes (w, n) of usable windows: no gap in the times ``imu``, s, and motion at over 30% of fixes."""
    interval = course.interval
    length = float(np.clip(np.count_nonzero(course.moving) * interval / 2, 5.0, longest))
    rows = windows_of(course.time, (course.time > imu[0] + 1) & (course.time < imu[-1] - 1), length)
    gaps = np.diff(imu) > 0.3
    begun = np.searchsorted(imu[:-1][gaps], course.time[rows[:, -1]] + 1)
    ended = np.searchsorted(imu[1:][gaps], course.time[rows[:, 0]] - 1)  # a window may lie inside a gap
    return rows[(begun == ended) & (course.moving[rows].mean(axis=1) > 0.3)]


class _Fit:
    """Regression at a given delay, with M and the spread of the biases from the previous regression."""

    def __init__(
        self,
        drive: Drive,
        course: Course,
        rate: Array,
        rows: NDArray[np.intp],
        known: tuple[float, float] | None,
    ):
        self._drive, self._course, self._rate, self._rows, self._known = drive, course, rate, rows, known
        self._noise = max(white_noise(course.position), MIN_NOISE)
        self._matrix = np.zeros((2, 2))
        self._usual = np.zeros(2)  # mean bias, m/s2
        self._spread = BIAS_SPREAD[1]
        self._kept: dict[float, tuple[list[Any], Complex]] = {}
        self.bias = np.zeros((len(rows), 2))

    def at(self, delay: float, rounds: int = 4) -> Regression:
        """Solve for the rows of M, and for corrections of ``delay`` and of the mean bias."""
        position, columns, own = self._terms(delay)
        one = np.ones((len(self._rows), 1), dtype=np.complex128)
        # One more row per window is a prior of the window's bias, whose mean is the mean bias of all windows.
        own = [np.hstack([c, f * one]) for c, f in zip(own, (0, 0, self._noise / self._spread), strict=True)]
        position, *columns = (np.hstack([c, 0 * one]) for c in (position, *columns))
        return regress(position, columns, own, np.ones(own[0].shape), rounds)

    def solved(self, found: Regression, delay: float) -> tuple[Array, Array]:
        """Return the solution and its covariance after a Kalman update with the known delay."""
        solution, covariance = found.solution, found.covariance * (1 + SMALL_SAMPLE / len(self._rows))
        if self._known is None:
            return solution, covariance
        return with_prior(solution, covariance, 4, self._known[0] - delay, self._known[1])

    def learn(self, found: Regression, delay: float) -> None:
        """Store M, the mean bias, and the bias of each window from a regression."""
        solution, _ = self.solved(found, delay)
        self._matrix = solution[:4].reshape(2, 2)
        self._usual = self._usual + solution[5:]
        position, columns, own = self._terms(delay)
        rest = position - sum(s * c for s, c in zip(solution[:5], columns[:5], strict=True))
        root = np.sqrt(found.weight[:, :-1])
        a = np.stack([root * c for c in own], axis=-1)
        extra = np.einsum("wkn,wn->wk", np.linalg.pinv(a), root * rest)[:, 2]
        self.bias = np.column_stack([extra.real, extra.imag]) + self._usual
        spread = 1.5 * np.median(np.abs(self.bias - self._usual))
        self._spread = float(np.clip(spread, *BIAS_SPREAD))

    def _terms(self, delay: float) -> tuple[Complex, list[Complex], list[Complex]]:
        """Return the positions, the columns of common unknowns, and those of each window's unknowns, all (w, n)."""
        if delay not in self._kept:  # most calls repeat the last delay
            self._kept = {delay: self._paths(delay)}
        ((vx, x), (vy, y), (vb, b)), position = self._kept[delay]
        (xx, xy), (yx, yy) = self._matrix
        usual, t = complex(*self._usual), self._course.time[self._rows]
        speed = (xx + 1j * yx) * vx + (xy + 1j * yy) * vy + usual * vb
        t = (t - t.mean(axis=1, keepdims=True)) / (t[:, -1:] - t[:, :1])
        own = [np.ones_like(b), t + 0j, b - b.mean(axis=1, keepdims=True)]
        return position - usual * b, [x, y, 1j * x, 1j * y, -speed, b, 1j * b], own

    def _paths(self, delay: float) -> tuple[list[Any], Complex]:
        """Return single and double integrals of ax, of ay and of 1, and the IMU's positions, all (w, n)."""
        imu, rows, course = self._drive.imu, self._rows, self._course
        direction = np.exp(1j * gyro_heading(imu.time, course, self._rate, delay))
        at = course.time - delay

        def path(force: Array) -> list[Any]:
            once = integral(imu.time, direction * force)
            return [np.interp(at, imu.time, v)[rows] for v in (once, integral(imu.time, once))]

        lever = complex(*self._drive.lever_arm) * np.interp(at, imu.time, direction)[rows]
        return [path(force) for force in (imu.ax, imu.ay, np.ones(len(imu)))], course.position[rows] - lever


@dataclass(frozen=True, eq=False)
class PlanarMounting:
    axes: Array  # (2, 2), signed permutation of (ax, ay)
    unit: float  # 1, or m/s2 per g
    angle: float  # rad; a rotation about z by this angle turns the interpreted axes into the car's
    angle_std: float  # rad, standard deviation of `angle`
    margin: float  # lead in chi-square of this interpretation over the log as recorded
    known: tuple[bool, bool]  # (forward, left): True if the drive determines the axis
    # (forward, left): remaining factor, and its standard deviation
    scale: tuple[tuple[float, float], tuple[float, float]]

    @property
    def matrix(self) -> Array:
        return self.unit * self.axes


def expected_matrix(axes: Array, unit: float, angles: Array) -> tuple[Array, Array]:
    """Return the expected M at n angles, (n, 4), and its squared tolerances as a diagonal matrix, (4, 4)."""
    c, s = np.cos(angles), np.sin(angles)
    slack = unit * np.where(axes != 0, DIAGONAL_TOLERANCE, OFF_DIAGONAL_TOLERANCE).ravel()
    rotations = np.stack([c, -s, s, c], axis=-1).reshape(-1, 2, 2)
    return unit * (rotations @ axes).reshape(-1, 4), np.diag(slack**2)


def planar_mounting(fit: AccelerationFit) -> PlanarMounting:
    """Return the assignment of columns, signs and unit to the car's axes with the least chi-square.

    Any assignment other than the recorded one has a penalty, and must lower chi-square by `MIN_LEAD`.
    """
    covariance, as_recorded = fit.covariance[:4, :4], np.eye(2)
    spread = np.sqrt(np.diag(covariance)).reshape(2, 2)

    def misfits_of(axes: Array, unit: float, angles: Array) -> Array:
        expected, slack = expected_matrix(axes, unit, angles)
        off = fit.matrix.ravel() - expected
        solved = np.linalg.solve(covariance + slack, off[:, :, None])[:, :, 0]
        return np.array([row @ solution for row, solution in zip(off, solved, strict=True)])

    def deviation(axes: Array, unit: float) -> Array:
        return np.diag(spread / unit @ np.abs(axes.T))

    plain = float(misfits_of(as_recorded, 1.0, np.zeros(1))[0])
    readings = [(plain, as_recorded, 1.0)]
    for order, signs, unit in product(
        (np.eye(2), np.eye(2)[::-1]), product((1.0, -1.0), repeat=2), (1.0, GRAVITY)
    ):
        axes = np.diag(signs) @ order
        price = 6.0 * (unit != 1) + 6.0 * (not np.array_equal(axes, as_recorded)) + 2.0 * (axes[0, 0] == 0)
        turned = float(np.min(misfits_of(axes, unit, ANGLES) + 6.0 * (np.abs(ANGLES) > MAX_RECORDED_ANGLE)))
        if unit == 1 or turned < MIN_LEAD:
            readings.append((turned + price, axes, unit))
    best, axes, unit = min(readings, key=lambda reading: reading[0])
    if plain - best < MIN_LEAD:
        axes, unit = as_recorded, 1.0
    determined = deviation(axes, unit) < MAX_ELEMENT_STD
    if unit == 1 and not (determined & (axes != as_recorded).any(axis=1)).any():
        axes = as_recorded  # an axis that the drive does not determine is not changed
    misfits = misfits_of(axes, unit, ANGLES)
    k = int(np.clip(np.argmin(misfits), 1, len(ANGLES) - 2))
    bend = (misfits[k - 1] + misfits[k + 1] - 2 * misfits[k]) / (ANGLES[1] - ANGLES[0]) ** 2
    (x, y), (dx, dy) = np.diag(fit.matrix @ axes.T / unit).tolist(), deviation(axes, unit).tolist()
    angle, angle_std = float(ANGLES[np.argmin(misfits)]), math.sqrt(2 / bend) if bend > 0 else math.inf
    known = dx < MAX_ELEMENT_STD, dy < MAX_ELEMENT_STD
    return PlanarMounting(axes, unit, angle, angle_std, plain - best, known, ((x, dx), (y, dy)))
