"""Interpret fits and their covariances: units, signs, axes, mounting and clock offset."""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor import acceleration_fit
from sigmaswarm.doctor.acceleration_fit import AccelerationFit
from sigmaswarm.doctor.yaw_fit import DELAYS, SUFFICIENT_SHARE, YawFit
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Imu

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
# Smallest decrease in chi-square for which another interpretation replaces the recorded one. Also the largest
# chi-square of an interpretation in g (logs in g have 4), since in steady circles, the forces hardly exceed the noise
# and do not determine the unit.
MIN_LEAD = 16.0
# Tolerance of the off-diagonal elements of M, for slip, and for tilt in maneuvers
OFF_DIAGONAL_TOLERANCE = 0.05
# Tolerance of the diagonal elements of M: roll and pitch of the body add 5 to 10% to the acceleration
DIAGONAL_TOLERANCE = 0.12
MAX_ELEMENT_STD = 0.25  # standard deviation of an element of M below which the drive determines it
MIN_OFFSET = 0.1  # s, smallest reported offset; the receiver's noise hides smaller offsets
# m/s, smallest `AccelerationFit.varied` that determines the delay; noise of the IMU causes up to 0.04 m/s
MIN_VARIED = 0.1
# Ratios of an offset to its standard deviation: note, warning with repair, serious
OFFSET_SIGMAS = (2.5, 3.3, 5.5)
MAX_CONTRADICTION = 3.0  # standard deviations by which two estimates of the offset may differ
MAX_RECORDED_ANGLE = math.radians(5)  # rad, largest rotation about z without a penalty
ANGLES = np.radians(np.arange(-40.0, 40.5, 0.5))


@dataclass(frozen=True)
class Yaw:
    """The yaw rate in rad/s, as a column times a factor."""

    column: str = "gz"
    factor: float = 1.0
    known: bool = False  # True if the drive determines column and factor


def yaw_of(fit: YawFit | None, imu: Imu) -> Yaw:
    """Find column, sign and unit of the gyro from the course.

    If the course does not show them, the result is gz in rad/s. A factor that no unit explains is accepted only if the
    column clearly follows the course, the gain hardly depends on the delay, and the axes are level, since a tilt
    reduces the rate.
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
    """Return the factors to rad/s (units with sign) that explain a gain; empty if no unit does."""
    return [f for f in (1.0, -1.0, DEGREE, -DEGREE) if 1 / FACTOR_TOLERANCE < gain / f < FACTOR_TOLERANCE]


def _is_level(imu: Imu) -> bool:
    up = GRAVITY if imu.az is None else float(np.median(imu.az))
    return math.hypot(np.median(imu.ax), np.median(imu.ay)) < abs(up)


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


def _expected(axes: Array, unit: float, angles: Array) -> tuple[Array, Array]:
    """Return the expected M at n angles, (n, 4), and its squared tolerances as a diagonal matrix, (4, 4)."""
    c, s = np.cos(angles), np.sin(angles)
    slack = unit * np.where(axes != 0, DIAGONAL_TOLERANCE, OFF_DIAGONAL_TOLERANCE).ravel()
    rotations = np.stack([c, -s, s, c], axis=-1).reshape(-1, 2, 2)
    return unit * (rotations @ axes).reshape(-1, 4), np.diag(slack**2)


def planar_mounting(fit: AccelerationFit) -> PlanarMounting:
    """Return the assignment of columns, signs and unit to the car's axes with the least chi-square.

    Assignments that differ from the recorded assignment have a penalty, and must lower chi-square by `MIN_LEAD`.
    """
    covariance, as_recorded = fit.covariance[:4, :4], np.eye(2)
    spread = np.sqrt(np.diag(covariance)).reshape(2, 2)

    def misfits_of(axes: Array, unit: float, angles: Array) -> Array:
        expected, slack = _expected(axes, unit, angles)
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
    return PlanarMounting(
        axes,
        unit,
        float(ANGLES[np.argmin(misfits)]),
        float(math.sqrt(2 / bend)) if bend > 0 else math.inf,
        plain - best,
        (dx < MAX_ELEMENT_STD, dy < MAX_ELEMENT_STD),
        ((x, dx), (y, dy)),
    )


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
        """Return another estimate from the same data if it is more accurate and agrees with this one, else this one."""
        agrees = abs(delay - self.delay) < MAX_CONTRADICTION * math.hypot(std, self.std)
        return ClockOffset(delay, std, self.max_offset) if std < self.std and agrees else self


def clock_of(
    yaw_fit: YawFit | None, yaw: Yaw, acceleration: AccelerationFit | None, mount: PlanarMounting | None
) -> ClockOffset:
    """Combine the delays that accelerometers and gyro show; their difference increases the standard deviation."""
    found: list[tuple[float, float]] = []
    max_offset = float(acceleration_fit.DELAYS[-1])
    if (
        acceleration is not None
        and mount is not None
        and any(mount.known)
        and acceleration.varied > MIN_VARIED
    ):
        # The delay and its standard deviation, given M: the conditional Gaussian of the fit.
        (expected,), slack = _expected(mount.axes, mount.unit, np.array([mount.angle]))
        covariance = acceleration.covariance
        gain = np.linalg.solve(covariance[:4, :4] + slack, covariance[:4, 4])
        delay = acceleration.delay + gain @ (expected - acceleration.matrix.ravel())
        found.append((float(delay), math.sqrt(max(covariance[4, 4] - gain @ covariance[:4, 4], 1e-6))))
    if yaw_fit is not None and yaw.known and yaw_fit.share > 0.5:
        found.append((yaw_fit.delay, yaw_fit.delay_std))
        max_offset = float(DELAYS[-1])
    if not found:
        return ClockOffset()
    weight = np.array([1 / std**2 for _, std in found])
    delay = float(weight @ [delay for delay, _ in found] / weight.sum())
    chi = float(weight @ [(value - delay) ** 2 for value, _ in found]) / max(len(found) - 1, 1)
    return ClockOffset(delay, math.sqrt(max(chi, 1.0) / weight.sum()), max_offset)
