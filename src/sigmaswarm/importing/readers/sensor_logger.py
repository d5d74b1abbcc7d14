"""Sensor Logger (iOS, Android): a folder or zip with Accelerometer.csv, Gyroscope.csv, Location.csv and others.

Units and axes from UNITS.md and COORDINATES.md in the author's repository tszheichoi/awesome-sensor-logger: ``time`` in
ns since 1970; Accelerometer without gravity, and Gravity, both with opposite signs on iOS; TotalAcceleration
with gravity on Android; bearing in degrees from north; negative values are invalid.
"""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.columns import ColumnFiles, collect
from sigmaswarm.importing.readers.phones import FLAT, RADIUS_68, names_in, phone_files, unpacked
from sigmaswarm.importing.source import Guess, Part, Role, Source

FILES = ("TotalAcceleration.csv", "Accelerometer.csv", "Gravity.csv", "Gyroscope.csv", "Location.csv")
_T = "time*1e-9"
_DEVIATION = f"where(horizontalAccuracy > 0, horizontalAccuracy/{RADIUS_68}, 0/0)"
_FIX = {
    **{"t": _T, "lat": "latitude", "lon": "longitude", "alt": "altitude"},
    **{"std_x": _DEVIATION, "std_y": _DEVIATION},
    "speed": "where(speed >= 0, speed, 0/0)",
    "course": "where(bearing >= 0, radians(90 - bearing), 0/0)",
}


def recognizes(path: Path) -> bool:
    """Return True if the app's files are in it."""
    names = names_in(path)
    return {"Gyroscope.csv", "Location.csv"} <= names and bool(
        names & {"Metadata.csv", "TotalAcceleration.csv", "Gravity.csv"}
    )


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open an export."""
    with unpacked(path, FILES, limits) as folder:
        log = phone_files(path, folder, Guess({}), FILES, limits)
        there = log.tables.keys()
        roles: dict[Role, tuple[Part, ...]] = {}
        notes = [FLAT]
        if "Gyroscope.csv" in there and (parts := _acceleration(log, notes)):
            rates = Part("Gyroscope.csv", {"t": _T, "gx": "y", "gy": "-x", "gz": "z"})
            roles["imu"] = (*parts, rates)
        if "Location.csv" in there:
            roles["gps"] = (Part("Location.csv", _FIX),)
        yield replace(log, guessed=Guess(roles, tuple(notes)))


def _acceleration(log: ColumnFiles, notes: list[str]) -> tuple[Part, ...]:
    """Specific force: with gravity as logged, or without it and gravity added (iOS has both with its own sign)."""
    there = log.tables.keys()
    if "TotalAcceleration.csv" in there:
        return (Part("TotalAcceleration.csv", {"t": _T, "ax": "y", "ay": "-x", "az": "z"}),)
    if not {"Accelerometer.csv", "Gravity.csv"} <= there:
        notes.append("Accelerometer.csv has no gravity in it, and Gravity.csv is missing: az left out")
        return (
            (Part("Accelerometer.csv", {"t": _T, "ax": "y", "ay": "-x"}),)
            if "Accelerometer.csv" in there
            else ()
        )
    z = pl.col("z").cast(pl.Float64, strict=False)
    down = collect(log.scans["Gravity.csv"].select(z.median()), log.path, "Gravity.csv").item()
    if down is None:
        raise InputError(f"{log.path / 'Gravity.csv'}: holds no numbers; export it again")
    sign = "-" if down < 0 else ""
    notes.append(
        f"gravity added to Accelerometer.csv{', both with their signs turned, as iOS has them' if sign else ''}"
    )
    gravity = {"t": _T, "+ax": f"{sign}y", "+ay": f"-{sign}x".replace("--", ""), "+az": f"{sign}z"}
    moved = {"t": _T, "ax": f"{sign}y", "ay": f"-{sign}x".replace("--", ""), "az": f"{sign}z"}
    return (Part("Accelerometer.csv", moved), Part("Gravity.csv", gravity))
