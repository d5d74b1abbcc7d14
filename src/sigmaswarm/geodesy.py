"""Convert between WGS-84 and a local east-north-up frame, and wrap angles."""

import math
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from sigmaswarm.arrays import Array

Origin = tuple[float, float, float]  # latitude (deg), longitude (deg), altitude (m)
STANDARD_GRAVITY = 9.80665  # m/s2; filters and exported C code use 9.81: see `filters.tilted`


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: Array) -> Array: ...
def wrap_angle(angle: ArrayLike) -> float | Array:
    """Wrap angles (rad) to (-pi, pi]."""
    a = np.asarray(angle, dtype=np.float64)
    wrapped = np.pi - np.mod(np.pi - a, 2 * np.pi)
    return float(wrapped) if wrapped.ndim == 0 else wrapped


@np.errstate(all="ignore")  # invalid coordinates become NaN
def geodetic_to_enu(latitude: ArrayLike, longitude: ArrayLike, altitude: ArrayLike, origin: Origin) -> Array:
    """Convert latitudes (deg), longitudes (deg) and altitudes (m) to east, north and up (m), shape (..., 3)."""
    import pymap3d  # imported late, since drives in m do not need it

    lat, lon, alt = (np.asarray(values, np.float64) for values in (latitude, longitude, altitude))
    return np.stack(np.broadcast_arrays(*pymap3d.geodetic2enu(lat, lon, alt, *origin)), axis=-1)


@np.errstate(all="ignore")
def enu_to_geodetic(enu: ArrayLike, origin: Origin) -> Array:
    """Convert east, north and up (m), shape (..., 3), to latitudes (deg), longitudes (deg) and altitudes (m)."""
    import pymap3d

    east, north, up = np.moveaxis(np.asarray(enu, np.float64), -1, 0)
    return np.stack(pymap3d.enu2geodetic(east, north, up, *origin), axis=-1)


def rotation_of(roll: float, pitch: float, yaw: float) -> Array:
    """Return the rotation (3, 3) by angles (deg) about fixed axes: x, then y, then z, as in ``import --mount``."""
    return _turn(2, math.radians(yaw)) @ _turn(1, math.radians(pitch)) @ _turn(0, math.radians(roll))


def _turn(axis: int, angle: float) -> Array:
    """Return the rotation (3, 3) by an angle (rad) about an axis; exact for quarter turns."""
    quarter = angle / (math.pi / 2)
    c, s = math.cos(angle), math.sin(angle)
    if abs(quarter - round(quarter)) < 1e-12:
        c, s = float(round(c)), float(round(s))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def roll_pitch_yaw(rotation: Array, digits: int = 0) -> tuple[float, float, float]:
    """Return the angles of `rotation_of` (deg), rounded. The roll is 0 if the pitch is 90 or -90 deg."""
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    roll, yaw = math.atan2(rotation[2, 1], rotation[2, 2]), math.atan2(rotation[1, 0], rotation[0, 0])
    if level < 1e-9:  # x is vertical: only yaw - roll, or yaw + roll, is determined
        roll, yaw = 0.0, math.atan2(-rotation[0, 1], rotation[1, 1])
    angles = roll, math.atan2(-rotation[2, 0], level), yaw
    roll, pitch, yaw = (round(math.degrees(angle), digits) + 0.0 for angle in angles)
    return roll, pitch, yaw
