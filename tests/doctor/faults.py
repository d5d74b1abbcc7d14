"""Faults to plant in sound drives, one at a time, and the codes with which the doctor should report them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sigmaswarm.drives.drive import Drive

G = 9.80665


def _imu(drive: Drive, **columns: np.ndarray | None) -> Drive:
    return replace(drive, imu=replace(drive.imu, **columns))


def flipped_yaw(drive: Drive) -> Drive:
    return _imu(drive, gz=-drive.imu.gz)


def degrees_per_second(drive: Drive) -> Drive:
    rates = {n: getattr(drive.imu, n) for n in ("gx", "gy", "gz")}
    return _imu(drive, **{n: None if v is None else np.degrees(v) for n, v in rates.items()})


def in_g(drive: Drive) -> Drive:
    forces = {n: getattr(drive.imu, n) for n in ("ax", "ay", "az")}
    return _imu(drive, **{n: None if v is None else v / G for n, v in forces.items()})


def swapped(drive: Drive) -> Drive:
    return _imu(drive, ax=drive.imu.ay, ay=drive.imu.ax)


def reversed_force(drive: Drive) -> Drive:
    imu = drive.imu
    return _imu(drive, ax=-imu.ax, ay=-imu.ay, az=None if imu.az is None else -imu.az)


def right_and_down(drive: Drive) -> Drive:
    """Rotate the body axes to forward, right, down, as in aviation."""
    imu = drive.imu
    drive = _imu(drive, ay=-imu.ay, gz=-imu.gz, az=None if imu.az is None else -imu.az)
    return _imu(drive, gy=None if imu.gy is None else -imu.gy)


def fixes_late(seconds: float) -> Callable[[Drive], Drive]:
    def plant(drive: Drive) -> Drive:
        return replace(drive, gps=replace(drive.gps, time=drive.gps.time + seconds))

    return plant


def pitched(drive: Drive) -> Drive:
    """Pitch the sensor up by 10 deg; without az and gx, gravity has its nominal size and there is no roll rate."""
    imu, (c, s) = drive.imu, (np.cos(np.radians(10)), np.sin(np.radians(10)))
    az = imu.az if imu.az is not None else G
    gx = imu.gx if imu.gx is not None else 0.0
    changed = {"ax": c * imu.ax + s * az, "gz": c * imu.gz - s * gx}
    if imu.az is not None:
        changed["az"] = c * imu.az - s * imu.ax
    if imu.gx is not None:
        changed["gx"] = c * imu.gx + s * imu.gz
    return _imu(drive, **changed)


def turned(drive: Drive) -> Drive:
    """Rotate the sensor by 15 deg to the left."""
    imu, (c, s) = drive.imu, (np.cos(np.radians(15)), np.sin(np.radians(15)))
    drive = _imu(drive, ax=c * imu.ax + s * imu.ay, ay=c * imu.ay - s * imu.ax)
    if imu.gx is None or imu.gy is None:
        return drive
    return _imu(drive, gx=c * imu.gx + s * imu.gy, gy=c * imu.gy - s * imu.gx)


def rolls_reversed(drive: Drive) -> Drive:
    return _imu(drive, gx=-drive.imu.gx)


def pitches_reversed(drive: Drive) -> Drive:
    return _imu(drive, gy=-drive.imu.gy)


def rates_swapped(drive: Drive) -> Drive:
    return _imu(drive, gx=drive.imu.gy, gy=-drive.imu.gx)


def up_in_g(drive: Drive) -> Drive:
    return _imu(drive, az=-drive.imu.az / G)


def up_too_large(drive: Drive) -> Drive:
    return _imu(drive, az=1.15 * drive.imu.az)


def stated(factor: float) -> Callable[[Drive], Drive]:
    """Multiply the stated deviations of the fixes (1 m if there are none)."""

    def plant(drive: Drive) -> Drive:
        gps = drive.gps
        x, y = (np.ones(len(gps)) if v is None else v for v in (gps.std_x, gps.std_y))
        return replace(drive, gps=replace(gps, std_x=factor * x, std_y=factor * y))

    return plant


def outlying(drive: Drive) -> Drive:
    """Move one fix in 50 by 20 to 60 m."""
    rng, gps = np.random.default_rng(1), drive.gps
    rows = rng.choice(np.arange(5, len(gps) - 5), max(len(gps) // 50, 2), replace=False)
    off = np.zeros(len(gps), dtype=np.complex128)
    off[rows] = rng.uniform(20, 60, len(rows)) * np.exp(2j * np.pi * rng.random(len(rows)))
    return replace(drive, gps=replace(gps, x=gps.x + off.real, y=gps.y + off.imag))


def with_gaps(drive: Drive) -> Drive:
    """Remove 2 s of the IMU and 8 s of the fixes."""
    imu, gps, middle = drive.imu, drive.gps, float(np.mean(drive.imu.time[[0, -1]]))
    imu = imu.select((imu.time < middle) | (imu.time > middle + 2))
    return replace(drive, imu=imu, gps=gps.select((gps.time < middle - 10) | (gps.time > middle - 2)))


def held(drive: Drive) -> Drive:
    """Make every second fix repeat the fix before it."""
    gps, rows = drive.gps, np.arange(len(drive.gps)) // 2 * 2
    return replace(drive, gps=replace(gps, x=gps.x[rows], y=gps.y[rows]))


FAULTS: dict[str, tuple[Callable[[Drive], Drive], set[str]]] = {
    "yaw-flipped": (flipped_yaw, {"gyro-sign"}),
    "deg/s": (degrees_per_second, {"gyro-unit"}),
    "g": (in_g, {"accelerometer-unit"}),
    "axes-swapped": (swapped, {"accelerometer-axes"}),
    "0.2 s late": (fixes_late(0.2), {"clock-offset"}),
    "gravity": (pitched, {"gravity"}),
    "15 deg": (turned, {"mounting"}),
    "stated x 10": (stated(10.0), {"gps-noise"}),
    "outliers": (outlying, {"gps-outliers"}),
    "gaps": (with_gaps, {"imu-gap", "gps-gap"}),
}
"""Ten kinds of faults, and the codes to report."""

MORE: dict[str, tuple[Callable[[Drive], Drive], set[str]]] = {
    "stated / 10": (stated(0.1), {"gps-noise"}),
    "0.2 s early": (fixes_late(-0.2), {"clock-offset"}),
    "0.5 s late": (fixes_late(0.5), {"clock-offset"}),
    "force reversed": (reversed_force, {"accelerometer-sign"}),
    "right and down": (right_and_down, {"accelerometer-sign", "gyro-sign"}),
    "fixes held": (held, {"gps-repeats"}),
}
"""Variants of these faults."""

THIRD_AXES: dict[str, tuple[Callable[[Drive], Drive], set[str]]] = {
    "gx reversed": (rolls_reversed, {"gyro-tilt"}),
    "gy reversed": (pitches_reversed, {"gyro-tilt"}),
    "gx, gy swapped": (rates_swapped, {"gyro-tilt"}),
    "az in -g": (up_in_g, {"accelerometer-up"}),
    "az x 1.15": (up_too_large, {"gravity-size"}),
    "right and down": (right_and_down, {"gyro-tilt", "accelerometer-up"}),
    "deg/s": (degrees_per_second, {"gyro-unit"}),
    "g": (in_g, {"accelerometer-unit"}),
}
"""Faults of az, gx and gy, for drives with these columns; planar filters do not use them."""

THIRD = {"gyro-tilt", "gravity-size", "accelerometer-up", "unseen-tilt"}
"""Codes of faults of az, gx and gy."""

ROTATIONS = {"gravity", "15 deg", "right and down"}
"""Faults that are one rotation of the IMU."""


def codes_of(fault: str, drive: Drive) -> set[str]:
    """Return the codes to report; with six axes, a rotation is one finding."""
    six = drive.imu.az is not None and drive.imu.gx is not None
    return {"mounting"} if six and fault in ROTATIONS else (FAULTS | MORE | THIRD_AXES)[fault][1]
