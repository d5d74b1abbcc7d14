"""Convert between WGS-84 and a local east-north-up frame, and wrap angles."""

import math
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Origin = tuple[float, float, float]  # latitude (deg), longitude (deg), altitude (m)


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: Array) -> Array: ...
def wrap_angle(angle: ArrayLike) -> float | Array:
    """Wrap angles, rad, to (-pi, pi]."""
    a = np.asarray(angle, dtype=np.float64)
    wrapped = np.pi - np.mod(np.pi - a, 2 * np.pi)
    return float(wrapped) if wrapped.ndim == 0 else wrapped


@np.errstate(all="ignore")  # places that can't be become NaN
def geodetic_to_enu(latitude: ArrayLike, longitude: ArrayLike, altitude: ArrayLike, origin: Origin) -> Array:
    """Convert latitudes (deg), longitudes (deg) and altitudes (m) to m east, north and up, shape (..., 3)."""
    import pymap3d  # not needed for drives in m

    lat, lon, alt = (np.asarray(each, np.float64) for each in (latitude, longitude, altitude))
    return np.stack(np.broadcast_arrays(*pymap3d.geodetic2enu(lat, lon, alt, *origin)), axis=-1)


@np.errstate(all="ignore")
def enu_to_geodetic(enu: ArrayLike, origin: Origin) -> Array:
    """Convert m east, north and up, shape (..., 3), to latitudes (deg), longitudes (deg) and altitudes (m)."""
    import pymap3d

    east, north, up = np.moveaxis(np.asarray(enu, np.float64), -1, 0)
    return np.stack(pymap3d.enu2geodetic(east, north, up, *origin), axis=-1)


def roll_pitch_yaw(rotation: Array, digits: int = 0) -> tuple[float, float, float]:
    """Return roll, pitch and yaw, deg, of a rotation (3, 3), as for ``import --mount``."""
    pitch = -math.asin(float(np.clip(rotation[2, 0], -1, 1)))
    angles = math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])
    roll, pitch, yaw = (round(math.degrees(angle), digits) + 0.0 for angle in angles)
    return roll, pitch, yaw
