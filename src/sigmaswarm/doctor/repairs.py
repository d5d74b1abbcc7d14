"""Repair of a drive by its findings. The given drive and its truth stay unchanged."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sigmaswarm.doctor.checks.odometer import without
from sigmaswarm.doctor.checks.velocity import CONVENTIONS
from sigmaswarm.doctor.findings import Action, Diagnosis
from sigmaswarm.doctor.mounting import turned
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.geodesy import wrap_angle

Values = tuple[float, ...]


def repair(drive: Drive, diagnosis: Diagnosis) -> Drive:
    """A copy of the drive with everything mended that can be.

    Parameters
    ----------
    drive : Drive
        The one that was diagnosed.
    diagnosis : Diagnosis
        Of it.

    Returns
    -------
    Drive
        Under the same name; ``repaired`` in its metadata lists the findings that were mended.
    """
    repairs = [f.repair for f in diagnosis.findings if f.repair is not None]
    if not repairs:
        return drive
    for action, mend in ACTIONS.items():
        # The latest first, so that a moment that is named by its time still has it.
        for fix in sorted((r for r in repairs if r.action == action), key=lambda r: r.values, reverse=True):
            drive = mend(drive, fix.values)
    mended = dict.fromkeys(f.code for f in diagnosis.findings if f.repair is not None)
    before = list(drive.metadata.get("repaired", []))
    return replace(drive, metadata={**drive.metadata, "repaired": [*before, *mended]})


def _rotate(drive: Drive, values: Values) -> Drive:
    """The rotation (3, 3), row by row, of all six axes."""
    return replace(drive, imu=turned(drive.imu, np.reshape(values, (3, 3))))


def _gyro(drive: Drive, values: Values) -> Drive:
    """Column (0, 1, 2 for gx, gy, gz) that is the yaw rate, and its factor; a unit's goes for all columns."""
    imu, (column, factor) = drive.imu, values
    name = ("gx", "gy", "gz")[int(column)]
    rates = {n: getattr(imu, n) for n in ("gx", "gy", "gz")}
    rates["gz"], rates[name] = rates[name], rates["gz"]
    changed = {n: v * (factor if n == "gz" else abs(factor)) for n, v in rates.items() if v is not None}
    return replace(drive, imu=replace(imu, **changed))


def _tilt_rates(drive: Drive, values: Values) -> Drive:
    """The matrix (2, 2), row by row, for gx and gy."""
    imu, (a, b, c, d) = drive.imu, values
    if imu.gx is None or imu.gy is None:
        return drive
    return replace(drive, imu=replace(imu, gx=a * imu.gx + b * imu.gy, gy=c * imu.gx + d * imu.gy))


def _accelerometer(drive: Drive, values: Values) -> Drive:
    """The matrix (2, 2), row by row, for ax and ay, and a factor for az."""
    imu, (a, b, c, d, up) = drive.imu, values
    az = None if imu.az is None else up * imu.az
    return replace(drive, imu=replace(imu, ax=a * imu.ax + b * imu.ay, ay=c * imu.ax + d * imu.ay, az=az))


def _turn(drive: Drive, values: Values) -> Drive:
    """rad, by which the sensor's level axes are turned back about z, those of the gyro with them."""
    c, s = math.cos(values[0]), math.sin(values[0])
    return _tilt_rates(_accelerometer(drive, (c, -s, s, c, 1.0)), (c, -s, s, c))


def _level(drive: Drive, values: Values) -> Drive:
    """Constants to be taken off ax and ay, m/s2."""
    imu = drive.imu
    return replace(drive, imu=replace(imu, ax=imu.ax - values[0], ay=imu.ay - values[1]))


def _shift_fixes(drive: Drive, values: Values) -> Drive:
    """s, to be added to the fixes' times."""
    return replace(drive, gps=replace(drive.gps, time=drive.gps.time + values[0]))


def _drop_fixes(drive: Drive, values: Values) -> Drive:
    """The times, s, of fixes to leave out."""
    return replace(drive, gps=drive.gps.select(~np.isin(drive.gps.time, values)))


def _drop_samples(drive: Drive, values: Values) -> Drive:
    """The times, s, of IMU samples to leave out."""
    return replace(drive, imu=drive.imu.select(~np.isin(drive.imu.time, values)))


def _state_noise(drive: Drive, values: Values) -> Drive:
    """m per axis, target of the median of the stated deviations."""
    gps = drive.gps
    if gps.std_x is not None and gps.std_y is not None:
        factor = values[0] / float(np.median(np.concatenate([gps.std_x, gps.std_y])))
        drive = replace(drive, gps=replace(gps, std_x=factor * gps.std_x, std_y=factor * gps.std_y))
    if "gps_std_m" in drive.metadata:
        drive = replace(drive, metadata={**drive.metadata, "gps_std_m": values[0]})
    return drive


def _velocity(drive: Drive, values: Values) -> Drive:
    """A factor for speed, and which of `CONVENTIONS` (from 1) the course is in; 0 for the right one."""
    gps, (factor, convention) = drive.gps, values
    if gps.speed is None or gps.course is None:
        return drive
    course = gps.course
    if convention:
        course = wrap_angle(list(CONVENTIONS.values())[int(convention) - 1](course))
    return replace(drive, gps=replace(gps, speed=factor * gps.speed, course=course))


def _odometer(drive: Drive, values: Values) -> Drive:
    """A factor for the odometer's speed."""
    wheels = drive.odometer
    return replace(drive, odometer=wheels and replace(wheels, speed=values[0] * wheels.speed))


def _shift_odometer(drive: Drive, values: Values) -> Drive:
    """s, to be added to the odometer's times."""
    wheels = drive.odometer
    return replace(drive, odometer=wheels and replace(wheels, time=wheels.time + values[0]))


def _drop_readings(drive: Drive, values: Values) -> Drive:
    """From when to when, s, and so on: the readings of the odometer to leave out."""
    wheels = drive.odometer
    spans = zip(values[::2], values[1::2], strict=True)
    return replace(drive, odometer=(wheels and without(wheels, spans)) or None)


def _close_jump(drive: Drive, values: Values) -> Drive:
    """A moment, s, and by how much, s, all later times are too late."""
    moment, jump = values

    def closed(time: Array) -> Array:
        return np.where(time > moment, time - jump, time)

    truth, wheels = drive.truth, drive.odometer
    return replace(
        drive,
        imu=replace(drive.imu, time=closed(drive.imu.time)),
        gps=replace(drive.gps, time=closed(drive.gps.time)),
        truth=truth and replace(truth, time=closed(truth.time)),
        odometer=wheels and replace(wheels, time=closed(wheels.time)),
    )


ACTIONS: dict[Action, Callable[[Drive, Values], Drive]] = {
    "shift-clock": _shift_fixes,
    "drop-samples": _drop_samples,
    "drop-fixes": _drop_fixes,
    "rotate": _rotate,
    "gyro": _gyro,
    "tilt-rates": _tilt_rates,
    "accelerometer": _accelerometer,
    "turn": _turn,
    "level": _level,
    "shift-fixes": _shift_fixes,
    "state-noise": _state_noise,
    "velocity": _velocity,
    "drop-readings": _drop_readings,
    "odometer": _odometer,
    "shift-odometer": _shift_odometer,
    "close-jump": _close_jump,
}
"""In the order in which they are done: rows are named by the times they came with, fixes by those of a moved clock."""
