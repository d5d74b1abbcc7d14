"""CARLA's two geodesies: convert positions (x east, y south, m) to latitude and longitude, and back.

Neither is WGS-84, so CARLA's fixes must be converted to meters by the same formulas.

- Up to 0.9.15: a Mercator plane on a sphere (LibCarla's GeoLocation).
- 0.9.16: a transverse Mercator plane on the same sphere with scale 0.9996 on the central meridian, whatever the map
  states; y counts **north**, so drives are mirrored (carla-simulator/carla#9389, fixed after the release).
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CarlaVersion = Literal["0.9.14", "0.9.16"]

EARTH_RADIUS = 6378137.0
"""Radius of CARLA's sphere, m."""
_SCALE_0916 = 0.9996


def to_geolocation(
    x: Array, y: Array, latitude: float, longitude: float, version: CarlaVersion = "0.9.14"
) -> tuple[Array, Array]:
    """Return latitude and longitude, deg, shapes (n,), that CARLA gives to positions.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        m, in CARLA's left-handed frame.
    latitude, longitude : float
        Latitude and longitude of CARLA's origin, deg: the map's georeference.
    version : {"0.9.14", "0.9.16"}
        The first also applies to all versions from 0.9.0 to 0.9.15.
    """
    if version == "0.9.16":
        across = x / (_SCALE_0916 * EARTH_RADIUS)
        along = math.radians(latitude) + y / (_SCALE_0916 * EARTH_RADIUS)
        lat = np.arcsin(np.sin(along) / np.cosh(across))
        return np.degrees(lat), longitude + np.degrees(np.arctan2(np.sinh(across), np.cos(along)))
    radius = math.cos(math.radians(latitude)) * EARTH_RADIUS
    north = radius * math.log(math.tan(math.radians(90 + latitude) / 2)) - y
    return 2 * np.degrees(np.arctan(np.exp(north / radius))) - 90, longitude + np.degrees(x / radius)


def from_geolocation(
    lat: Array, lon: Array, latitude: float, longitude: float, version: CarlaVersion = "0.9.14"
) -> tuple[Array, Array]:
    """Return x, y (m, shapes (n,)) in CARLA's frame: the inverse of `to_geolocation`."""
    if version == "0.9.16":
        phi, away = np.radians(lat), np.radians(np.asarray(lon) - longitude)
        x = np.arctanh(np.cos(phi) * np.sin(away))
        y = np.arctan2(np.tan(phi), np.cos(away)) - math.radians(latitude)
        return _SCALE_0916 * EARTH_RADIUS * x, _SCALE_0916 * EARTH_RADIUS * y
    radius = math.cos(math.radians(latitude)) * EARTH_RADIUS
    start = math.log(math.tan(math.radians(90 + latitude) / 2))
    north = radius * (np.log(np.tan(np.radians(90 + np.asarray(lat)) / 2)) - start)
    return radius * np.radians(np.asarray(lon) - longitude), -north
