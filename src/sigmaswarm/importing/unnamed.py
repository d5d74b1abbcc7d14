"""Recognize columns without names by their values: time, specific force, angular rates, latitude and longitude."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, pairwise

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.importing.dates import SECOND
from sigmaswarm.importing.expressions import time_expression
from sigmaswarm.importing.names import read_name, read_names
from sigmaswarm.importing.quantities import MAX_QUARTILE_RATIO, PER_G, RATE
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.table_columns import AXES, median_of, quoted_column
from sigmaswarm.importing.time_units import column_time, date_time, step_of
from sigmaswarm.importing.times import time_of
from sigmaswarm.importing.units import G, in_si

UNNAMED = re.compile(r"(?:c|v|val|values?|data|d|ch|field|.*_)\d+|.*\[\d+\]", re.IGNORECASE)
TIMES = ("received", "stamp")  # columns with the times of messages
CLOCK = re.compile(r"t_?[a-z]{0,4}|time.*", re.IGNORECASE)  # names of times next to a matrix
POSITIONS = re.compile(
    r"(?:gps|gnss|fix|pos|utm|enu|xy)[a-z]*_\d", re.IGNORECASE
)  # columns of a matrix of positions
# Magnitudes of gravity in the order of trial; 1 comes last, since a quaternion has the same magnitude
GRAVITY = (G, *PER_G, 1.0)
TOLERANCE = 0.05  # largest relative deviation of the median specific force from gravity
MIN_SPREAD = 1e-3  # smallest relative spread of the specific force; a quaternion's magnitude is constant
DATE_AND_CLOCK = r"^\d+[-/.]\d+[-/.]\d+$", r"^\d+:\d+:\d+"  # forms of day and time of day in two columns
_OF_AXES = ("acceleration", "rate")  # dimensions of the columns of an IMU
MIN_TURN_RATIO = 2.0  # smallest ratio of the 95% to the 25% quantile of angular rates
MIN_FALLS = 0.9  # smallest share of new seconds at which a fraction falls; after a gap it may rise
MAX_DEGREE_STEP = 1e-3  # deg, largest median step of latitude and longitude
MAX_DEGREES = 2.0  # largest range of latitude and longitude in a log


def columns_by_values(frame: pl.DataFrame, role: Role) -> dict[str, str]:
    """Return the expressions of a role's columns in a table with numbers or letters as column names; {} if unclear."""
    if role == "imu" and (found := _letters(frame)):
        return found
    names = [name for name in frame.columns if UNNAMED.fullmatch(name)]
    others = [name for name in frame.columns if name not in (*names, *TIMES) and "." not in name]
    others = [name for name in others if frame.schema[name] != pl.String or frame[name].n_unique() > 1]
    if len(frame) < 2 or any(not CLOCK.fullmatch(name) for name in others):
        return {}
    values = {name: frame[name].cast(pl.Float64, strict=False).to_numpy() for name in names}
    axes = _axes(values)
    place = (_place(values) or _meters(values)) if role == "gps" else axes if "gx" in axes else {}
    # in a table with an IMU, the IMU's rate determines the unit of the times
    time = next(_times(frame, "imu" if "gx" in axes else role, _summed(values)), "")
    per_step = ""
    if role == "imu" and time and not place:
        clock = frame.select(time_expression(time, frame).alias("t"))["t"]
        place = _axes(values, [G * step_of(clock) / SECOND])  # increments of velocity and angle
        place, per_step = (place, f"*{RATE}") if "gx" in place else ({}, "")
    texts = {what: quoted_column(name) + per_step for what, name in place.items()}
    return texts if role == "imu" and not time else {"t": time, **texts} if place and time else {}


def columns_by_units(frame: pl.DataFrame, role: Role) -> dict[str, str]:
    """Return the columns of a role in a table whose names state only units: three accelerations and three rates."""
    units = {name.column: name.unit for name in read_names(frame.columns) if name.unit is not None}
    kinds = {dimension: [n for n, u in units.items() if u.dimension == dimension] for dimension in _OF_AXES}
    if role == "gps":
        names = [n for n, u in units.items() if u.dimension == "angle" and frame.schema[n].is_numeric()]
        angles = {n: frame[n].cast(pl.Float64).to_numpy() for n in names}
        return {what: quoted_column(name) for what, name in _place(angles).items()}
    if any(len(names) != 3 for names in kinds.values()):
        return {}
    return dict(zip(AXES, map(quoted_column, chain(*kinds.values())), strict=True))


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


def _times(frame: pl.DataFrame, role: Role, summed: Mapping[str, str]) -> Iterator[str]:
    """Yield time expressions in table order: texts, increasing columns and sums of columns; row numbers come last."""
    found: list[tuple[bool, str]] = []
    texts = {name: frame[name].drop_nulls() for name in frame.columns if frame.schema[name] == pl.String}
    for day, clock in pairwise(frame.columns):
        pair = [texts.get(name, pl.Series([], dtype=pl.String)) for name in (day, clock)]
        if all(len(v) and v.str.contains(form).all() for v, form in zip(pair, DATE_AND_CLOCK, strict=True)):
            yield date_time([day, clock], frame).expression
    for name in frame.columns:
        if name in summed:
            found.append((False, summed[name]))
            continue
        time = column_time(read_name(name), frame, role)
        numbers = frame[name].cast(pl.Float64, strict=False)
        steps = numbers.diff().drop_nulls()
        rises = len(steps) > 0 and (steps >= 0).all() and median_of(steps) > 0
        # numbers may be read as texts
        is_text = frame.schema[name] == pl.String and numbers.count() < 0.5 * len(frame)
        if time.expression and (rises or is_text):
            found.append((bool(rises and (steps == 1).all()), time.expression))
    yield from (text for _, text in sorted(found, key=lambda pair: pair[0]))


def _summed(values: dict[str, Array]) -> dict[str, str]:
    """Return, by column, the sum of whole seconds and their fractions in the next column, perhaps with a GPS week."""
    names = [*values]
    for week, name, rest in zip(["", *names], names, names[1:], strict=False):
        whole, seconds = values[name], quoted_column(name)
        if len(whole) < 3 or not np.ptp(whole):
            continue
        weekly = (
            week and not np.ptp(values[week]) and 1000 < values[week][0] < 5000 and whole.max() <= 604_800
        )
        if np.all(whole == np.round(whole)) and _are_fractions(whole, values[rest]):
            seconds = f"{seconds} + {quoted_column(rest)}"
        elif not weekly or not np.all(np.diff(whole) > 0):
            continue
        return {name: f"gps_time({quoted_column(week)}, {seconds})" if weekly else seconds}
    return {}


def _meters(values: dict[str, Array]) -> dict[str, str]:
    """Return the first two columns of a matrix of positions that has no time before them; {} for degrees."""
    names = [name for name in values if POSITIONS.fullmatch(name)]
    if names and np.all(np.diff(values[names[0]]) > 0) and len(names) > 2:
        names = names[1:]
    if not 2 <= len(names) <= 3 or len({name.rpartition("_")[0] for name in names}) > 1:
        return {}
    far = all(np.nanmedian(np.abs(np.diff(values[n]))) > MAX_DEGREE_STEP for n in names[:2])
    return dict(zip("xy", names, strict=False)) if far else {}


def _are_fractions(whole: Array, part: Array) -> bool:
    """Return True if ``part`` contains the fractions of the times whose whole seconds are ``whole``.

    Fractions are in [0, 1), rise within a second, and fall at the next second. They may also rise if one of the two
    seconds has only one row. The steps of ``whole + part`` must be more even than those of ``whole``.
    """
    if not np.all((part >= 0) & (part < 1)):
        return False
    within, steps = np.diff(whole) == 0, np.diff(whole + part)
    alone = np.diff(np.concatenate([[0], np.flatnonzero(~within) + 1, [len(whole)]])) == 1
    falls = (np.diff(part) < 0)[~within][~(alone[1:] | alone[:-1])]
    uneven = [float(np.mean(np.abs(v - np.median(v)))) for v in (steps, np.diff(whole))]
    rises = within.any() and np.all(steps > 0)
    return bool(rises and uneven[0] < uneven[1] and (not len(falls) or np.mean(falls) >= MIN_FALLS))


def header_by_values(frame: pl.DataFrame) -> str:
    """Return a header for a table without names: t, and the axes of one sensor or a position.

    Return "" if it has neither.
    """
    values = {
        n: frame[n].cast(pl.Float64, strict=False).to_numpy() for n in frame.columns if UNNAMED.fullmatch(n)
    }
    if len(frame) < 2 or len(values) < len(frame.columns):
        return ""
    axes, order = _axes(values), [*values]
    if "gx" in axes and abs(order.index(axes["gx"]) - order.index(axes["ax"])) != 3:
        axes = {what: axes[what] for what in AXES[:3]}  # other columns may also be angles
    found = axes if "gx" in axes else _place(values) or axes
    time = next(_times(frame, "gps" if "lat" in found else "imu", {}), "")
    clock = next((n for n in values if re.search(rf"\b{n}\b", time)), "")
    # other columns than clocks and constants
    rest = [n for n, v in values.items() if np.isfinite(v).all() and (np.diff(v) < 0).any() and n != clock]
    if not found and len(rest) == 3 and _turns(values, rest):
        found = dict(zip(AXES[3:], rest, strict=True))
    given = {clock: "t"} | {name: what for what, name in found.items()}
    return ",".join(given.get(name, name) for name in values) if found and clock else ""


def _axes(values: dict[str, Array], gravity: Sequence[float] = GRAVITY) -> dict[str, str]:
    """Find three columns whose magnitude is gravity, and the rates in three other columns if there are any."""
    place = _place(values).values()  # with an altitude, their magnitude is about constant
    names = [name for name, column in values.items() if np.isfinite(column).any() and name not in place]
    names = [name for name in names if not np.all(np.diff(values[name]) > 0)]  # without times
    # a constant whole number is a flag
    names = [n for n in names if np.ptp(v := values[n]) or not v[0] or v[0] % 1]
    for k in _forces(values, names, gravity):
        return dict(zip(AXES, [*names[k : k + 3], *_rates(values, names, k)], strict=False))
    return {}


def _forces(values: dict[str, Array], names: Sequence[str], units: Sequence[float]) -> Iterator[int]:
    """Yield the index of the first of three columns whose magnitude is gravity in one of the units."""
    for gravity in units:
        for k in range(len(names) - 2):
            size = np.sqrt(sum(values[n] ** 2 for n in names[k : k + 3]))
            if not np.isfinite(size).any():
                continue
            low, middle, high = np.nanquantile(size, (0.25, 0.5, 0.75))
            fits = abs(middle / gravity - 1) <= TOLERANCE
            if fits and MIN_SPREAD < high / low - 1 < MAX_QUARTILE_RATIO - 1:
                yield k


def _rates(values: dict[str, Array], names: Sequence[str], k: int) -> Sequence[str]:
    """Return the columns of the rates, preferably next to those of the specific force, which begin at index ``k``."""
    triples = {i: names[i : i + 3] for i in range(len(names) - 2) if abs(i - k) >= 3}
    turning = {i: triple for i, triple in triples.items() if _turns(values, triple)}
    order = {i: (abs(i - k) != 3, _median_ratio(values, triple)) for i, triple in turning.items()}
    return turning[min(order, key=order.__getitem__)] if order else ()


def _turns(values: dict[str, Array], names: Sequence[str]) -> bool:
    """Return True if the magnitude of three columns varies, unlike that of a magnetic field or of a position."""
    size = np.sqrt(sum(values[n] ** 2 for n in names))
    low, high = np.nanquantile(size, (0.25, 0.75))
    return float(np.nanquantile(size, 0.95)) > MIN_TURN_RATIO * max(low, 1e-12) and high > 0


def _median_ratio(values: dict[str, Array], names: Sequence[str]) -> float:
    """Return the largest ratio of a column's median to its standard deviation, which is small for rates."""
    spread = [float(np.nanstd(values[n])) for n in names]
    return max(
        abs(float(np.nanmedian(values[n]))) / max(s, 1e-12) for n, s in zip(names, spread, strict=True)
    )


def _place(values: dict[str, Array]) -> dict[str, str]:
    """Find latitude and longitude in two columns. A column of a quiet accelerometer may look like one of them."""
    names = [*values]
    forces = [{*names[k : k + 3]} for k in _forces(values, names, (G,))]
    for lat, lon in pairwise(values):
        both = [values[n][np.isfinite(values[n]) & (values[n] != 0)] for n in (lat, lon)]
        if min(map(len, both)) < 2 or np.max(np.abs(both[0])) > 90 or np.max(np.abs(both[1])) > 180:
            continue
        if any(len(axes & {lat, lon}) == 1 for axes in forces):
            continue
        if all(0 < np.ptp(v) < MAX_DEGREES < np.min(np.abs(v)) and (v * 1e3 % 1).any() for v in both):
            return {"lat": lat, "lon": lon}
    return {}
