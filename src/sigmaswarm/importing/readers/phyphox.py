"""phyphox: an experiment exported as CSV, a folder or zip with Accelerometer.csv, Gyroscope.csv and Location.csv.

Column names carry their units: "Time (s)" since the start on one clock, "Acceleration x (m/s^2)" with gravity,
"Gyroscope x (rad/s)", "Latitude (°)", "Velocity (m/s)", "Direction (°)" from north. Android's axes on both systems.
"""

import re
from contextlib import ExitStack
from pathlib import Path

from sigmaswarm.importing.readers.phones import FLAT, RADIUS_68, names_in, phone_files
from sigmaswarm.importing.source import Guess, Limits, Log, Part, Role, first_bytes

FILES = ("Accelerometer.csv", "Gyroscope.csv", "Location.csv")
_AXES = {"t": "time", "x": "x", "y": "y", "z": "z"}
_PLAIN = r"\s*\(.*\)\s*$|^(?:acceleration|gyroscope) (?=[xyz])"
_COLUMNS: tuple[tuple[Role, str, dict[str, str], dict[str, str]], ...] = (
    ("imu", FILES[0], _AXES, {"t": "{t}", "ax": "{y}", "ay": "-{x}", "az": "{z}"}),
    ("imu", FILES[1], _AXES, {"t": "{t}", "gx": "{y}", "gy": "-{x}", "gz": "{z}"}),
    (
        "gps",
        FILES[2],
        {
            **{"t": "time", "lat": "latitude", "lon": "longitude", "alt": "height|altitude"},
            **{"speed": "velocity|speed", "course": "direction", "accuracy": "horizontal accuracy"},
        },
        {
            **{name: f"{{{name}}}" for name in ("t", "lat", "lon", "alt", "speed")},
            **{"course": "radians(90 - {course})"},
            **dict.fromkeys(("std_x", "std_y"), f"{{accuracy}}/{RADIUS_68}"),
        },
    ),
)
"""The plain names of columns, and the expressions over them, by role and file."""
_REQUIRED = {"imu": {"t", "x", "y", "z"}, "gps": {"t", "lat", "lon"}}


def recognizes(path: Path) -> bool:
    """Return True for a zip or folder with phyphox's files; those in a folder begin with "Time (s)"."""
    begin = first_bytes(path / FILES[0], 100).decode("utf-8-sig", "replace").strip('" ').lower()
    there = {"Accelerometer.csv", "Gyroscope.csv"} <= names_in(path)
    return there and (path.is_file() or begin.startswith("time (s)"))


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    """Open an export."""
    log = phone_files(path, FILES, limits, stack)
    roles: dict[Role, tuple[Part, ...]] = {}
    for role, table, wanted, expressions in _COLUMNS:
        found: dict[str, str] = {}
        for column in log.tables[table].columns if table in log.tables else ():
            plain = re.sub(_PLAIN, "", column.strip().lower()).strip()
            for what, pattern in wanted.items():
                if re.fullmatch(pattern, plain):
                    found.setdefault(what, f"`{column}`")
        if found.keys() >= _REQUIRED[role]:
            fitting = {
                n: e for n, e in expressions.items() if set(re.findall(r"\{(\w+)\}", e)) <= found.keys()
            }
            part = Part(table, {name: text.format(**found) for name, text in fitting.items()})
            roles[role] = (*roles.get(role, ()), part)
    if len(roles.get("imu", ())) < 2:
        roles.pop("imu", None)
    return log.guessed(Guess(roles, (FLAT,)))
