"""The accelerometers: axes, signs, unit and scale of ax and ay, mounting angle, gravity in them."""

import math
from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_by_margin, confidence_of, finding_of
from sigmaswarm.doctor.verdicts import Mount
from sigmaswarm.doctor.windows import moving_mean
from sigmaswarm.doctor.yaw_fit import smoothed
from sigmaswarm.drives.checks import GRAVITY, gravity_on, gravity_up
from sigmaswarm.drives.drive import Array

MOUNTING = (math.radians(5), math.radians(10))
"""rad: a rotation about z from the first on is a warning, from the second on serious."""
TILT = (0.5, 1.2)
"""m/s2: the same for what is left over in ax, ay. Roads and cheap sensors' biases stay below the second."""
SIZE = (0.3, 1.0)
"""m/s2 by which the usual specific force differs from gravity: from the first on a note, from the second on a warning.
Cheap sensors reach 0.8: 3% of scale and 0.05 g of bias (MPU-6050)."""
CLEAR = 3.5
"""Deviations."""
WRONG_SCALE = 0.4
LEAST_PUSH = 0.4
"""m/s2: acceleration below which the scale is unknown."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the accelerometers."""
    imu = evidence.drive.imu
    if wrong := gravity_on(imu):
        yield finding_of(wrong, "serious", evidence.span, 0.999)
        return
    mount = evidence.mount
    if mount is not None:
        yield from _axes(evidence, mount)
        yield from _unit(evidence, mount)
        yield from _mounting(evidence, mount)
        yield from _scale(evidence, mount)
        yield from _gravity(evidence)
    yield from _upward(evidence)


def _axes(evidence: Evidence, mount: Mount) -> Iterator[Finding]:
    axes = mount.axes
    if np.array_equal(axes, np.eye(2)):
        return
    swapped = axes[0, 0] == 0
    forward, left = (_reading(row) for row in axes)
    az = evidence.drive.imu.az
    opposite = np.array_equal(axes, -np.eye(2)) and az is not None and float(np.median(az)) < 0
    what = f"forward acceleration stands in {forward}, that to the left in {left}"
    if opposite:
        what = "the accelerometers report the opposite of specific force: ax, ay and az have the wrong sign"
    elif not all(mount.known):
        what = f"{what} (the drive shows only {'forward' if mount.known[0] else 'sideways'} acceleration)"
    yield Finding(
        "accelerometer-axes" if swapped else "accelerometer-sign",
        "serious", what, "imu.csv, ax, ay", evidence.span, confidence_by_margin(mount.margin),
        f"read ax as {forward} and ay as {left}" + (" and change the sign of az" if opposite else ""),
        Repair("accelerometer", (*axes.ravel().tolist(), -1.0 if opposite else 1.0)),
    )  # fmt: skip


def _reading(row: np.ndarray) -> str:
    """Of a row with one entry, +1 or -1, as a column's name with its sign."""
    k = int(np.argmax(np.abs(row)))
    return f"{'-' if row[k] < 0 else ''}{('ax', 'ay')[k]}"


def _unit(evidence: Evidence, mount: Mount) -> Iterator[Finding]:
    if mount.unit != 1:
        yield Finding(
            "accelerometer-unit", "serious",
            f"the accelerations are in g: the car's motion is {mount.unit * mount.scale[0][0]:.1f} times what ax says",
            "imu.csv, ax, ay, az", evidence.span, confidence_by_margin(mount.margin),
            f"multiply ax, ay, az by {GRAVITY}",
            Repair("accelerometer", (GRAVITY, 0.0, 0.0, GRAVITY, GRAVITY)),
        )  # fmt: skip


def _mounting(evidence: Evidence, mount: Mount) -> Iterator[Finding]:
    angle, std = mount.angle, mount.angle_std
    if abs(angle) < max(MOUNTING[0], CLEAR * std):
        return
    degrees = math.degrees(angle)
    side = "left" if angle > 0 else "right"  # a = R(angle) u: the sensor's x points to that side
    yield Finding(
        "mounting", "serious" if abs(angle) > MOUNTING[1] else "warning",
        f"the IMU is turned by {abs(degrees):.0f} deg (deviation {math.degrees(std):.0f}) to the {side} "
        "about the vertical",
        "imu.csv, ax, ay", evidence.span, confidence_of(angle / std),
        f"turn (ax, ay) and (gx, gy) by {degrees:+.0f} deg",
        Repair("turn", (angle,)),
    )  # fmt: skip


def _scale(evidence: Evidence, mount: Mount) -> Iterator[Finding]:
    for name, (scale, std), pushed in zip(
        ("forward", "left"), mount.scale, _pushed(evidence, mount), strict=True
    ):
        if pushed > LEAST_PUSH and abs(scale - 1) > max(WRONG_SCALE, 5 * std):
            yield Finding(
                "accelerometer-scale", "warning",
                f"the acceleration {name} is {scale:.2f} times what the IMU says (deviation {std:.2f})",
                "imu.csv, ax, ay", evidence.span, confidence_of((scale - 1) / std),
                "check the range setting, and whether the log was filtered",
            )  # fmt: skip


def _pushed(evidence: Evidence, mount: Mount) -> Array:
    """m/s2, (forward, left): how the acceleration, over a second, varies."""
    imu = evidence.drive.imu
    force = mount.matrix @ np.array([imu.ax, imu.ay])
    second = np.arange(imu.time[0] + 0.5, imu.time[-1], 1.0)
    return np.array([np.std(smoothed(imu.time, row, second, 1.0)) for row in force], np.float64)


def _gravity(evidence: Evidence) -> Iterator[Finding]:
    """The mean of ax, ay less the car's own motion."""
    assert evidence.acceleration is not None
    leak = -np.median(evidence.acceleration.bias, axis=0)
    size = float(np.hypot(*leak))
    margin = 2 * _bias_std(evidence)
    if size < TILT[0] + margin:
        return
    tilt = math.degrees(math.asin(min(size / GRAVITY, 1.0)))
    serious = size > TILT[1] + margin
    carried = f"in ax, ay: {leak[0]:+.2f}, {leak[1]:+.2f} m/s2 that no motion explains"
    what = f"bias, or tilt of {tilt:.0f} deg, {carried}"
    if serious:
        what = f"gravity {carried}; the IMU is tilted by about {tilt:.0f} deg"
    yield Finding(
        "gravity", "serious" if serious else "warning", what, "imu.csv, ax, ay", evidence.span,
        0.99 if serious else 0.95, "level the IMU, or take the constant off; --model planar8 estimates the rest",
        Repair("level", (float(leak[0]), float(leak[1]))),
    )  # fmt: skip


def _bias_std(evidence: Evidence) -> float:
    """m/s2: how well fixes show a constant acceleration (a parabola's, over each window), doubled for M's own."""
    assert evidence.course is not None
    assert evidence.acceleration is not None
    rows, time = evidence.acceleration.rows, evidence.course.time
    length = float(np.median(time[rows[:, -1]] - time[rows[:, 0]]))
    parabola = evidence.scatter * math.sqrt(720 / rows.shape[1]) / length**2
    return 2 * parabola * math.sqrt(2 / len(rows))


def _upward(evidence: Evidence) -> Iterator[Finding]:
    """Faults that az shows, which planar filters do not use."""
    imu, mount = evidence.drive.imu, evidence.mount
    if imu.az is None:
        return
    wrong = gravity_up(imu, mount.unit if mount else 1.0)
    if wrong is None:
        yield from _size(evidence)
        return
    up = float(np.median(imu.az))
    if mount is not None and np.array_equal(mount.axes, -np.eye(2)) and up < 0:
        return  # reported there
    if wrong.code == "accelerometer-unit":
        if mount is None or not any(mount.known):  # else the motion is the better evidence
            yield finding_of(wrong, "warning", evidence.span, 0.9)
        elif mount.unit == 1:
            factor = math.copysign(GRAVITY, up)
            yield Finding(
                "accelerometer-up", "warning",
                f"column az has median {up:.2f}, as if in g, while ax and ay are in m/s2",
                "imu.csv, az", evidence.span, 0.99, f"multiply az by {factor}",
                Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, factor)),
            )  # fmt: skip
        return
    free = abs(up) < 0.2 * GRAVITY  # gravity was taken off, and nothing is lost
    sign = Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, -1.0)) if up < -0.7 * GRAVITY else None
    yield finding_of(wrong, "note" if free else "warning", evidence.span, 0.99, sign)


def _size(evidence: Evidence) -> Iterator[Finding]:
    """Find a specific force whose usual magnitude, over half a second, is not gravity."""
    imu, mount = evidence.drive.imu, evidence.mount
    assert imu.az is not None
    unit = mount.unit if mount else 1.0
    count = max(round(0.5 / float(np.median(np.diff(imu.time)))), 1)
    force = unit * moving_mean(np.array([imu.ax, imu.ay, imu.az]), count)
    size = float(np.median(np.linalg.norm(force, axis=0)))
    off = size - GRAVITY
    if abs(off) < SIZE[0]:
        return
    large = abs(off) > SIZE[1]
    # What az lacks to make the sum right: along the others gravity hardly stands.
    level = float(np.median(np.sum(force[:2] ** 2, axis=0)))
    factor = math.sqrt(GRAVITY**2 - level) / float(np.median(force[2])) if level < GRAVITY**2 / 2 else 1.0
    yield Finding(
        "gravity-size", "warning" if large else "note",
        f"the specific force has the size {size:.2f} m/s2 where gravity is {GRAVITY:.2f}: az is off by {off:+.2f}",
        "imu.csv, az", evidence.span, 0.99, f"multiply az by {factor:.3f}, or look up the sensor's scale",
        Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, factor)) if large and factor > 0 else None,
    )  # fmt: skip
