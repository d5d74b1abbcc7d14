"""Sensor Logger (iOS, Android): a folder or zip with Accelerometer.csv, Gyroscope.csv, Location.csv and others.

UNITS.md and COORDINATES.md in tszheichoi/awesome-sensor-logger define units and axes. ``time`` is in ns since 1970.
Accelerometer does not contain gravity, which is in a separate file, Gravity; on iOS the signs in both are reversed. On
Android TotalAcceleration contains gravity. Bearings are in degrees from north. Negative speeds, bearings and
accuracies are invalid.
"""

from contextlib import ExitStack
from pathlib import Path

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.positions import FLAT_NOTE, RADIUS_68
from sigmaswarm.importing.readers.columns import log_of_names, names_in
from sigmaswarm.importing.source import Guess, Limits, Log, Role, roles_of

FILES = ("TotalAcceleration.csv", "Accelerometer.csv", "Gravity.csv", "Gyroscope.csv", "Location.csv")
_TOTAL, _MOVED, _GRAVITY, _RATES, _PLACES = FILES
_T = {"t": "time*1e-9"}
_DEVIATION = f"where(horizontalAccuracy > 0, horizontalAccuracy/{RADIUS_68}, 0/0)"
_FIX: dict[str, str | tuple[str, ...]] = {
    **{"lat": "latitude", "lon": "longitude", "alt": ("altitude",)},
    **{"std_x": (_DEVIATION,), "std_y": (_DEVIATION,)},
    "speed": ("where(speed >= 0, speed, 0/0)",),
    "course": ("where(bearing >= 0, radians(90 - bearing), 0/0)",),
}


def recognizes(path: Path) -> bool:
    names = names_in(path)
    return {_RATES, _PLACES} <= names and bool(names & {"Metadata.csv", _TOTAL, _GRAVITY})


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    log = log_of_names(path, FILES, limits, stack, Guess({}))
    notes: list[str] = []
    parts: list[tuple[Role, str, dict[str, str | tuple[str, ...]]]] = [("gps", _PLACES, {**_T, **_FIX})]
    if _RATES in log.tables and (acceleration := _acceleration(log, notes)):
        imu = {**acceleration, _RATES: {"gx": "y", "gy": "-x", "gz": "z"}}
        parts.extend(("imu", table, {**_T, **columns}) for table, columns in imu.items())
    roles = roles_of(parts, {name: table.columns for name, table in log.tables.items()})
    return log.guessed(Guess(roles, tuple(notes), flat=FLAT_NOTE))


def _acceleration(log: Log, notes: list[str]) -> dict[str, dict[str, str]]:
    """Find the specific force: TotalAcceleration, or the sum of Accelerometer and Gravity."""
    if _TOTAL in log.tables:
        return {_TOTAL: {"ax": "y", "ay": "-x", "az": "z"}}
    if not {_MOVED, _GRAVITY} <= log.tables.keys():
        notes.append(
            "Accelerometer.csv does not contain gravity, and Gravity.csv is missing, so az is left out"
        )
        return {_MOVED: {"ax": "y", "ay": "-x"}} if _MOVED in log.tables else {}
    z = [rows["z"].cast(pl.Float64, strict=False) for _, rows, _ in log.batches({_GRAVITY: ["z"]})]
    down = pl.concat(z).median() if z else None
    if not isinstance(down, float):
        raise InputError(f"{log.path / _GRAVITY}: contains no numbers; export it again")
    turned = "; their signs are reversed, as on iOS" if down < 0 else ""
    notes.append(f"the values of Gravity.csv and Accelerometer.csv are summed{turned}")
    axes = {"ax": "-y", "ay": "x", "az": "-z"} if down < 0 else {"ax": "y", "ay": "-x", "az": "z"}
    return {_MOVED: axes, _GRAVITY: {f"+{name}": text for name, text in axes.items()}}
