"""Check axes, signs, unit and scale of ax and ay, the mounting angle, gravity in ax and ay, and az."""

import math
from collections.abc import Iterator

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import DIAGONAL_TOLERANCE, PlanarMounting
from sigmaswarm.doctor.checks.gyro import is_upside_down
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_by_margin, confidence_of, finding_of
from sigmaswarm.doctor.mounting import leveling_rotation
from sigmaswarm.doctor.windows import moving_mean, smoothed
from sigmaswarm.drives.checks import GRAVITY, gravity_on, gravity_up
from sigmaswarm.drives.drive import Imu

MOUNTING_LIMITS = (math.radians(5), math.radians(10))  # rad about z, for a warning and for a serious finding
# m/s2, offset in (ax, ay) above which there is a warning or a serious finding. Roads and the biases of cheap sensors
# cause offsets below the second limit.
RESIDUAL_LIMITS = (0.5, 1.2)
# m/s2, errors of the median magnitude of the specific force above which there is a note or a warning. Errors of cheap
# sensors reach 0.8 m/s2: a scale error of 3% and a bias of 0.05 g (MPU-6050).
MAGNITUDE_LIMITS = (0.3, 1.0)
# smallest ratio of a rotation to its standard deviation, to report or to repair the rotation
REPORT_RATIO, REPAIR_RATIO = 2.5, 3.5
# smallest ratio of a serious rotation about the vertical, and of one that only one of the two axes shows
SERIOUS_RATIO = 6.0
WRONG_SCALE = 0.4  # smallest reported relative error of the scale
MIN_ACCELERATION_SPREAD = 0.4  # m/s2, smallest spread of the acceleration that determines its scale
WHERE = "imu.csv, ax, ay"


def check_accelerometer(evidence: Evidence) -> Iterator[Finding]:
    if wrong := gravity_on(evidence.drive.imu):
        yield finding_of(wrong, "serious", evidence.span, 0.999)
        return
    if mount := evidence.mount:
        yield from _axes(evidence, mount)
        yield from _size(evidence, mount)
        yield from _gravity(evidence)
    yield from _upward(evidence)


def _axes(evidence: Evidence, mount: PlanarMounting) -> Iterator[Finding]:
    axes, az, span = mount.axes, evidence.drive.imu.az, evidence.span
    confidence = confidence_by_margin(mount.margin)
    if not np.array_equal(axes, np.eye(2)):
        forward, left = (f"{'-' if row.sum() < 0 else ''}{'ax' if row[0] else 'ay'}" for row in axes)
        opposite = np.array_equal(axes, -np.eye(2)) and az is not None and float(np.median(az)) < 0
        what = f"the forward acceleration is in {forward}, the leftward acceleration in {left}"
        if opposite:
            what = "the accelerometers report minus the specific force: ax, ay and az have the wrong sign"
        elif not all(mount.known):
            what = f"{what} (the drive shows only {'forward' if mount.known[0] else 'sideways'} acceleration)"
        remedy = f"use {forward} as ax and {left} as ay" + (" and change the sign of az" if opposite else "")
        if (opposite and evidence.mounted) or (evidence.yaw.factor < 0 and np.linalg.det(axes) < 0):
            same = "exchanged x and y (lat and lon) have the same effect"
            remedy = f"check the fixes first, since {same}; if the fixes are right, {remedy}"
        yield Finding(
            "accelerometer-axes" if axes[0, 0] == 0 else "accelerometer-sign", "serious", what, WHERE, span, confidence,
            remedy, Repair("accelerometer", (*axes.ravel().tolist(), -1.0 if opposite else 1.0)),
        )  # fmt: skip
    if mount.unit != 1:
        size = mount.unit * mount.scale[0][0]
        what = f"the accelerations are in g: the car accelerates {size:.1f} times as much as ax indicates"
        repair = Repair("accelerometer", (GRAVITY, 0.0, 0.0, GRAVITY, _unit_of_up(evidence)))
        remedy = f"multiply ax, ay{', az' * (_unit_of_up(evidence) != 1)} by {GRAVITY}"
        yield Finding("accelerometer-unit", "serious", what, f"{WHERE}, az", span, confidence, remedy, repair)


def _size(evidence: Evidence, mount: PlanarMounting) -> Iterator[Finding]:
    """Check the angle about the vertical, and the scale of each axis."""
    angle, std, imu, span = mount.angle, mount.angle_std, evidence.drive.imu, evidence.span
    if abs(angle) >= max(MOUNTING_LIMITS[0], REPORT_RATIO * std):
        # With six axes, the check of the mounting reports the rotation, with its own confidence.
        six = evidence.mounting is not None and np.array_equal(mount.axes, np.eye(2))
        ratio = REPAIR_RATIO if all(mount.known) else SERIOUS_RATIO
        # a rotation does not explain an axis whose scale differs from 1
        fits = all(abs(scale - 1) < 3 * off + DIAGONAL_TOLERANCE for scale, off in mount.scale)
        clear = abs(angle) >= ratio * std and fits and not six
        grave = abs(angle) > max(MOUNTING_LIMITS[1], SERIOUS_RATIO * std)
        severity = ("serious" if grave else "warning") if clear else "note"
        # the x axis points to this side
        degrees, side = math.degrees(angle), "left" if angle > 0 else "right"
        what = (
            f"the IMU {'is' if clear else 'may be'} rotated by {abs(degrees):.0f} deg to the {side} about the vertical "
            f"axis (standard deviation {math.degrees(std):.0f} deg)"
        )
        remedy = f"rotate (ax, ay) and (gx, gy) by {degrees:+.0f} deg"
        remedy += "" if clear else ", if other drives also show this rotation"
        repair = Repair("turn", (angle,)) if clear else None
        yield Finding("mounting", severity, what, WHERE, span, confidence_of(angle / std), remedy, repair)
    second = np.arange(imu.time[0] + 0.5, imu.time[-1], 1.0)
    force = mount.matrix @ np.array([imu.ax, imu.ay])
    remedy = "check the sensor's range setting and low-pass filter"
    (forward, std), (left, other) = mount.scale
    alike = all(mount.known) and abs(forward - left) < 3 * math.hypot(std, other)
    size = GRAVITY if imu.az is None else _size_of(_force(imu, mount.unit))
    if alike and imu.az is not None and abs(size - GRAVITY) < MAGNITUDE_LIMITS[1]:
        # the accelerometer measures gravity correctly
        remedy = (
            "check unit and projection of the positions; for example, Web Mercator (EPSG:3857) stretches them"
        )
    for name, (scale, std), row in zip(("forward", "leftward"), mount.scale, force, strict=True):
        spread = np.std(smoothed(imu.time, row, second, 1.0))
        if spread > MIN_ACCELERATION_SPREAD and abs(scale - 1) > max(WRONG_SCALE, 5 * std):
            what = (
                f"the car's {name} acceleration is {scale:.2f} times the acceleration that the IMU measures "
            )
            what += f"(standard deviation {std:.2f})"
            confidence = confidence_of((scale - 1) / std)
            yield Finding("accelerometer-scale", "warning", what, WHERE, span, confidence, remedy)


def _gravity(evidence: Evidence) -> Iterator[Finding]:
    """Check for gravity in ax and ay: constant offsets that the motion does not explain."""
    assert evidence.acceleration is not None
    leak = -np.median(evidence.acceleration.bias, axis=0)
    size = float(np.hypot(*leak))
    if np.hypot(*evidence.acceleration.bias_std) > RESIDUAL_LIMITS[1]:
        return  # the vehicle hardly moves
    margin = REPAIR_RATIO * float(np.hypot(*(leak * evidence.acceleration.bias_std))) / max(size, 1e-9)
    if size < RESIDUAL_LIMITS[0] + margin:
        return
    tilt = math.degrees(math.asin(min(size / GRAVITY, 1.0)))
    offsets = f"{leak[0]:+.2f} and {leak[1]:+.2f} m/s2"
    what = f"ax and ay contain constant offsets of {offsets}, which the motion does not cause"
    severity, confidence = "warning", 0.95
    if size > RESIDUAL_LIMITS[1] + margin:
        severity, confidence = "serious", 0.99
        what = f"{what}. They are gravity: the IMU is tilted by about {tilt:.0f} deg"
    else:
        what = f"{what}. The IMU has a bias, or is tilted by about {tilt:.0f} deg"
    remedy = "level the IMU, or subtract the offsets; --model planar8 estimates the remaining bias"
    repair = _leveled(evidence.drive.imu, leak)
    yield Finding("gravity", severity, what, WHERE, evidence.span, confidence, remedy, repair)


def _leveled(imu: Imu, leak: Array) -> Repair:
    """Level all six axes by a rotation if a tilt explains the offsets of ax and ay; otherwise subtract constants."""
    if imu.az is not None and imu.gx is not None and imu.gy is not None:
        up = np.append(leak, np.median(imu.az))
        if abs(float(np.linalg.norm(up)) - GRAVITY) < abs(float(up[2]) - GRAVITY):
            return Repair("rotate", tuple(leveling_rotation(up).ravel().tolist()))
    return Repair("level", (float(leak[0]), float(leak[1])))


def _upward(evidence: Evidence) -> Iterator[Finding]:
    """Check az, which planar filters do not use."""
    imu, mount, span = evidence.drive.imu, evidence.mount, evidence.span
    if imu.az is None:
        return
    up, unit = float(np.median(imu.az)), _unit_of_up(evidence)
    wrong = gravity_up(imu, unit)
    if wrong is None:
        yield from _magnitude(evidence, unit)
    elif mount is not None and np.array_equal(mount.axes, -np.eye(2)) and up < 0:
        return  # reported with the axes
    elif is_upside_down(evidence):
        what = (
            "az, gx and gy show that the IMU is upside down. The fixes do not show which axis points forward"
        )
        remedy = (
            "rotate all axes by 180 deg about x: import with --mount x=x,y=-y, or with the axes that the "
            "sensor's data sheet shows"
        )
        repair = Repair("rotate", tuple(np.diag([1.0, -1.0, -1.0]).ravel().tolist()))
        where = "imu.csv, ay, az, gy, gz"
        yield Finding("mounting", "serious", what, where, span, 0.95, remedy, repair)
    elif wrong.code != "accelerometer-unit":
        free = abs(up) < 0.2 * GRAVITY  # gravity was subtracted from az, which loses no information
        sign = Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, -1.0)) if up < -0.7 * GRAVITY else None
        yield finding_of(wrong, "note" if free else "warning", span, 0.99, sign)
    elif mount is None or not any(mount.known):  # otherwise the motion is better evidence
        yield finding_of(wrong, "warning", span, 0.9)
    elif unit == 1:
        factor = math.copysign(GRAVITY, up)
        what = f"the median of column az is {up:.2f}, so az seems to be in g, but ax and ay are in m/s2"
        repair = Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, factor))
        yield Finding(
            "accelerometer-up", "warning", what, "imu.csv, az", span, 0.99, f"multiply az by {factor}", repair
        )


def _unit_of_up(evidence: Evidence) -> float:
    """Return the unit of az, in m/s2: the unit of ax and ay, unless az shows gravity in m/s2."""
    az, unit = evidence.drive.imu.az, evidence.mount.unit if evidence.mount else 1.0
    return 1.0 if az is not None and abs(float(np.median(az))) > GRAVITY / 2 else unit


def _force(imu: Imu, unit: float) -> Array:
    """Return the specific force (3, n), averaged over half a second."""
    count = max(round(0.5 / imu.interval), 1)
    return unit * moving_mean(np.array([imu.ax, imu.ay, imu.az]), count)


def _size_of(force: Array) -> float:
    return float(np.median(np.linalg.norm(force, axis=0)))


def _magnitude(evidence: Evidence, unit: float) -> Iterator[Finding]:
    force = _force(evidence.drive.imu, unit)
    size = _size_of(force)
    off = size - GRAVITY
    if abs(off) < MAGNITUDE_LIMITS[0]:
        return
    large = abs(off) > MAGNITUDE_LIMITS[1]
    # Gravity is mostly in az, so a factor of az corrects the magnitude.
    level = float(np.median(np.sum(force[:2] ** 2, axis=0)))
    factor = math.sqrt(GRAVITY**2 - level) / float(np.median(force[2])) if level < GRAVITY**2 / 2 else 1.0
    what = (
        f"the IMU measures a gravity of {size:.2f} instead of {GRAVITY:.2f} m/s2 (median magnitude of the specific "
        "force)"
    )
    yield Finding(
        "gravity-size", "warning" if large else "note", what, "imu.csv, az", evidence.span, 0.99,
        f"multiply az by {factor:.3f}, or look up the sensor's scale",
        Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, factor)) if large and factor > 0 else None,
    )  # fmt: skip
