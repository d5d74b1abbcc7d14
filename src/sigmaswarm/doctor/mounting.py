"""How the IMU sits in the vehicle: one rotation, from gravity, from turning and from acceleration along the course.

Roll and pitch of the sensor follow from the direction of the specific force, less the vehicle's own motion, and from
the axis about which it turns. Yaw follows from the regression of the path on the levelled accelerations. Each round
rotates the recorded axes by the result of the last one, until the rotation is zero.
"""

import math
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Literal

import numpy as np

from sigmaswarm.doctor.acceleration_fit import LATENESS, AccelerationFit, fit_acceleration, heading_of
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.verdicts import CLEARLY, DEGREE, FAMILIAR, SCALE
from sigmaswarm.doctor.windows import windows_of
from sigmaswarm.doctor.yaw_fit import LATENESS as YAW_LATENESS
from sigmaswarm.doctor.yaw_fit import YawFit, fit_column, integral, smoothed, yaw_windows
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Array, Drive, Imu

ROUNDS = 6
SURE, LIKELY = math.radians(3.0), math.radians(8.0)
"""rad: the total deviation up to which a mounting is sure, and likely."""
LEAST_TURN = 0.05
"""rad: RMS change of the course within 20 s, below which the mounting's yaw is unknown."""
LEAST_SHARE = 0.5
"""Share of the course's changes that the levelled gyro must explain."""
OTHER_WAY = 25.0
"""Chi-square by which the mounting must be better than any that is turned by 90 degrees or more."""
TILT_FLOOR = math.radians(1.0), math.radians(1.0)
"""rad: lowest uncertainty of the turning axis (springs) and of gravity (roads, biases)."""
YAW_FLOOR = math.radians(0.8)
ALIKE = 0.025
"""Tolerance of an entry of M, for tilt that follows the maneuvers, and slip."""
ANGLES = np.radians(np.arange(-180.0, 180.0, 1.0))
GYRO_WINDOW = 10.0
"""s: over which the axis of turning is fitted."""
WANDERS = math.radians(8.0)
"""rad: change of gravity between windows above which the mounting is not constant."""
LEAST_TILT, LEAST_YAW, CLEAR = math.radians(4.0), math.radians(5.0), 3.5
"""rad and deviations: smaller rotations of the mounting are ignored."""
SERIOUS = math.radians(7.0)
AXES = [
    m
    for m in (np.diag(d)[list(p)] for p in permutations(range(3)) for d in product((1.0, -1.0), repeat=3))
    if np.linalg.det(m) > 0
]
"""The 24 rotations that exchange axes."""
Confidence = Literal["sure", "likely", "no"]


@dataclass(frozen=True, eq=False)
class Mounting:
    """The rotation from the IMU's axes as recorded to the vehicle's.

    Attributes
    ----------
    rotation : (3, 3)
    std : (3,) rad: of roll, pitch and yaw
    confidence : "sure" (all of it), "likely", or "no" (roll and pitch at most)
    signs : (accelerometers, gyro): -1 where a sensor reports the opposite of its quantity on all axes
    reason : why the confidence is no better; empty where it is "sure"
    """

    rotation: Array
    std: Array
    confidence: Confidence
    signs: tuple[float, float]
    reason: str = ""

    @property
    def needed(self) -> bool:
        """True where the rotation is known, and beyond what its own deviation and a tolerance explain."""
        return self.confidence != "no" and not np.array_equal(self.repair, np.eye(3))

    @property
    def repair(self) -> Array:
        """(3, 3): the certain part of the rotation.

        Axes that are merely exchanged are exchanged exactly; what is left is levelled, and turned about the vertical,
        only where that stands out.
        """
        exchanged = max(AXES, key=lambda axes: float(np.trace(self.rotation @ axes.T)))
        rest = self.rotation @ exchanged.T
        tilt = float(np.arccos(np.clip(rest[2, 2], -1.0, 1.0)))
        yaw = math.atan2(rest[1, 0], rest[0, 0])
        repair = exchanged
        if tilt > max(LEAST_TILT, CLEAR * float(np.max(self.std[:2]))):
            repair = levelling(rest[2]) @ repair
        if abs(yaw) > max(LEAST_YAW, CLEAR * float(self.std[2])):
            repair = about_z(yaw) @ repair
        return repair

    @property
    def degrees(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of `repair`, deg, as ``import --mount`` takes them."""
        r = self.repair
        angles = (
            math.atan2(r[2, 1], r[2, 2]),
            -math.asin(np.clip(r[2, 0], -1, 1)),
            math.atan2(r[1, 0], r[0, 0]),
        )
        roll, pitch, yaw = (round(math.degrees(angle), 1) + 0.0 for angle in angles)
        return roll, pitch, yaw


@dataclass(frozen=True, eq=False)
class _Round:
    """Result of one round on the rotated axes; angles in rad."""

    yaw_fit: YawFit
    fit: AccelerationFit
    yaw: float
    yaw_std: float
    margin: float
    mirrored: float
    """Chi-square by which a mirror image of the accelerations fits better."""
    tilt: Array
    tilt_std: Array
    spread: float
    lateral: float


def angle_of(rotation: Array) -> float:
    """rad: by how much a rotation (3, 3) turns."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))


def turned(imu: Imu, rotation: Array) -> Imu:
    """The IMU's six axes, turned by a rotation (3, 3)."""
    assert imu.az is not None
    assert imu.gx is not None
    assert imu.gy is not None
    force = rotation @ np.array([imu.ax, imu.ay, imu.az])
    rate = rotation @ np.array([imu.gx, imu.gy, imu.gz])
    return replace(imu, ax=force[0], ay=force[1], az=force[2], gx=rate[0], gy=rate[1], gz=rate[2])


def levelling(up: Array) -> Array:
    """The smallest rotation (3, 3) that turns a direction (3,) onto +z."""
    x, y, z = up / np.linalg.norm(up)
    if z < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    s = 1 / (1 + z)
    return np.array([[1 - x * x * s, -x * y * s, -x], [-x * y * s, 1 - y * y * s, -y], [x, y, z]])


def about_z(angle: float) -> Array:
    """The rotation (3, 3) about z, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def mounting_of(drive: Drive, course: Course) -> Mounting | None:
    """Estimate the mounting; None where the log lacks an axis, gravity, or a course."""
    scaled = _in_si_units(drive, course)
    if scaled is None:
        return None
    imu, signs = scaled, (1.0, 1.0)
    rotation, seen = _converged(drive, course, imu, level(imu))
    if seen is None:
        return None
    if seen.yaw_fit.gain < 0 and _follows(seen.yaw_fit) and seen.mirrored > CLEARLY:
        # Levelled upside down: the accelerometers report the opposite of specific force.
        signs = (-1.0, 1.0)
        imu = replace(imu, ax=-imu.ax, ay=-imu.ay, az=None if imu.az is None else -imu.az)
        rotation, seen = _converged(drive, course, imu, level(imu))
        if seen is None:
            return None
    if seen.yaw_fit.gain < 0:
        signs = (signs[0], -1.0)
    std = np.array([*seen.tilt_std, seen.yaw_std])
    confidence, reason = _confidence(seen, std)
    return Mounting(rotation, std, confidence, signs, reason)


def level(imu: Imu) -> Array:
    """The smallest rotation (3, 3) that turns the median specific force onto +z."""
    assert imu.az is not None
    return levelling(np.array([np.median(imu.ax), np.median(imu.ay), np.median(imu.az)]))


def _in_si_units(drive: Drive, course: Course) -> Imu | None:
    """The IMU in m/s2 and rad/s, as gravity's size and the course's turns show them; None without six axes."""
    imu = drive.imu
    if imu.az is None or imu.gx is None or imu.gy is None or not course.moving.any():
        return None
    size = float(np.median(np.sqrt(imu.ax**2 + imu.ay**2 + imu.az**2)))
    unit = GRAVITY if 0.8 < size < 1.2 else 1.0
    if not 0.8 < unit * size / GRAVITY < 1.2:
        return None
    imu = replace(imu, ax=unit * imu.ax, ay=unit * imu.ay, az=unit * imu.az)
    rows = yaw_windows(course)
    if not len(rows):
        return None
    fit = fit_column(replace(drive, imu=turned(imu, level(imu))), course, "gz", rows)
    if DEGREE / FAMILIAR < abs(fit.gain) < DEGREE * FAMILIAR and abs(fit.gain) > 6 * fit.std:
        assert imu.gx is not None
        assert imu.gy is not None
        imu = replace(imu, gx=DEGREE * imu.gx, gy=DEGREE * imu.gy, gz=DEGREE * imu.gz)
    return imu


def _converged(drive: Drive, course: Course, imu: Imu, rotation: Array) -> tuple[Array, _Round | None]:
    """Rotate the axes in rounds until the rotation is zero; return the rotation and the last round."""
    seen = None
    for _ in range(ROUNDS):
        seen = _look(replace(drive, imu=turned(imu, rotation)), course, seen)
        if seen is None:
            break
        x, y = seen.tilt
        turn = levelling(np.array([x, y, 1.0])) @ about_z(seen.yaw)
        rotation = turn @ rotation
        if angle_of(turn) < math.radians(0.08):
            break
    return rotation, seen


def _look(drive: Drive, course: Course, last: _Round | None) -> _Round | None:
    """One round: yaw from the accelerations, then roll and pitch from what is left of gravity and from the turns.

    The clocks' offset is searched in the first round alone.
    """
    imu = drive.imu
    yaw_fit = fit_column(
        drive, course, "gz", yaw_windows(course), np.array([last.yaw_fit.late]) if last else YAW_LATENESS
    )
    rate = imu.gz if yaw_fit.gain >= 0 else -imu.gz
    coarse = yaw_fit.late if yaw_fit.share > 0.5 else 0.0
    tried = np.array([last.fit.late]) if last else coarse + LATENESS
    fit = fit_acceleration(drive, course, lambda late: heading_of(imu.time, course, rate, late), tried)
    if fit is None:
        return None
    straight, mirror = _misfits(fit, 1.0), _misfits(fit, -1.0)
    best = int(np.argmin(straight))
    yaw = float(ANGLES[best])
    near = straight[(best + np.array([-1, 0, 1])) % len(ANGLES)]
    bend = (near[0] + near[2] - 2 * near[1]) / (ANGLES[1] - ANGLES[0]) ** 2
    yaw += float((near[0] - near[2]) / 2 / (ANGLES[1] - ANGLES[0]) / bend) if bend > 0 else 0.0
    far = np.abs((ANGLES - yaw + np.pi) % (2 * np.pi) - np.pi) >= np.pi / 2
    yaw_std = math.hypot(YAW_FLOOR, math.sqrt(2 / bend) if bend > 0 else math.pi)
    tilt, tilt_std, spread = _tilt(drive, course, fit, yaw)
    return _Round(
        yaw_fit,
        fit,
        yaw,
        yaw_std,
        float(straight[far].min() - straight[best]),
        float(straight[best] - mirror.min()),
        tilt,
        tilt_std,
        spread,
        _lateral(drive, course, fit, rate, yaw),
    )


def _misfits(fit: AccelerationFit, side: float) -> Array:
    """Chi-square of M against k R(angle) for each of `ANGLES`, k within `SCALE` of 1; ``side`` -1: mirrored."""
    found, covariance = fit.matrix.ravel(), fit.covariance[:4, :4] + ALIKE**2 * np.eye(4)
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    expected = np.stack([c, -side * s, s, side * c], axis=-1)
    slack = covariance + SCALE**2 * expected[:, :, None] * expected[:, None, :]
    off = found - expected
    return np.einsum("nk,nk->n", off, np.linalg.solve(slack, off[:, :, None])[:, :, 0])


def _tilt(drive: Drive, course: Course, fit: AccelerationFit, yaw: float) -> tuple[Array, Array, float]:
    """Leaning of the axes, once turned by ``yaw``: (2,) slopes of up along x and y, their deviations, and the spread.

    Gravity is what no motion explains of the accelerations; the axis of turning is where the integrals of gx and gy
    follow that of gz. Both are up, and each errs in its own way: the mean by their variances.
    """
    leak = -fit.bias / GRAVITY
    gravity = np.median(leak, axis=0)
    spread = 1.4826 * np.median(np.abs(leak - gravity), axis=0)
    known = np.hypot(TILT_FLOOR[1], 2 * spread / math.sqrt(len(leak)))
    turned_by = about_z(yaw)[:2, :2]
    axis, axis_std = _axis_of_turning(drive, course)
    axis, axis_std = turned_by @ axis, np.full(2, np.max(axis_std))
    weight = np.array([1 / known**2, 1 / axis_std**2])
    tilt = (weight[0] * gravity + weight[1] * axis) / weight.sum(axis=0)
    return tilt, np.sqrt(1 / weight.sum(axis=0)), float(np.max(spread))


def _axis_of_turning(drive: Drive, course: Course) -> tuple[Array, Array]:
    """Slopes (2,) of the integrals of gx and gy on that of gz within windows, less straight lines; deviations."""
    imu = drive.imu
    assert imu.gx is not None
    assert imu.gy is not None
    step = 0.5
    time = np.arange(imu.time[0], imu.time[-1], step)
    rows = windows_of(time, np.ones(len(time), dtype=np.bool_), GYRO_WINDOW)
    if not len(rows):
        return np.zeros(2), np.full(2, math.pi)
    t = np.linspace(-1, 1, rows.shape[1])
    line = np.stack([np.ones_like(t), t])
    project = np.eye(len(t)) - np.linalg.pinv(line) @ line
    x, y, z = (
        np.interp(time, imu.time, integral(imu.time, rate))[rows] @ project
        for rate in (imu.gx, imu.gy, imu.gz)
    )
    power = np.sum(z**2, axis=1)
    if power.sum() < 1e-4:
        return np.zeros(2), np.full(2, math.pi)
    slopes = np.array([np.sum(v * z, axis=1) / np.maximum(power, 1e-12) for v in (x, y)])
    robust = np.ones(len(power))
    for _ in range(5):
        weight = robust * power
        mean = slopes @ weight / weight.sum()
        off = np.sqrt(np.sum((slopes - mean[:, None]) ** 2, axis=0) * power)
        usual = max(float(np.median(off[power > np.median(power) / 2])), 1e-9)
        robust = 1 / (1 + (off / (3 * usual)) ** 2)
    weight = robust * power
    mean = slopes @ weight / weight.sum()
    pull = weight * (slopes - mean[:, None])
    return mean, np.hypot(TILT_FLOOR[0], 2 * np.sqrt(np.sum(pull**2, axis=1)) / weight.sum())


def _lateral(drive: Drive, course: Course, fit: AccelerationFit, rate: Array, yaw: float) -> float:
    """Slope of the lateral specific force on speed x yaw rate; NaN where the car does not turn."""
    imu = drive.imu
    at = course.time[course.moving] - fit.late
    rotated = about_z(yaw)[1]
    force = smoothed(imu.time, rotated[0] * imu.ax + rotated[1] * imu.ay, at, 1.5)
    expected = np.abs(course.velocity[course.moving]) * smoothed(imu.time, rate, at, 1.5)
    force, expected = force - np.median(force), expected - np.median(expected)
    power = float(expected @ expected)
    return float(force @ expected) / power if power / max(len(at), 1) > 0.05 else math.nan


def _follows(turns: YawFit) -> bool:
    """True where the course follows the gyro, in either sense."""
    return turns.share > LEAST_SHARE and 1 / FAMILIAR < abs(turns.gain) < FAMILIAR


def _confidence(seen: _Round, std: Array) -> tuple[Confidence, str]:
    """Confidence in the mounting, and the reason why it is not higher."""
    if seen.yaw_fit.course_change < LEAST_TURN:
        return "no", "the course hardly turns"
    if not _follows(seen.yaw_fit):
        return "no", "the gyro does not follow the course"
    if seen.spread > WANDERS:
        return "no", "the direction of gravity wanders"
    if seen.mirrored > CLEARLY:
        return "no", "the accelerometers' axes are a mirror image"
    if seen.margin < OTHER_WAY:
        return "no", "the car hardly speeds up or brakes, which would show what is forward"
    if np.isfinite(seen.lateral) and not 0.4 < seen.lateral < 1.6:
        return "no", f"the lateral force is {seen.lateral:.1f} times speed x yaw rate"
    total = float(np.linalg.norm(std))
    if total > LIKELY:
        return "no", f"its standard deviation is {math.degrees(total):.0f} deg"
    return (
        ("sure", "")
        if total <= SURE
        else ("likely", f"its standard deviation is {math.degrees(total):.0f} deg")
    )
