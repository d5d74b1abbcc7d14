"""An experiment exported from phyphox as CSV: a folder or zip with Accelerometer.csv, Gyroscope.csv and Location.csv.

Column names contain units: "Time (s)" since the start of the experiment (the same clock in all files), "Acceleration x
(m/s^2)" with gravity, "Gyroscope x (rad/s)", "Latitude (°)", "Velocity (m/s)", "Direction (°)" clockwise from north.
The axes are Android's, also on iOS. Exports in other languages are identified by the units of columns in the app's
order (phyphox/phyphox-experiments).
"""

import re
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import polars as pl

from sigmaswarm.importing.positions import FLAT_NOTE, RADIUS_68
from sigmaswarm.importing.readers.columns import log_of_names, names_in
from sigmaswarm.importing.source import Guess, Limits, Log, Part, Role, first_bytes
from sigmaswarm.importing.table_columns import median_of

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
_REQUIRED = {"imu": {"t", "x", "y", "z"}, "gps": {"t", "lat", "lon"}}
# Columns and units of a table of positions, in the app's order
_PLACE = {"time": "s", "latitude": "°", "longitude": "°", "height": "m", "velocity": "m/s", "direction": "°"}
_META = {"time.csv", "device.csv"}
# m/s2, smallest median magnitude of an acceleration with gravity; the table of linear acceleration has the same columns
MIN_GRAVITY = 5.0


def recognizes(path: Path) -> bool:
    """Return True for a zip or folder with phyphox's files. In a folder, the tables' headers must also fit."""
    names = names_in(path)
    english = {*FILES[:2]} <= names
    if path.is_file():
        return english or names >= _META
    if english:
        return _header(path / FILES[0]).lower().startswith("time (s)")
    meta = all((path / "meta" / name).is_file() for name in _META)
    tables = (_header(file) for file in path.glob("*.csv")) if meta else ()
    return any(_is_place(re.split('[,;\t]"?', header)) for header in tables)


def _header(file: Path) -> str:
    return first_bytes(file, 1000).decode("utf-8-sig", "replace").strip('" ').partition("\n")[0]


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    names = names_in(path)
    english = {*FILES[:2]} <= names
    files = FILES if english else sorted(n for n in names if n.endswith(".csv"))
    log = log_of_names(path, files, limits, stack, Guess({}))
    if english:
        tables = {
            file: (file, {re.sub(_PLAIN, "", c.strip().lower()).strip(): c for c in log.tables[file].columns})
            for file in FILES
            if file in log.tables
        }
    else:
        tables = _by_units(log)
    roles: dict[Role, tuple[Part, ...]] = {}
    for role, file, wanted, expressions in _COLUMNS:
        table, columns = tables.get(file, ("", {}))
        found: dict[str, str] = {}
        for plain, column in columns.items():
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
    return log.guessed(Guess(roles, flat=FLAT_NOTE))


def _unit(column: str) -> str:
    found = re.search(r"\(([^()]*)\)\W*$", column)
    return found[1].replace("²", "^2") if found else ""


def _is_place(columns: Sequence[str]) -> bool:
    return [_unit(c) for c in columns[: len(_PLACE)]] == [*_PLACE.values()]


def _by_units(log: Log) -> dict[str, tuple[str, dict[str, str]]]:
    """Find the tables of an export in another language by the units of their columns.

    Return a dict from the English file name (one of `FILES`) to the table's name and its columns by English name.
    """
    found: dict[str, tuple[str, dict[str, str]]] = {}
    for table, columns in ((name, about.columns) for name, about in log.tables.items()):
        for file, unit in zip(FILES[:2], ("m/s^2", "rad/s"), strict=True):
            axes = {c.lower().split("(")[0].split()[-1]: c for c in columns if _unit(c) == unit}
            if axes.keys() >= {*"xyz"} and (file == FILES[1] or _has_gravity(log, table, axes)):
                found.setdefault(file, (table, {"time": columns[0], **axes}))
        if _is_place(columns):
            names = (*_PLACE, "horizontal accuracy")
            found.setdefault(FILES[2], (table, dict(zip(names, columns, strict=False))))
    return found


def _has_gravity(log: Log, table: str, axes: dict[str, str]) -> bool:
    for _, rows, _ in log.batches({table: [axes[i] for i in "xyz"]}):
        squares = [rows[axes[i]].cast(pl.Float64, strict=False) ** 2 for i in "xyz"]
        return median_of((squares[0] + squares[1] + squares[2]).sqrt()) > MIN_GRAVITY
    return False
