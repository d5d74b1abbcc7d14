"""Repair the faults in a diagnosis. The given drive is not changed, and positions of the truth are never changed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.checks.odometer import without_spans
from sigmaswarm.doctor.checks.receiver import CONVENTIONS, HEADINGS
from sigmaswarm.doctor.findings import Diagnosis, Repair
from sigmaswarm.doctor.fixes import with_exchanged_axes
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.mounting import AXES_KEY, NO_ROTATION, axes_of, with_rotation, without_axes
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.tables import NO_HEADING, Imu
from sigmaswarm.geodesy import rotation_of, wrap_angle


def repair(drive: Drive, diagnosis: Diagnosis) -> Drive:
    """Return a copy of the drive with all possible repairs.

    Parameters
    ----------
    drive : Drive
        The diagnosed drive.
    diagnosis : Diagnosis

    Returns
    -------
    Drive
        A drive of the same name. In its metadata, ``repaired`` lists the repaired findings, and ``imu_mounting_deg``
        includes the rotation of the axes.
    """
    found = [(f.code, f.repair) for f in diagnosis.findings if f.repair is not None]
    if not found:
        return drive
    repairs = [r for _, r in found]
    of_axes = [r for r in repairs if r.action in AXIS_ACTIONS]
    rotation = _rotation(drive, of_axes)
    axes = dict[str, dict[str, str]]()
    changed = {r.action for r in of_axes} - {"rotate", "turn"}  # these actions change units or single axes
    if changed:
        axes = _axes(drive, of_axes, rotation)
        drive = replace(drive, metadata=without_axes(drive.metadata))
    drive = _applied(drive, repairs)
    repaired = [*drive.metadata.get("repaired", []), *dict.fromkeys(code for code, _ in found)]
    return replace(drive, metadata=with_rotation(drive.metadata, rotation) | axes | {"repaired": repaired})


def _applied(drive: Drive, repairs: Sequence[Repair]) -> Drive:
    for action, apply in ACTIONS.items():
        # The latest jump is closed first, which does not change the times of earlier jumps. The gyro's columns (0, 1)
        # are exchanged before its gz (2) is scaled.
        for values in sorted((r.values for r in repairs if r.action == action), reverse=action != "gyro"):
            drive = apply(drive, *values)
    return drive


def leave_different_axes(drive: Drive, repairs: Sequence[Repair]) -> bool:
    """Return True if repairs of both sensors give accelerometers and gyro different axes, up to tilts.

    Both must be rotated equally. If the axes were left-handed, the rates have the opposite sign.
    """
    if len(drive.imu.axes) < 6:
        return False
    force, rates = _directions(drive, repairs)
    handed, force, rates = np.sign(np.linalg.det(force)), np.rint(force), np.rint(rates)
    same = [
        np.array_equal(*pair) for pair in ((force, np.eye(3)), (rates, np.eye(3)), (rates, handed * force))
    ]
    return not any(same)


def _rotation(drive: Drive, repairs: Sequence[Repair]) -> Array | None:
    """Return the total rotation (3, 3) of repairs of the IMU's axes, or None if they are not a rotation."""
    force, rates = _directions(drive, repairs)
    same = np.allclose(force, rates, atol=1e-6) and np.allclose(force @ force.T, np.eye(3), atol=1e-6)
    return force if same and np.linalg.det(force) > 0 else None


def _directions(drive: Drive, repairs: Sequence[Repair]) -> tuple[Array, Array]:
    """Return the directions (3, 3) of the axes of accelerometers and gyro after repairs, in the recorded axes.

    Factors (units, scales) are ignored. If the IMU lacks one of the six axes, only ax, ay and gz are used, which can be
    rotated about z or exchanged.
    """
    imu = _of_unit_vectors(drive, repairs)
    six = len(imu.axes) == 6
    force = _unit_rows(imu.ax, imu.ay, imu.az if six else imu.gz)
    return force, _unit_rows(imu.gx, imu.gy, imu.gz) if six else force


def _axes(drive: Drive, repairs: Sequence[Repair], rotation: Array | None) -> dict[str, dict[str, str]]:
    """Return the expressions of the IMU's axes after repairs of units or signs, for the metadata; {} if unknown.

    If the repairs are a rotation, it is part of the metadata's mounting, and the expressions contain only factors and
    signs before it. Otherwise the metadata has no mounting, and the expressions contain the earlier mounting.
    """
    stated, names = axes_of(drive.metadata), {*drive.imu.axes}
    if not names <= stated.keys():
        return {}
    earlier = rotation_of(*(drive.mounting or NO_ROTATION))
    imu, axes = _of_unit_vectors(drive, repairs), dict[str, str]()
    for sensor in "ag":
        there = [name for name in sorted(names) if name[0] == sensor]
        own = ["xyz".index(name[1]) for name in there]
        rows = np.array([getattr(imu, name) for name in there])
        if rotation is not None:
            rows[:, own] = rotation[np.ix_(own, own)].T @ rows[:, own]
            if not np.allclose(rows, rows[0, own[0]] * np.eye(3)[own]):
                return {}
        else:
            rows = rows[:, own] @ earlier[own]
        for name, row in zip(there, rows, strict=True):
            factors = {sensor + "xyz"[k]: float(row[k]) for k in np.flatnonzero(np.abs(row) > 1e-9)}
            if not factors or not factors.keys() <= names:
                return {}
            axes[name] = " + ".join(_scaled(stated[source], factor) for source, factor in factors.items())
    return {AXES_KEY: axes}


def _scaled(text: str, factor: float) -> str:
    if math.isclose(factor, 1.0, rel_tol=1e-9):
        return text
    if math.isclose(factor, -1.0, rel_tol=1e-9):
        return f"-({text})"
    return f"radians({text})" if math.isclose(factor, math.pi / 180) else f"({text})*{factor:.8g}"


def _of_unit_vectors(drive: Drive, repairs: Sequence[Repair]) -> Imu:
    """Apply repairs to an IMU of three samples. In sample k, each sensor's axis k is 1 and the others are 0."""
    columns = {name: np.eye(3)["xyz".index(name[1])] for name in drive.imu.axes}
    return _applied(replace(drive, imu=Imu(np.zeros(3), **columns)), repairs).imu


def _unit_rows(*rows: Array | None) -> Array:
    matrix = np.array(rows, np.float64)
    return matrix / np.maximum(np.linalg.norm(matrix, axis=1)[:, None], 1e-12)


def _with(sensor: str, drive: Drive, **columns: Any) -> Drive:
    table = getattr(drive, sensor)
    return replace(drive, **{sensor: table and replace(table, **columns)})


def _exchange_fixes(drive: Drive) -> Drive:
    return with_exchanged_axes(drive) or drive


def _retimed(drive: Drive, change: Callable[[Array], Array], *sensors: str) -> Drive:
    tables = {sensor: table for sensor, table in drive.tables.items() if sensor in sensors}
    return replace(drive, **{s: replace(table, time=change(table.time)) for s, table in tables.items()})


def _shift(sensor: str, drive: Drive, seconds: float) -> Drive:
    return _retimed(drive, lambda time: time + seconds, sensor)


def _shift_clock(drive: Drive, seconds: float, with_truth: float = 0.0) -> Drive:
    """Add ``seconds`` to the times of the fixes, and to those of the truth if ``with_truth`` is 1."""
    return _retimed(drive, lambda time: time + seconds, "gps", "truth" if with_truth else "gps")


def _stretch(drive: Drive, factor: float, begin: float) -> Drive:
    """Multiply the times of IMU and odometer since ``begin``, s, by a factor."""
    return _retimed(drive, lambda time: begin + factor * (time - begin), "imu", "odometer")


def _drop(sensor: str, drive: Drive, *times: float) -> Drive:
    table = getattr(drive, sensor)
    return replace(drive, **{sensor: table.select(~np.isin(table.time, times))})


def _rotate(drive: Drive, *rotation: float) -> Drive:
    """Rotate all six axes by a matrix (3, 3), given row by row."""
    return replace(drive, imu=rotate_imu(drive.imu, np.reshape(rotation, (3, 3))))


def _gyro(drive: Drive, column: float, factor: float, alone: float = 0.0) -> Drive:
    """Use a column (0, 1, 2: gx, gy, gz), multiplied by a factor, as gz.

    The other columns are multiplied by the magnitude of the factor, unless ``alone`` is 1.
    """
    name = ("gx", "gy", "gz")[int(column)]
    rates = {n: getattr(drive.imu, n) for n in ("gx", "gy", "gz")}
    rates["gz"], rates[name] = rates[name], rates["gz"]
    factors = dict.fromkeys(rates, 1.0 if alone else abs(factor)) | {"gz": factor}
    return _with("imu", drive, **{n: v * factors[n] for n, v in rates.items() if v is not None})


def _tilt_rates(drive: Drive, a: float, b: float, c: float, d: float) -> Drive:
    """Multiply gx and gy by a matrix (2, 2), given row by row."""
    gx, gy = drive.imu.gx, drive.imu.gy
    if gx is None or gy is None:
        return drive
    return _with("imu", drive, gx=a * gx + b * gy, gy=c * gx + d * gy)


def _accelerometer(drive: Drive, a: float, b: float, c: float, d: float, up: float) -> Drive:
    """Multiply ax and ay by a matrix (2, 2), given row by row, and az by a factor."""
    ax, ay, az = drive.imu.ax, drive.imu.ay, drive.imu.az
    return _with("imu", drive, ax=a * ax + b * ay, ay=c * ax + d * ay, az=None if az is None else up * az)


def _turn(drive: Drive, angle: float) -> Drive:
    """Rotate the horizontal axes of accelerometer and gyro by -angle, rad, about z."""
    c, s = math.cos(angle), math.sin(angle)
    return _tilt_rates(_accelerometer(drive, c, -s, s, c, 1.0), c, -s, s, c)


def _level(drive: Drive, x: float, y: float) -> Drive:
    """Subtract constants, m/s2, from ax and ay."""
    return _with("imu", drive, ax=drive.imu.ax - x, ay=drive.imu.ay - y)


def _state_noise(drive: Drive, std: float) -> Drive:
    """Scale the stated standard deviations to a median of ``std``, m per axis."""
    x, y = drive.gps.std_x, drive.gps.std_y
    if x is not None and y is not None:
        factor = std / float(np.median(np.concatenate([x, y])))
        drive = _with("gps", drive, std_x=factor * x, std_y=factor * y)
    if "gps_std_m" in drive.metadata:
        drive = replace(drive, metadata={**drive.metadata, "gps_std_m": std})
    return drive


def _velocity(drive: Drive, factor: float, convention: float) -> Drive:
    """Multiply the speed by a factor, and convert the course from a convention.

    ``convention`` is its number in `CONVENTIONS`, counted from 1; 0 leaves the course unchanged.
    """
    speed, course = drive.gps.speed, drive.gps.course
    if speed is None or course is None:
        return drive
    if convention:
        course = wrap_angle(list(CONVENTIONS.values())[int(convention) - 1](course))
    return _with("gps", drive, speed=factor * speed, course=course)


def _heading(drive: Drive, convention: float, offset: float) -> Drive:
    """Convert the heading from the convention with this index in `HEADINGS`, and subtract a constant, rad."""
    heading, std = drive.gps.heading, drive.gps.std_heading
    name, read = [*HEADINGS.items()][int(convention)]
    if heading is None:
        return drive
    if std is not None and name.startswith("deg"):
        std = np.where(std < NO_HEADING, np.radians(std), std)
    return _with("gps", drive, heading=wrap_angle(read(heading) - offset), std_heading=std)


def _odometer(drive: Drive, factor: float) -> Drive:
    return _with("odometer", drive, speed=drive.odometer and factor * drive.odometer.speed)


def _drop_readings(drive: Drive, *ends: float) -> Drive:
    """Remove spans of the odometer, given by starts and ends, s."""
    spans = zip(ends[::2], ends[1::2], strict=True)
    return replace(drive, odometer=(drive.odometer and without_spans(drive.odometer, spans)) or None)


def _close_jump(drive: Drive, moment: float, jump: float) -> Drive:
    """Subtract the jump, s, from all times after ``moment``, s."""
    return _retimed(drive, lambda time: np.where(time > moment, time - jump, time), *drive.tables)


def _cut_ends(drive: Drive, begin: float, end: float) -> Drive:
    return clip(drive, begin, math.nextafter(end, math.inf))


# actions that change the axes of the IMU
AXIS_ACTIONS = {"rotate", "gyro", "tilt-rates", "accelerometer", "turn"}
CLOCK_ACTIONS = {"shift-clock", "shift-fixes", "stretch-imu"}
# actions that change the motion that a filter computes, so the predictions of a filter verify them
VERIFIED_ACTIONS = CLOCK_ACTIONS | {"rotate", "gyro", "accelerometer", "turn", "level"}
# In the order of application. Actions refer to rows by recorded times, and to fixes by corrected times.
ACTIONS: dict[str, Callable[..., Drive]] = {
    "exchange-fixes": _exchange_fixes,
    "shift-clock": _shift_clock,
    "shift-truth": partial(_shift, "truth"),
    "drop-samples": partial(_drop, "imu"),
    "drop-fixes": partial(_drop, "gps"),
    "rotate": _rotate,
    "gyro": _gyro,
    "tilt-rates": _tilt_rates,
    "accelerometer": _accelerometer,
    "turn": _turn,
    "level": _level,
    "shift-fixes": _shift_clock,
    "state-noise": _state_noise,
    "velocity": _velocity,
    "heading": _heading,
    "drop-readings": _drop_readings,
    "odometer": _odometer,
    "shift-odometer": partial(_shift, "odometer"),
    "cut-ends": _cut_ends,
    "close-jump": _close_jump,
    "stretch-imu": _stretch,
}
