"""Recognize columns without names by their values: time, specific force, angular rates, latitude and longitude."""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.importing.names import read_name, read_names
from sigmaswarm.importing.quantities import MAX_QUARTILE_RATIO, PER_G
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.times import column_time, date_time, median_of, quoted_column, time_of
from sigmaswarm.importing.units import G, in_si

UNNAMED = re.compile(r"(?:c|.*_)\d+|.*\[\d+\]")
TIMES = ("received", "stamp")  # of a message
# Magnitudes of gravity in the order of trial; 1 comes last, since a quaternion has the same magnitude
GRAVITY = (G, *PER_G, 1.0)
TOLERANCE = 0.05  # relative deviation of the median specific force from gravity
MIN_SPREAD = 1e-3  # smallest relative spread of the specific force; a quaternion's magnitude is constant
DATE_AND_CLOCK = r"^\d+[-/.]\d+[-/.]\d+$", r"^\d+:\d+:\d+"  # in two columns
MAX_DEGREES = 2.0  # largest range of latitude and longitude in a log


def columns_by_values(frame: pl.DataFrame, role: Role) -> dict[str, str]:
    """Return the expressions of a role's columns in a table with numbers or letters as names; {} if unclear."""
    if role == "imu" and (found := _letters(frame)):
        return found
    names = [name for name in frame.columns if UNNAMED.fullmatch(name)]
    if len(frame) < 2 or any(name not in (*names, *TIMES) and "." not in name for name in frame.columns):
        return {}
    values = {name: frame[name].cast(pl.Float64, strict=False).to_numpy() for name in names}
    place = _place(values) if role == "gps" else _axes(values)
    time = next(_times(frame, role), "")
    return (
        {"t": time, **{what: quoted_column(name) for what, name in place.items()}} if place and time else {}
    )


def _letters(frame: pl.DataFrame) -> dict[str, str]:
    """Read x, y, z as the specific force if their magnitude is gravity and the table also has three rates."""
    letters = {name.plain: name for name in read_names(frame.columns)}
    forces = [letters[axis] for axis in "xyz" if axis in letters]
    named = {n.meaning: n for n in letters.values()}
    rates = [named[axis] for axis in ("gx", "gy", "gz") if axis in named]
    rates = rates or [letters[axis] for axis in "pqr" if axis in letters]
    time = time_of(frame) if len(frame) else None
    if len(forces) < 3 or len(rates) < 3 or time is None or {"ax", "ay"} <= named.keys():
        return {}
    values = {n.column: frame[n.column].cast(pl.Float64, strict=False).to_numpy() for n in (*forces, *rates)}
    units = {n.column: n.unit for n in rates}
    found = {what: (quoted_column(name), units.get(name)) for what, name in _axes(values).items()}
    texts = {what: in_si(unit, text) if unit and unit.known else text for what, (text, unit) in found.items()}
    return {"t": time, **texts} if texts else {}


def _times(frame: pl.DataFrame, role: Role) -> Iterator[str]:
    """Yield time expressions of increasing columns and of texts; row numbers come last."""
    found: list[tuple[bool, str]] = []
    texts = {name: frame[name].drop_nulls() for name in frame.columns if frame.schema[name] == pl.String}
    for day, clock in pairwise(frame.columns):
        pair = [texts.get(name, pl.Series([], dtype=pl.String)) for name in (day, clock)]
        if all(len(v) and v.str.contains(form).all() for v, form in zip(pair, DATE_AND_CLOCK, strict=True)):
            yield date_time([day, clock], frame).expression
    for name in frame.columns:
        time = column_time(read_name(name), frame, role)
        steps = frame[name].cast(pl.Float64, strict=False).diff().drop_nulls()
        rises = len(steps) > 0 and (steps >= 0).all() and median_of(steps) > 0
        if time.expression and (rises or frame.schema[name] == pl.String):
            found.append((bool(rises and (steps == 1).all()), time.expression))
    yield from (text for _, text in sorted(found, key=lambda pair: pair[0]))


def _axes(values: dict[str, Array]) -> dict[str, str]:
    """Find three columns whose magnitude is gravity, and the rates in the three columns before or after them."""
    names = [*values]
    for gravity in GRAVITY:
        for k in range(len(names) - 2):
            size = np.sqrt(sum(values[n] ** 2 for n in names[k : k + 3]))
            if not np.isfinite(size).any():
                continue
            low, middle, high = np.nanquantile(size, (0.25, 0.5, 0.75))
            fits = abs(middle / gravity - 1) <= TOLERANCE
            if not fits or not MIN_SPREAD < high / low - 1 < MAX_QUARTILE_RATIO - 1:
                continue
            near = [names[i : i + 3] for i in (k - 3, k + 3) if i >= 0]
            rates = min((b for b in near if len(b) == 3), key=lambda b: _median_ratio(values, b), default=[])
            found = zip(("ax", "ay", "az", "gx", "gy", "gz"), [*names[k : k + 3], *rates], strict=False)
            return dict(found) if rates else {}
    return {}


def _median_ratio(values: dict[str, Array], names: Sequence[str]) -> float:
    """Return the largest ratio of a column's median to its standard deviation; for rates this ratio is small."""
    spread = [float(np.nanstd(values[n])) for n in names]
    return max(
        abs(float(np.nanmedian(values[n]))) / max(s, 1e-12) for n, s in zip(names, spread, strict=True)
    )


def _place(values: dict[str, Array]) -> dict[str, str]:
    for lat, lon in pairwise(values):
        both = [values[n][np.isfinite(values[n]) & (values[n] != 0)] for n in (lat, lon)]
        if min(map(len, both)) < 2 or np.max(np.abs(both[0])) > 90 or np.max(np.abs(both[1])) > 180:
            continue
        if all(0 < np.ptp(v) < MAX_DEGREES < np.min(np.abs(v)) and (v * 1e3 % 1).any() for v in both):
            return {"lat": lat, "lon": lon}
    return {}
