"""phyphox: an experiment exported as CSV, a folder or zip with tables of accelerometer, gyroscope and location.

Names of files and columns are in the language of the phone, so the tables are found by the units in their columns, in
the order of the app (phyphox/phyphox-experiments): "Time (s)" since the start on one clock, "Acceleration x (m/s^2)"
with gravity, "Gyroscope x (rad/s)", "Latitude (°)", "Longitude (°)", "Height (m)", "Velocity (m/s)", "Direction (°)"
from north, "Horizontal Accuracy (m)". Android's axes on both systems.
"""

import re
from contextlib import ExitStack
from pathlib import Path

import polars as pl

from sigmaswarm.importing.readers.phones import FLAT, RADIUS_68, names_in, phone_files
from sigmaswarm.importing.source import Guess, Limits, Log, Role, first_bytes, roles_of
from sigmaswarm.importing.times import median_of, written

FILES = ("Accelerometer.csv", "Gyroscope.csv", "Location.csv")
_PLACE = ["s", "°", "°", "m", "m/s", "°"]
"""Units of the first columns of the location: time, latitude, longitude, height, velocity, direction."""
_META = {"time.csv", "device.csv"}
LEAST_GRAVITY = 5.0
"""Smallest median of an acceleration with gravity, m/s2; the linear acceleration has the same columns."""


def recognizes(path: Path) -> bool:
    """Return True for a zip or folder with phyphox's files; those in a folder begin with "Time (s)"."""
    names = names_in(path)
    if path.is_file():
        return {*FILES[:2]} <= names or names >= _META
    begin = first_bytes(path / FILES[0], 100).decode("utf-8-sig", "replace").strip('" ').lower()
    named = {*FILES[:2]} <= names and begin.startswith("time (s)")
    return named or all((path / "meta" / name).is_file() for name in _META)


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    """Open an export."""
    names = names_in(path)
    wanted = [n for n in FILES if n in names] if {*FILES[:2]} <= names else sorted(names)
    log = phone_files(path, [name for name in wanted if name.endswith(".csv")], limits, stack)
    found: dict[str, tuple[Role, str, dict[str, str]]] = {}
    for table, columns in ((name, its.columns) for name, its in log.tables.items()):
        units = [u[1].replace("²", "^2") if (u := re.search(r"\(([^()]*)\)$", c)) else "" for c in columns]
        t, *rest = map(written, columns)
        for letter, unit in (("a", "m/s^2"), ("g", "rad/s")):
            axes = {
                c.lower().split("(")[0].split()[-1]: c
                for c, u in zip(columns, units, strict=True)
                if u == unit
            }
            if axes.keys() >= {*"xyz"} and (letter == "g" or _has_gravity(log, table, axes)):
                x, y, z = (written(axes[i]) for i in "xyz")
                rotated = {"t": t, f"{letter}x": y, f"{letter}y": f"-{x}", f"{letter}z": z}
                found.setdefault(letter, ("imu", table, rotated))
        if units[:3] == _PLACE[:3]:
            place = {"t": t, "lat": rest[0], "lon": rest[1]}
            if units[: len(_PLACE)] == _PLACE:
                place |= {"alt": rest[2], "speed": rest[3], "course": f"radians(90 - {rest[4]})"}
                radius = [r for r, unit in zip(rest[5:], units[6:], strict=True) if unit == "m"]
                place |= dict.fromkeys(("std_x", "std_y"), f"{radius[0]}/{RADIUS_68}") if radius else {}
            found.setdefault("place", ("gps", table, place))
    parts = [part for name, part in found.items() if name == "place" or {"a", "g"} <= found.keys()]
    tables = {name: its.columns for name, its in log.tables.items()}
    return log.guessed(Guess(roles_of(parts, tables), (FLAT,)))


def _has_gravity(log: Log, table: str, axes: dict[str, str]) -> bool:
    """Return True if the first rows of an acceleration contain gravity."""
    for _, rows, _ in log.batches({table: [axes[i] for i in "xyz"]}):
        squares = [rows[axes[i]].cast(pl.Float64, strict=False) ** 2 for i in "xyz"]
        return median_of((squares[0] + squares[1] + squares[2]).sqrt()) > LEAST_GRAVITY
    return False
