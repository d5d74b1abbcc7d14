"""Conversion of axes, angles, latitudes and longitudes; interpolation.

CARLA's axes are left-handed (x east, y south; body x forward, y right). Only `polar` and `axial` convert them to
sigmaswarm's axes (east-north-up; forward-left-up).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from ctypes import c_float
from typing import Any

from .options import RecorderError

METERS_PER_DEGREE = math.pi * 6378137.0 / 180.0  # m, degree of latitude on CARLA's sphere


def polar(v: Any) -> tuple[float, float, float]:
    """Convert a position, velocity or force from CARLA's axes to sigmaswarm's."""
    return v.x, -v.y, v.z


def axial(v: Any) -> tuple[float, float, float]:
    """Convert an angular rate from CARLA's axes to sigmaswarm's."""
    return -v.x, v.y, -v.z


def heading_of(rotation: Any) -> float:
    """Return the heading of a CARLA rotation, rad counter-clockwise from east, in (-pi, pi]."""
    return wrap(-math.radians(rotation.yaw))


def wrap(angle: float) -> float:
    """Wrap an angle (rad) to (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2 * math.pi)


def interpolate(table: Sequence[tuple[float, float]], x: float) -> float:
    """Interpolate linearly in a table of (x, y); beyond the ends of the table, y is constant."""
    if x <= table[0][0]:
        return table[0][1]
    for (x0, y0), (x1, y1) in zip(table, table[1:]):
        if x <= x1:
            return y0 + (y1 - y0) * (x - x0) / (x1 - x0)
    return table[-1][1]


class Geodesy:
    """Conversion of CARLA's latitudes and longitudes to m: Newton's method inverts the formula of the client.

    This formula is not WGS-84 and differs between versions: 0.9.16 mirrors north and south (carla#9389).
    """

    def __init__(self, locate: Callable[[float, float], tuple[float, float]]) -> None:
        """Use ``locate``, which converts CARLA's x and y (m) to latitude and longitude, deg."""
        self._locate = locate
        self.origin = locate(0.0, 0.0)
        self.east = locate(100.0, 0.0)
        self.south = locate(0.0, 100.0)
        (lat, lon), (lat_x, lon_x), (lat_y, lon_y) = self.origin, self.east, self.south
        self._rows = ((lat_x - lat) / 100, (lat_y - lat) / 100), ((lon_x - lon) / 100, (lon_y - lon) / 100)
        (a, b), (c, d) = self._rows
        per_meter = 1 / METERS_PER_DEGREE
        if not 0.5 * per_meter**2 < abs(a * d - b * c) < 50 * per_meter**2:
            raise RecorderError(
                f"the map has no usable latitudes and longitudes: {self.origin}, {self.east}, {self.south} deg at "
                "(0, 0), (100, 0), (0, 100) m; add a georeference to its OpenDRIVE file"
            )

    @classmethod
    def probe(cls, carla: Any, town: Any) -> Geodesy:
        """Return the geodesy of a `carla.Map`."""

        def locate(x: float, y: float) -> tuple[float, float]:
            found = town.transform_to_geolocation(carla.Location(x=x, y=y, z=0.0))
            return found.latitude, found.longitude

        return cls(locate)

    def place(self, lat: float, lon: float) -> tuple[float, float]:
        """Convert a latitude and longitude (deg) to m east and north."""
        (a, b), (c, d) = self._rows
        determinant = a * d - b * c
        x = y = 0.0
        for _ in range(6):
            x, y = c_float(x).value, c_float(y).value  # the client's positions have single precision
            at = self._locate(x, y)
            e, f = lat - at[0], lon - at[1]
            dx, dy = (d * e - b * f) / determinant, (a * f - c * e) / determinant
            x, y = x + dx, y + dy
        return x, -y

    def degrees(self, meters: float) -> tuple[float, float]:
        """Convert a standard deviation (m) to the standard deviations of latitude and longitude, deg."""
        (a, b), (c, d) = self._rows
        return meters * math.hypot(a, b), meters * math.hypot(c, d)

    def report(self) -> dict[str, Any]:
        """Return latitude and longitude (deg) of three points of the map, for recording.json."""
        return {
            "at_0_0": self.origin,
            "at_100_0": self.east,
            "at_0_100": self.south,
            "latitude_grows_south": self.south[0] > self.origin[0],
        }
