"""WGS-84 to and from a local east-north-up plane, and the wrapping of angles."""

from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SEMI_MAJOR_AXIS = 6378137.0
"""m, WGS-84 (NIMA TR8350.2)."""
FLATTENING = 1 / 298.257223563
"""WGS-84 (NIMA TR8350.2)."""
_E2 = FLATTENING * (2 - FLATTENING)


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: Array) -> Array: ...
def wrap_angle(angle: ArrayLike) -> float | Array:
    """Wrap angles to (-pi, pi].

    Parameters
    ----------
    angle : array_like
        rad, any shape.
    """
    a = np.asarray(angle, dtype=np.float64)
    wrapped = np.pi - np.mod(np.pi - a, 2 * np.pi)
    return float(wrapped) if wrapped.ndim == 0 else wrapped


def geodetic_to_ecef(latitude: ArrayLike, longitude: ArrayLike, altitude: ArrayLike) -> Array:
    """Earth-centred, earth-fixed coordinates (..., 3) in m of geodetic degrees, degrees and m."""
    lat, lon, h = np.broadcast_arrays(
        np.radians(latitude), np.radians(longitude), np.asarray(altitude, float)
    )
    n = SEMI_MAJOR_AXIS / np.sqrt(1 - _E2 * np.sin(lat) ** 2)  # radius in the prime vertical
    return np.stack(
        [
            (n + h) * np.cos(lat) * np.cos(lon),
            (n + h) * np.cos(lat) * np.sin(lon),
            (n * (1 - _E2) + h) * np.sin(lat),
        ],
        axis=-1,
    )


def enu_axes(latitude: float, longitude: float) -> Array:
    """Rows: the east, north and up directions at a place, in earth-fixed coordinates."""
    lat, lon = np.radians(latitude), np.radians(longitude)
    return np.array(
        [
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )


def geodetic_to_enu(
    latitude: ArrayLike, longitude: ArrayLike, altitude: ArrayLike, origin: tuple[float, float, float]
) -> Array:
    """Local east, north, up of geodetic positions, exact on the ellipsoid.

    Parameters
    ----------
    latitude, longitude : array_like
        deg, WGS-84.
    altitude : array_like
        m above the ellipsoid.
    origin : tuple of float
        Latitude (deg), longitude (deg), altitude (m) of the local frame's origin.

    Returns
    -------
    ndarray, shape (..., 3)
        m east, north, up.
    """
    offset = geodetic_to_ecef(latitude, longitude, altitude) - geodetic_to_ecef(*origin)
    return offset @ enu_axes(origin[0], origin[1]).T


def enu_to_geodetic(enu: ArrayLike, origin: tuple[float, float, float]) -> Array:
    """Latitude (deg), longitude (deg), altitude (m), shape (..., 3), of local east-north-up positions.

    Bowring's parametric latitude, iterated until it stands still (B. R. Bowring, 1976, Survey Review 23).
    """
    ecef = np.asarray(enu, float) @ enu_axes(origin[0], origin[1]) + geodetic_to_ecef(*origin)
    x, y, z = ecef[..., 0], ecef[..., 1], ecef[..., 2]
    b = SEMI_MAJOR_AXIS * (1 - FLATTENING)
    p = np.hypot(x, y)
    beta = np.arctan2(SEMI_MAJOR_AXIS * z, b * p)
    lat = beta
    for _ in range(4):  # the error falls about a thousandfold per round near the ground
        lat = np.arctan2(
            z + _E2 / (1 - _E2) * b * np.sin(beta) ** 3, p - _E2 * SEMI_MAJOR_AXIS * np.cos(beta) ** 3
        )
        beta = np.arctan2((1 - FLATTENING) * np.sin(lat), np.cos(lat))
    n = SEMI_MAJOR_AXIS / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
    # p cos + z sin keeps its accuracy at the poles, where p / cos(lat) does not
    h = p * np.cos(lat) + z * np.sin(lat) - n * (1 - _E2 * np.sin(lat) ** 2)
    return np.stack([np.degrees(lat), np.degrees(np.arctan2(y, x)), h], axis=-1)
