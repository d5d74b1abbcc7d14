"""Estimate the mounting of the IMU as one rotation, from gravity, turns and the direction of travel.

Roll and pitch follow from gravity and the axis of turning; yaw follows from the regression of the path on the leveled
accelerations. The direction of travel refines yaw and pitch. These steps are repeated with the rotated axes until
hardly any rotation remains.
"""

import math
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Literal

import numpy as np
from scipy.stats import rankdata

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import (
    DELAYS,
    DIAGONAL_TOLERANCE,
    MIN_LEAD,
    AccelerationFit,
    fit_acceleration,
)
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.travel_direction import direction_of_travel
from sigmaswarm.doctor.windows import integral, smoothed, windows_of
from sigmaswarm.doctor.yaw_fit import DELAYS as YAW_DELAYS
from sigmaswarm.doctor.yaw_fit import FACTOR_TOLERANCE, MIN_GAIN_TURN, YawFit, fit_column, yaw_of, yaw_windows
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive, Imu
from sigmaswarm.drives.mounting import NO_ROTATION
from sigmaswarm.geodesy import rotation_of

MAX_ROUNDS = 16  # a round leaves up to 70% of the error; after six rounds, up to 1 deg remains in a few logs
# rad, largest total standard deviation of the confidences "sure" and "likely"
SURE_STD, LIKELY_STD = math.radians(3.0), math.radians(8.0)
# Smallest fraction of the variance of the course's changes that the leveled gyro must explain
MIN_EXPLAINED = 0.5
MIN_RIVAL_LEAD = 25.0  # smallest lead in chi-square over any mounting that is rotated by 90 degrees or more
# rad, smallest standard deviations of the axis of turning (springs) and of gravity (roads, biases)
TILT_FLOOR = math.radians(1.0), math.radians(1.0)
YAW_FLOOR = math.radians(0.8)  # rad, smallest standard deviation of the yaw in one round
TRAVEL_FLOOR = math.radians(0.8)  # rad, noise of the direction of travel, due to slip and suspension
TOLERANCE = 0.025  # tolerance of an entry of `AccelerationFit.matrix`, due to slip and to tilt in maneuvers
ANGLES = np.radians(np.arange(-180.0, 180.0, 1.0))
GYRO_WINDOW = 10.0  # s, window over which the axis of turning is fitted
# Accelerometers are reversed if `_leaning` of their negative values exceeds MIN_LEANING. A mounting rotated by more
# than 90 degrees is refused if its `_leaning` is below -MIN_LEANING, since an axis is reversed.
MIN_LEANING = 0.5
# rad per m/s2, smallest lean of a body on springs. Cars have 0.003 or more. Vehicles without springs have less than
# 0.0003, due to noise of the gyro and errors of the mounting.
MIN_LEAN = 0.001
# rad, largest angle between the median specific force and the estimated vertical axis
MAX_TILT = math.radians(15.0)
# rad; a larger change of gravity between windows shows that the mounting is not constant
MAX_GRAVITY_CHANGE = math.radians(8.0)
# A mounting slips if gravity's direction in the first and last third of the windows differs by MIN_SLIP (rad), and if
# the rank correlation with time exceeds MIN_TREND. In 70 drives and parts with a constant mounting, the largest change
# is 9 degrees, on hills. Planted slips of 30 degrees were found in 11 of 16 recordings and in all simulated drives.
MIN_SLIP, MIN_TREND = math.radians(10.0), 0.75
MIN_TILT = math.radians(4.0)  # rad, smallest tilt that is corrected
MIN_YAW = math.radians(5.0)  # rad, smallest rotation about z that is corrected
MIN_SIGMAS = 3.5  # smallest ratio of a corrected angle to its standard deviation
# Smallest rotation of a serious finding: in rad, and in total standard deviations up to CLEAR_ROTATION. In 1,850 parts
# of 60 s of drives with a correct mounting, one estimate was 7.8 degrees (4.3 standard deviations).
SERIOUS, SERIOUS_SIGMAS, CLEAR_ROTATION = math.radians(7.0), 6.0, math.radians(20.0)
# The 24 rotations by multiples of 90 degrees about the axes: signed permutations
AXIS_PERMUTATIONS = [
    m
    for m in (np.diag(d)[list(p)] for p in permutations(range(3)) for d in product((1.0, -1.0), repeat=3))
    if np.linalg.det(m) > 0
]
Confidence = Literal["sure", "likely", "no"]


@dataclass(frozen=True, eq=False)
class Mounting:
    """The rotation from the IMU's recorded axes to the vehicle's axes."""

    rotation: Array  # (3, 3)
    std: Array  # (3,) rad, of roll, pitch and yaw
    confidence: Confidence  # "no": at most roll and pitch are known
    reason: str  # why the confidence is not higher

    before: Array  # (3, 3), rotation that was already applied to the drive's samples: `Drive.mounting`
    slip: float = (
        0.0  # rad, change of the tilt from the first to the last third of the drive, if it is a slow change
    )

    @property
    def needed(self) -> bool:
        """True if the rotation is known, and exceeds a tolerance and a multiple of its standard deviation."""
        return self.confidence != "no" and not self._agrees(self.rotation, MIN_TILT, MIN_YAW)

    @property
    def serious(self) -> bool:
        """True if the repair is a large rotation, and many times its standard deviation or very large."""
        least = min(SERIOUS_SIGMAS * float(np.linalg.norm(self.std)), CLEAR_ROTATION)
        return angle_of(self.repair) > max(SERIOUS, least)

    @property
    def mount(self) -> Array:
        """The rotation (3, 3) from the axes of the raw samples to the vehicle's axes.

        If the estimate does not differ significantly from a signed permutation of the raw axes, the result is this
        permutation. The tolerances of `needed` (`MIN_TILT`, `MIN_YAW`) do not apply, since a rotation near a tolerance
        would be 0 in one part of a log but not in another.
        """
        found = self.rotation @ self.before
        nearest = max(AXIS_PERMUTATIONS, key=lambda axes: float(np.trace(found @ axes.T)))
        return nearest if self._agrees(found @ nearest.T) else found

    @property
    def repair(self) -> Array:
        """The rotation (3, 3) that the drive's samples need in addition to `before`; the identity if none is needed."""
        return self.mount @ self.before.T if self.needed else np.eye(3)

    def _agrees(self, rest: Array, least_tilt: float = 0.0, least_yaw: float = 0.0) -> bool:
        """Return True if a rotation's tilt and its angle about the vertical are small or not significant."""
        tilt, about = np.arccos(np.clip(rest[2, 2], -1.0, 1.0)), rest @ leveling_rotation(rest[2]).T
        axis = rest[2, 1::-1] / max(float(np.hypot(rest[2, 0], rest[2, 1])), 1e-9)  # of the tilt: roll, pitch
        level = tilt <= max(least_tilt, MIN_SIGMAS * float(np.linalg.norm(axis * self.std[:2])))
        yaw = abs(math.atan2(about[1, 0], about[0, 0]))
        return bool(level and yaw <= max(least_yaw, MIN_SIGMAS * self.std[2]))


@dataclass(frozen=True, eq=False)
class _Round:
    """Result of `_round`; angles in rad."""

    yaw_fit: YawFit
    delay: float
    yaw: float
    margin: float  # lead in chi-square over axes turned by 90 degrees or more
    mirrored: float  # lead in chi-square of mirrored accelerations
    tilt: Array
    std: Array
    spread: float
    slip: float
    lateral: float


def angle_of(rotation: Array) -> float:
    """Return the angle of a rotation (3, 3), rad."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))


def rotate_imu(imu: Imu, rotation: Array) -> Imu:
    columns: dict[str, Array] = {}
    for names in (("ax", "ay", "az"), ("gx", "gy", "gz")):
        rows = rotation @ np.array([getattr(imu, name) for name in names])
        columns |= dict(zip(names, rows, strict=True))
    return replace(imu, **columns)


def leveling_rotation(up: Array) -> Array:
    """Return the smallest rotation (3, 3) that turns a direction (3,) onto +z."""
    x, y, z = up / np.linalg.norm(up)
    if z < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    s = 1 / (1 + z)
    return np.array([[1 - x * x * s, -x * y * s, -x], [-x * y * s, 1 - y * y * s, -y], [x, y, z]])


def about_z(angle: float) -> Array:
    """Return the rotation (3, 3) about z by an angle, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def mounting_of(drive: Drive, course: Course) -> Mounting | None:
    """Estimate the mounting. Return None if the drive does not have six axes, gravity and a course."""
    found = _in_si_units(drive, course)
    if found is None:
        return None
    imu, yaw_fit = found
    rotation, seen = _converged(drive, course, imu, yaw_fit)
    if seen and seen.yaw_fit.gain < 0 and _follows(seen.yaw_fit) and seen.mirrored > MIN_LEAD:
        # The leveled IMU is upside down: all or some accelerometers report minus the specific force.
        opposite = _scaled(imu, "a", -1.0)
        upright = _converged(drive, course, opposite)
        if np.min(_leaning(rotate_imu(opposite, upright[0]))) > MIN_LEANING:
            imu, (rotation, seen) = opposite, upright
    if seen is None:
        return None
    confidence, reason = _confidence(seen)
    if confidence != "no" and angle_of(level_rotation(rotate_imu(imu, rotation))) > MAX_TILT:
        confidence, reason = (
            "no",
            "in turns the axis of rotation is not vertical, so accelerometers and gyro have different axes",
        )
    far = confidence != "no" and angle_of(rotation) > math.pi / 2
    if far and np.min(_leaning(rotate_imu(imu, rotation))) < -MIN_LEANING:
        confidence, reason = (
            "no",
            "with the estimated mounting, the body would lean into turns, or pitch forward when it gains speed",
        )
    before = rotation_of(*(drive.mounting or NO_ROTATION))
    return Mounting(rotation, seen.std, confidence, reason, before, seen.slip)


def _leaning(imu: Imu) -> Array:
    """Return how much the body leans outward in turns and backward when it gains speed, as two numbers from -1 to 1.

    Both numbers are positive for a body on springs, but one of them is negative if an axis of the IMU is reversed. A
    number is 0 if the body does not lean, as on a robot without springs.
    """
    time = np.arange(imu.time[0] + 2.0, imu.time[-1] - 2.0, 0.2)
    if len(time) < 50:
        return np.zeros(2)

    def swift(values: Array) -> Array:
        return smoothed(imu.time, values, time, 0.4) - smoothed(imu.time, values, time, 4.0)

    roll, pitch = (swift(integral(imu.time, getattr(imu, name))) for name in ("gx", "gy"))
    force = np.array([swift(imu.ay), -swift(imu.ax)])
    products = np.array([roll, pitch]) * force
    starts = np.arange(0, max(len(time) - 49, 1), 50)  # of windows of 10 s
    agreement = np.add.reduceat(products, starts, axis=1)
    leans = np.abs(np.sum(products, axis=1)) > MIN_LEAN * np.sum(force**2, axis=1)
    return leans * np.sum(agreement, axis=1) / np.maximum(np.sum(np.abs(agreement), axis=1), 1e-12)


def _scaled(imu: Imu, sensor: Literal["a", "g"], factor: float) -> Imu:
    return replace(imu, **{f"{sensor}{axis}": factor * getattr(imu, f"{sensor}{axis}") for axis in "xyz"})


def level_rotation(imu: Imu) -> Array:
    """Return the smallest rotation (3, 3) that turns the median specific force onto +z."""
    return leveling_rotation(np.array([np.median(getattr(imu, name)) for name in ("ax", "ay", "az")]))


def _in_si_units(drive: Drive, course: Course) -> tuple[Imu, YawFit] | None:
    """Convert an IMU to m/s2 and rad/s if gravity and turns show other units. Also return the fit of the yaw rate."""
    imu, rows = drive.imu, yaw_windows(course)
    if imu.az is None or imu.gx is None or imu.gy is None or not course.moving.any() or not len(rows):
        return None
    size = float(np.median(np.sqrt(imu.ax**2 + imu.ay**2 + imu.az**2)))
    unit = GRAVITY if 0.8 < size < 1.2 else 1.0
    if not 0.8 < unit * size / GRAVITY < 1.2:
        return None
    imu = _scaled(imu, "a", unit)
    level = rotate_imu(imu, level_rotation(imu))
    fit = fit_column(replace(drive, imu=level), course, "gz", rows)
    factor = abs(yaw_of(fit, level).factor)
    return _scaled(imu, "g", factor), replace(fit, gain=fit.gain / factor, std=fit.std / factor)


def _converged(
    drive: Drive, course: Course, imu: Imu, yaw_fit: YawFit | None = None
) -> tuple[Array, _Round | None]:
    """Level the axes and rotate them in rounds until they converge. Return the total rotation and the last round."""
    rotation, seen = level_rotation(imu), None
    for _ in range(MAX_ROUNDS):
        seen = _round(replace(drive, imu=rotate_imu(imu, rotation)), course, seen, None if seen else yaw_fit)
        if seen is None:
            break
        turn = leveling_rotation(np.append(seen.tilt, 1.0)) @ about_z(seen.yaw)
        rotation = turn @ rotation
        if angle_of(turn) < math.radians(0.02):
            break
    return rotation, seen


def _round(drive: Drive, course: Course, last: _Round | None, yaw_fit: YawFit | None) -> _Round | None:
    """Run one round. Only the first round searches for the delay of the fixes."""
    tried = np.array([last.yaw_fit.delay]) if last else YAW_DELAYS
    yaw_fit = yaw_fit or fit_column(drive, course, "gz", yaw_windows(course), tried)
    rate = drive.imu.gz if yaw_fit.gain >= 0 else -drive.imu.gz
    tried = np.array([last.delay]) if last else (yaw_fit.delay if yaw_fit.share > 0.5 else 0.0) + DELAYS
    fit = fit_acceleration(
        drive, course, rate, tried, yaw_fit.delay_prior if yaw_fit.share > MIN_EXPLAINED else None
    )
    if fit is None:
        return None
    straight, mirror = _misfits(fit, 1.0), _misfits(fit, -1.0)
    best, step = int(np.argmin(straight)), ANGLES[1] - ANGLES[0]
    before, at, after = straight[(best + np.array([-1, 0, 1])) % len(ANGLES)]
    yaw, yaw_std = float(ANGLES[best]), math.pi
    if (bend := (before + after - 2 * at) / step**2) > 0:
        yaw, yaw_std = yaw + float((before - after) / 2 / step / bend), math.sqrt(2 / bend)
    far = np.abs((ANGLES - yaw + np.pi) % (2 * np.pi) - np.pi) >= np.pi / 2
    margin, mirrored = float(straight[far].min() - at), float(at - mirror.min())
    tilt, tilt_std, spread = _tilt(drive, fit, yaw)
    slip = _slip(-fit.bias / GRAVITY)
    # The slope along y is roll, along x pitch.
    std = np.append(tilt_std[::-1], math.hypot(YAW_FLOOR, yaw_std))
    lateral = _lateral(drive, course, fit, rate, yaw)
    gyro = _scaled(drive.imu, "g", math.copysign(1.0, yaw_fit.gain))
    if travel := direction_of_travel(rotate_imu(gyro, about_z(yaw)), course, fit.delay):
        (left, up), (left_std, up_std) = travel[0], np.hypot(TRAVEL_FLOOR, travel[1])
        tilt[0], std[1] = _mean((tilt[0], std[1]), (-up, up_std))
        off, std[2] = _mean((0.0, std[2]), (-left, left_std))
        yaw += off
    return _Round(yaw_fit, fit.delay, yaw, margin, mirrored, tilt, std, spread, slip, lateral)


def _mean(*estimates: tuple[float, float]) -> tuple[float, float]:
    """Return the inverse-variance weighted mean, and its standard deviation."""
    weight = np.array([1 / std**2 for _, std in estimates])
    return float(weight @ [value for value, _ in estimates] / weight.sum()), 1 / math.sqrt(weight.sum())


def _misfits(fit: AccelerationFit, side: float) -> Array:
    """Return the chi-square of the fitted matrix M against k R(angle), for each of `ANGLES`.

    The scale factor k has a mean of 1 and a standard deviation of `DIAGONAL_TOLERANCE`. If ``side`` is -1, R is
    mirrored.
    """
    found, covariance = fit.matrix.ravel(), fit.covariance[:4, :4] + TOLERANCE**2 * np.eye(4)
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    expected = np.stack([c, -side * s, s, side * c], axis=-1)
    slack = covariance + DIAGONAL_TOLERANCE**2 * expected[:, :, None] * expected[:, None, :]
    off = found - expected
    return np.einsum("nk,nk->n", off, np.linalg.solve(slack, off[:, :, None])[:, :, 0])


def _tilt(drive: Drive, fit: AccelerationFit, yaw: float) -> tuple[Array, Array, float]:
    """Estimate the tilt that remains after a rotation by ``yaw``.

    The slopes are the weighted mean (by inverse variance) of two estimates: from gravity, which is the part of the
    accelerations that the motion does not explain, and from the axis of turning.
    """
    leak = -fit.bias / GRAVITY
    gravity = np.median(leak, axis=0)
    spread = 1.4826 * np.median(np.abs(leak - gravity), axis=0)
    known = np.hypot(TILT_FLOOR[1], 2 * spread / math.sqrt(len(leak))) + fit.bias_std / GRAVITY
    axis, axis_std = _axis_of_turning(drive)
    weight = np.array([1 / known**2, 1 / np.full(2, np.max(axis_std)) ** 2])
    tilt = (weight[0] * gravity + weight[1] * (about_z(yaw)[:2, :2] @ axis)) / weight.sum(axis=0)
    return tilt, np.sqrt(1 / weight.sum(axis=0)), float(np.max(spread))


def _slip(tilt: Array) -> float:
    """Return the change of a tilt (n, 2), rad, from the first to the last third; 0 unless it rises or falls slowly."""
    third = len(tilt) // 3
    if third < 2:
        return 0.0
    change = np.median(tilt[-third:], axis=0) - np.median(tilt[:third], axis=0)
    size = float(np.hypot(*change))
    if size < MIN_SLIP:
        return 0.0
    return size if np.corrcoef(rankdata(tilt @ change), np.arange(len(tilt)))[0, 1] > MIN_TREND else 0.0


def _axis_of_turning(drive: Drive) -> tuple[Array, Array]:
    """Fit the integrals of gx and gy to that of gz. Return the slopes (2,) and their standard deviations."""
    imu, unknown = drive.imu, (np.zeros(2), np.full(2, math.pi))
    time = np.arange(imu.time[0], imu.time[-1], 0.5)
    rows = windows_of(time, np.ones(len(time), dtype=np.bool_), GYRO_WINDOW)
    if not len(rows):
        return unknown
    line = np.stack([np.ones(rows.shape[1]), np.linspace(-1, 1, rows.shape[1])])
    project = np.eye(rows.shape[1]) - np.linalg.pinv(line) @ line
    x, y, z = (
        np.interp(time, imu.time, integral(imu.time, getattr(imu, name)))[rows] @ project
        for name in ("gx", "gy", "gz")
    )
    power = np.sum(z**2, axis=1)
    if power.sum() < 1e-4:
        return unknown
    slopes = np.array([np.sum(v * z, axis=1) / np.maximum(power, 1e-12) for v in (x, y)])
    weight, mean = power, np.zeros(2)
    for last in (False, False, False, False, False, True):
        mean = slopes @ weight / weight.sum()
        if not last:
            off = np.sqrt(np.sum((slopes - mean[:, None]) ** 2, axis=0) * power)
            usual = max(float(np.median(off[power > np.median(power) / 2])), 1e-9)
            weight = 1 / (1 + (off / (3 * usual)) ** 2) * power
    pull = weight * (slopes - mean[:, None])
    return mean, np.hypot(TILT_FLOOR[0], 2 * np.sqrt(np.sum(pull**2, axis=1)) / weight.sum())


def _lateral(drive: Drive, course: Course, fit: AccelerationFit, rate: Array, yaw: float) -> float:
    """Fit the slope of the lateral specific force against speed x yaw rate; NaN if the car does not turn."""
    imu = drive.imu
    at = course.time[course.moving] - fit.delay
    rotated = about_z(yaw)[1]
    force = smoothed(imu.time, rotated[0] * imu.ax + rotated[1] * imu.ay, at, 1.5)
    expected = np.abs(course.velocity[course.moving]) * smoothed(imu.time, rate, at, 1.5)
    force, expected = force - np.median(force), expected - np.median(expected)
    power = float(expected @ expected)
    return float(force @ expected) / power if power / max(len(at), 1) > 0.05 else math.nan


def _follows(turns: YawFit) -> bool:
    return turns.share > MIN_EXPLAINED and 1 / FACTOR_TOLERANCE < abs(turns.gain) < FACTOR_TOLERANCE


def _confidence(seen: _Round) -> tuple[Confidence, str]:
    lateral, total = seen.lateral, float(np.linalg.norm(seen.std))
    uncertain = f"its standard deviation is {math.degrees(total):.0f} deg"
    for fault, reason in (
        (seen.yaw_fit.course_change < MIN_GAIN_TURN, "the course hardly changes"),
        (not _follows(seen.yaw_fit), "the gyro's yaw rate does not match the rate of change of the course"),
        (seen.spread > MAX_GRAVITY_CHANGE or seen.slip > 0, "the direction of gravity is not constant"),
        (seen.mirrored > MIN_LEAD, "the accelerometers' axes form a left-handed system"),
        (
            seen.margin < MIN_RIVAL_LEAD,
            "the car's speed hardly changes, so it does not show the forward direction",
        ),
        (
            lateral <= 0.4 or lateral >= 1.6,
            f"the lateral acceleration is {lateral:.1f} times the product of speed and yaw rate, but should equal it",
        ),
        (total > LIKELY_STD, uncertain),
    ):
        if fault:
            return "no", reason
    return ("sure", "") if total <= SURE_STD else ("likely", uncertain)
