"""phyphox: an experiment exported as CSV, a folder or zip with Accelerometer.csv, Gyroscope.csv and Location.csv.

Column names carry their units: "Time (s)" since the start on one clock, "Acceleration x (m/s^2)" with gravity,
"Gyroscope x (rad/s)", "Latitude (°)", "Velocity (m/s)", "Direction (°)" from north. Android's axes on both systems.
"""

import re
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.phones import FLAT, RADIUS_68, names_in, phone_files, unpacked
from sigmaswarm.importing.source import Guess, Part, Role, Source, first_bytes

FILES = ("Accelerometer.csv", "Gyroscope.csv", "Location.csv")
_NAMES = {
    "Accelerometer.csv": {"t": r"time", **{i: rf"(?:acceleration )?{i}" for i in "xyz"}},
    "Gyroscope.csv": {"t": r"time", **{i: rf"(?:gyroscope )?{i}" for i in "xyz"}},
    "Location.csv": {
        **{"t": r"time", "lat": r"latitude", "lon": r"longitude", "alt": r"height|altitude"},
        **{"speed": r"velocity|speed", "course": r"direction", "accuracy": r"horizontal accuracy"},
    },
}


def recognizes(path: Path) -> bool:
    """Return True if phyphox's files are in it, and begin with its "Time (s)"."""
    begin = first_bytes(path / FILES[0], 100).decode("utf-8-sig", "replace").strip('" ').lower()
    return {"Accelerometer.csv", "Gyroscope.csv"} <= names_in(path) and (
        path.is_file() or begin.startswith("time (s)")
    )


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open an export."""
    with unpacked(path, FILES, limits) as folder:
        files = phone_files(path, folder, Guess({}), FILES, limits)
        roles: dict[Role, tuple[Part, ...]] = {}
        names = {table: _find(_NAMES[table], files.tables[table].columns) for table in files.tables}
        accelerometer, gyroscope = names.get(FILES[0], {}), names.get(FILES[1], {})
        if {"t", "x", "y", "z"} <= accelerometer.keys() & gyroscope.keys():
            a, w = accelerometer, gyroscope
            acceleration = Part(FILES[0], {"t": a["t"], "ax": a["y"], "ay": f"-{a['x']}", "az": a["z"]})
            rates = Part(FILES[1], {"t": w["t"], "gx": w["y"], "gy": f"-{w['x']}", "gz": w["z"]})
            roles["imu"] = (acceleration, rates)
        if (place := names.get(FILES[2], {})).keys() >= {"t", "lat", "lon"}:
            roles["gps"] = (Part(FILES[2], _fix(place)),)
        yield replace(files, guessed=Guess(roles, (FLAT,)))


def _find(wanted: dict[str, str], columns: Sequence[str]) -> dict[str, str]:
    """Columns by quantity, between backticks; the unit in brackets does not count."""
    plain = {column: re.sub(r"\s*\(.*\)\s*$", "", column).strip().lower() for column in columns}
    found: dict[str, str] = {}
    for what, pattern in wanted.items():
        for column, name in plain.items():
            if what not in found and re.fullmatch(pattern, name):
                found[what] = f"`{column}`"
    return found


def _fix(place: dict[str, str]) -> dict[str, str]:
    columns = {name: place[name] for name in ("t", "lat", "lon", "alt", "speed") if name in place}
    if "course" in place:
        columns["course"] = f"radians(90 - {place['course']})"
    if "accuracy" in place:
        columns["std_x"] = columns["std_y"] = f"{place['accuracy']}/{RADIUS_68}"
    return columns
