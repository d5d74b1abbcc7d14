"""Mounting of the IMU: its rotation to the axes of the vehicle, x forward, y left, z up, stated or estimated."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.checks.mounting import OR_BACKWARD, check_mounting
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.mounting import with_rotation
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import roll_pitch_yaw, rotation_of
from sigmaswarm.importing.expressions import compile_expression, with_row_numbers
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.table_columns import AXES, column_numbers, median_of

AUTO = "auto"
MIN_TILT = math.radians(20.0)  # rad, smallest reported tilt; larger than the slopes of roads
MAX_DEVIATION = 0.3  # largest relative deviation of the median specific force from gravity
_AXES = "xyz"


def find_mount(drive: Drive) -> tuple[Drive, str, str]:
    """Estimate the mounting from the log and rotate the IMU. Return the drive, the mounting as text, and a note."""
    evidence = gather(drive)
    mounting = evidence.mounting
    if evidence.mirrored:
        raise InputError(
            "mount auto: the track of the fixes is a mirror image of the IMU's motion; exchange x and y, or lat and "
            "lon, with --map"
        )
    if moved := next((f for f in check_mounting(evidence) if f.code == "mounting-changed"), None):
        backward = OR_BACKWARD in moved.what
        specified = (
            " if it was moved; otherwise specify the mounting, for example 0,10,90" if backward else ""
        )
        raise InputError(
            f"mount auto: {moved.what}, so no mounting is estimated from the whole log; import without mount auto, "
            f"split the drive ({moved.command}), and repair both parts with sigmaswarm doctor parts --fix mended"
            f"{specified}"
        )
    if mounting is None or mounting.confidence == "no":
        required = "required: ax, ay, az with gravity, gx, gy, gz, and a moving vehicle"
        reason = mounting.reason if mounting else required
        raise InputError(
            f"mount auto: the log does not show the mounting ({reason}); specify the mounting, for example 0,10,90"
        )
    mount = ",".join(f"{angle:g}" for angle in roll_pitch_yaw(mounting.repair, 1))
    total = math.degrees(float(np.linalg.norm(mounting.std)))
    note = (
        f"the mounting (roll, pitch, yaw) {mount} deg was estimated from the log (total standard deviation {total:.1f} "
        f"deg; confidence: {mounting.confidence})"
    )
    rotation = parse_mount(mount)
    metadata = with_rotation(drive.metadata, rotation)
    return replace(drive, imu=rotate_imu(drive.imu, rotation), metadata=metadata), mount, note


def parse_mount(text: str) -> Array:
    """Return the rotation (3, 3) from the axes of the sensor to those of the vehicle.

    Parameters
    ----------
    text : str
        ``"90"``: the sensor is rotated by 90 degrees about z, counter-clockwise seen from above. ``"0,10.5,90"``: roll,
        pitch and yaw of the sensor in the vehicle, degrees, about x, then y, then z. ``"x=-y,y=x"``: axes of the
        vehicle in terms of the sensor's axes; the other axes follow from these.
    """
    parts = text.replace(" ", "").split(",")
    if all("=" in part for part in parts):
        return _from_axes(text, parts)
    try:
        angles = [float(part) for part in parts]
    except ValueError:
        angles = []
    if len(angles) not in (1, 3) or not all(map(math.isfinite, angles)):
        raise InputError(
            f"mount {text!r} is not a mounting; write degrees about z (90), roll,pitch,yaw (0,10,90), axes "
            "(x=-y,y=x), or auto"
        )
    roll, pitch, yaw = angles if len(angles) == 3 else (0.0, 0.0, angles[0])
    return rotation_of(roll, pitch, yaw)


def _from_axes(text: str, parts: list[str]) -> Array:
    """Make the rotation from the given axes.

    A single axis implies that z (or x) is unchanged; two determine the third.
    """
    unit = dict(zip(_AXES, np.eye(3), strict=True))
    rows: dict[str, Array] = {}
    for part in parts:
        found = re.fullmatch(r"([xyz])=([+-]?)([xyz])", part)
        if not found or found[1] in rows:
            raise InputError(f"mount {text!r}: {part!r} is not an axis; write for example x=-y,y=x")
        rows[found[1]] = -unit[found[3]] if found[2] == "-" else unit[found[3]]
    if len(rows) == 1:
        stays = "z" if "z" not in rows else "x"
        rows[stays] = unit[stays]
    for i, axis in enumerate(_AXES):
        if axis not in rows:
            rows[axis] = np.cross(rows[_AXES[(i + 1) % 3]], rows[_AXES[(i + 2) % 3]])
    matrix = np.array([rows[axis] for axis in _AXES])
    if round(float(np.linalg.det(matrix))) != 1:
        raise InputError(
            f"mount {text!r} is left-handed or uses an axis twice; use each axis once, with signs by the "
            "right-hand rule"
        )
    return matrix


def rotate(imu: dict[str, Array], rotation: Array) -> dict[str, Array]:
    """Rotate the columns of an IMU, (n,) each, into the axes of the vehicle."""
    turned = dict(imu)
    for sensor, names in (("accelerometer", AXES[:3]), ("gyro", AXES[3:])):
        for row, name in enumerate(names):
            used = [names[k] for k in range(3) if rotation[row, k]]
            if lost := [n for n in used if n not in imu]:
                if name in ("ax", "ay", "gz"):
                    raise InputError(
                        f"mount: the vehicle's {name} needs the {sensor}'s {lost[0]}, which is not imported; map a "
                        f"column of the log to {lost[0]}"
                    )
                turned.pop(name, None)
                continue
            turned[name] = np.sum([rotation[row, names.index(n)] * imu[n] for n in used], axis=0)
    return turned


def tilted_mount(recipe: Recipe, rows: Mapping[str, pl.DataFrame], *, downward: bool) -> tuple[str, str]:
    """Return "auto" and a note if the specific force in the first rows is clearly not along +z; otherwise "" and "".

    ``downward`` is True if another note reports that the z axis points down.
    """
    force = _median_force(recipe, rows)
    size = math.hypot(*force)
    if recipe.mount or not abs(size / GRAVITY - 1) < MAX_DEVIATION:
        return "", ""
    tilt = math.acos(max(min(force[2] / size, 1.0), -1.0))
    if tilt < MIN_TILT or (downward and tilt > math.pi - MIN_TILT):
        return "", ""
    values = ", ".join(f"{name} {value:.3g}" for name, value in zip(AXES[:3], force, strict=True))
    note = (
        f"the specific force points {math.degrees(tilt):.0f} deg away from +z, so the IMU is rotated relative to the "
        f"vehicle (medians of the first rows: {values} m/s2); --mount {AUTO} estimates the rotation from the log"
    )
    return AUTO, note


def _median_force(recipe: Recipe, rows: Mapping[str, pl.DataFrame]) -> tuple[float, float, float]:
    """Return the median specific force, m/s2, of an IMU with six axes; NaN if an axis is missing."""
    found = dict.fromkeys(AXES, math.nan)
    for part in recipe.roles.get("imu", ()):
        frame = rows.get(part.table, pl.DataFrame())
        for name in found.keys() & part.columns.keys():
            found[name] = _median(part.columns[name], frame)
    ax, ay, az, *rates = found.values()
    return (ax, ay, az) if np.isfinite(rates).all() else (math.nan, math.nan, math.nan)


def _median(text: str, frame: pl.DataFrame) -> float:
    numbered = with_row_numbers(frame)
    try:
        values = numbered.select(compile_expression(text, numbered.columns).polars.alias("value"))["value"]
    except (InputError, pl.exceptions.PolarsError):
        return math.nan
    numbers = column_numbers(values.drop_nulls()).drop_nulls()
    return median_of(numbers) if len(numbers) else math.nan
