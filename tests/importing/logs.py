"""A drive with columns that are easy to recognize in a log, and its import, for the importer's tests."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing.convert import ImportResult, import_drive
from sigmaswarm.importing.opening import Request
from sigmaswarm.simulation.scenarios import simulate
from support import make_drive

ORIGIN = (50.0, 8.0, 100.0)
EPOCH = 1_700_000_000
"""s, when the logs of the tests begin."""


def a_drive(duration: float = 6.0) -> Drive:
    """A drive with every column that a drive can have, fixes in degrees, and wobbling gx, gy, az."""
    plain = make_drive(duration=duration, gps_rate=5.0, seed=3, name="logged")
    rng = np.random.default_rng(5)
    n, m = len(plain.imu), len(plain.gps)
    imu = type(plain.imu)(
        **{
            **{c: getattr(plain.imu, c) for c in ("time", "ax", "ay", "gz")},
            "az": 9.8 + 0.1 * rng.standard_normal(n),
            "gx": 0.01 * rng.standard_normal(n),
            "gy": 0.01 * rng.standard_normal(n),
        }
    )
    enu = np.column_stack([plain.gps.x, plain.gps.y, rng.uniform(-1, 1, m)])
    lat, lon, alt = enu_to_geodetic(enu, ORIGIN).T
    std = rng.uniform(0.5, 2.0, (2, m))
    gps = Gps(
        plain.gps.time,
        plain.gps.x,
        plain.gps.y,
        lat,
        lon,
        alt,
        std[0],
        std[1],
        rng.uniform(3, 14, m),
        rng.uniform(-3, 3, m),
    )
    return Drive("logged", imu, gps, plain.truth, "wgs84", ORIGIN)


@cache
def city_drive() -> Drive:
    """A simulated drive in a city; the modules that use it share it."""
    return simulate("urban", duration=90.0, imu_rate=50.0, run=1, gps="white-1m")


def imported(source: Path, **options: Any) -> ImportResult:
    """Import without the command line."""
    return import_drive(Request(source, **options), "logged")


def assert_close(got: Any, wanted: Any, columns: str, atol: float = 1e-9) -> None:
    """Columns of two tables agree to ``atol``."""
    for column in columns.split():
        a, b = getattr(got, column), getattr(wanted, column)
        assert a is not None, column
        np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=column)
