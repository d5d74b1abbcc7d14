"""Convert columns to a drive's units, by the unit in the name or by the magnitude of the values."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import polars as pl

from sigmaswarm.importing.names import Name, plain_words, read_name
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.times import TimeExpression, column_numbers, median_of, quoted_column, unknown_unit
from sigmaswarm.importing.units import (
    COUNTS,
    UnitDimension,
    in_si,
    other_units,
    parse_unit,
    possible_units,
)
from sigmaswarm.wording import quoted

# Units of time in the names of latitude and longitude (min, s) mean arcminutes and arcseconds: number of these units
# per degree, by the factor of the unit to s
_ARCS = {60.0: "60", 1.0: "3600"}
# Texts for a missing number: without letters and digits (---.---), or written by a C library or a spreadsheet
NO_NUMBER = r"^[^0-9A-Za-z]*$|#(?:IND|QNAN|SNAN|INF|N/A|NUM!|VALUE!|DIV/0!)"
PLACEHOLDERS = (
    *(-999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, 1e10, -1e10),
    *(32767.0, -32768.0, 2147483647.0, -2147483648.0),
)
# Smallest magnitude of placeholders such as 1e38 and the largest numbers of 32 and 64 bits; measurements in any unit
# are smaller
MIN_HUGE = 1e15
NO_VALUE = ("", "nan", "null", "none", "na", "n/a", "-", "invalid", *("*" * n for n in range(1, 20)))
DIMENSIONS: dict[str, UnitDimension] = {
    **dict.fromkeys(("ax", "ay", "az"), "acceleration"),
    **dict.fromkeys(("gx", "gy", "gz"), "rate"),
    **dict.fromkeys(("lat", "lon", "course", "bearing", "theta", "std_heading"), "angle"),
    **dict.fromkeys(("alt", "x", "y", "std_x", "std_y"), "length"),
    **dict.fromkeys(("speed", "wheel_speed", "vx", "vy"), "speed"),
}
# Columns whose unknown unit is a fault; other columns with an unknown unit are left out
REQUIRED = ("ax", "ay", "az", "gx", "gy", "gz", "lat", "lon", "x", "y", "theta", "wheel_speed")
# Largest fraction of rows that may contradict the form of the other rows; such rows are presumably damaged
MAX_DAMAGED_SHARE = 0.02
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
MIDDLE_OF_MG_AND_GAL = 990.3  # between the values of gravity in cm/s2 (981) and in mg (1000)
MAX_NEAR_MIDDLE = 3.0  # if gravity is closer to this middle, the unit is unknown
# Largest ratio of the third to the first quartile of the magnitude of accelerations with gravity
MAX_QUARTILE_RATIO = 1.5
MAX_ACCELERATION = 100.0  # m/s2, largest acceleration of a car on a smooth road
MAX_RATE = 250.0  # deg/s, largest angular rate of a car
# m; a larger number is in another unit, and as m it would stretch the track by 0.14% or more
MAX_ALTITUDE = 9000.0
RADIUS = 6_378_137.0  # m, radius of Web Mercator's sphere
EDGE = 2.01e7  # m, coordinate at the edge of Web Mercator's map
# Units per g: counts of common sensors, then mg, cg, ug, mm/s2, cm/s2 and ft/s2
PER_G = (16384, 8192, 4096, 4000, 2048, 1024, 256, 1000, 100, 1e6, 9806.65, 980.665, 9.80665 / 0.3048)
_ACCELEROMETERS = (
    "common 16-bit sensors: 16384 counts per g at +-2 g, 8192 at +-4 g, 4096 at +-8 g, 2048 at +-16 g"
)
_GYROS = (
    "common 16-bit sensors: 131 counts per deg/s at +-250 deg/s, 65.5 at +-500 deg/s, 32.8 at +-1000 deg/s, "
    "16.4 at +-2000 deg/s; mrad/s: each column*1e-3; deg/s: radians(column)"
)


Numbers = TypeVar("Numbers", pl.Series, pl.Expr)


def is_placeholder(numbers: Numbers) -> Numbers:
    """Mark finite numbers (float64) that usually stand for a missing value."""
    return numbers.is_in(PLACEHOLDERS) | is_huge(numbers)


def is_huge(numbers: Numbers) -> Numbers:
    return numbers.abs().is_between(MIN_HUGE, math.inf, closed="left")


@dataclass
class Columns:
    frame: pl.DataFrame
    names: dict[str, Name] = field(default_factory=dict[str, Name])
    # expressions of latitude and longitude, deg, that are in several columns
    degrees: dict[str, str] = field(default_factory=dict[str, str])
    # Cached numbers and 99th percentiles of columns, since each axis of a sensor needs those of all axes
    _numbers: dict[str, pl.Series] = field(default_factory=dict[str, pl.Series], init=False)
    _largest: dict[str, float] = field(default_factory=dict[str, float], init=False)
    _wrapped: dict[str, bool] = field(default_factory=dict[str, bool], init=False)

    def __contains__(self, what: str) -> bool:
        return what in self.names

    def has(self, *whats: str) -> bool:
        return self.names.keys() >= set(whats)

    @property
    def located(self) -> bool:
        """True if the table has both coordinates of a position."""
        return self.has("lat", "lon") or self.has("x", "y")

    def numbers(self, what: str) -> pl.Series:
        """Return the numbers of a column, without placeholders."""
        column = self.names[what].column
        if column not in self._numbers:
            values = column_numbers(self._signed(what))
            self._numbers[column] = values.filter(~is_placeholder(values))
        return self._numbers[column]

    def largest(self, what: str) -> float:
        """Return the 99th percentile of a column's absolute values."""
        column = self.names[what].column
        if column not in self._largest:
            self._largest[column] = float(self.numbers(what).abs().quantile(0.99) or 0.0)
        return self._largest[column]

    def norms(self, axes: Sequence[str]) -> pl.Series:
        """Return the magnitudes of a vector, without placeholders and zeros; empty for fewer than three columns."""
        series = [self._signed(a) for a in axes]
        if len(axes) < 3 or any(s.dtype.is_nested() for s in series):
            return pl.Series([], dtype=pl.Float64)
        known = [s.cast(pl.Float64, strict=False) for s in series]
        squares = [s.set(is_placeholder(s), None).pow(2) for s in known]
        sizes = sum(squares[1:], squares[0]).sqrt()
        return sizes.filter(sizes > 0)

    def has_unit(self, what: str) -> bool:
        unit = self.names[what].unit
        return unit is not None and unit.dimension == DIMENSIONS[what]

    def text(self, what: str) -> str:
        text = quoted_column(self.names[what].column)
        return f"where({text} > 32767, {text} - 65536, {text})" if self._is_unsigned(what) else text

    def _is_unsigned(self, what: str) -> bool:
        """Return True for signed 16-bit words that were written without a sign: -1 is 65535.

        One axis with values around 0 decides for all axes of a sensor; an axis along gravity has no values around 0.
        """
        if what not in AXES or not self._is_word(what):
            return False
        axes = [a for a in AXES if a[0] == what[0] and a in self and self._is_word(a)]
        return any(map(self._wraps, axes))

    def _is_word(self, what: str) -> bool:
        values = self.frame[self.names[what].column]
        if not values.dtype.is_integer():
            return False
        low, high = (float(values.quantile(q) or 0.0) for q in (0.0, 1.0))
        return low >= 0 and high < 65_536

    def _wraps(self, what: str) -> bool:
        """Return True for a column with numbers near 65536, and few numbers around 32768."""
        column = self.names[what].column
        if column not in self._wrapped:
            values = self.frame[column]
            middle = float(values.is_between(23_000, 42_000).mean() or 0)  # pyright: ignore[reportArgumentType]
            high = float(values.quantile(1.0) or 0.0)
            self._wrapped[column] = high > 59_000 and middle < MAX_DAMAGED_SHARE
        return self._wrapped[column]

    def _signed(self, what: str) -> pl.Series:
        values = self.frame[self.names[what].column]
        return (values.cast(pl.Int64) + 32_768) % 65_536 - 32_768 if self._is_unsigned(what) else values


def quantity(columns: Columns, what: str, role: Role) -> TimeExpression:
    name, text, dimension = columns.names[what], columns.text(what), DIMENSIONS[what]
    if name.unit is None and what == "alt" and columns.largest(what) > MAX_ALTITUDE:
        seen = f"{name.column} is left out, since {columns.largest(what):.6g} is not an altitude in m"
        example = _maps(columns, role, ["alt"], "{}*1e-3")
        return TimeExpression(
            "", note=f"{seen}; map the column: {example} if it is in mm, *1e-2 if it is in cm"
        )
    if name.unit is None:
        if dimension in ("acceleration", "rate"):
            return _without_unit(columns, what, role)
        note = _web_mercator(columns, role) if what == "y" else ""
        if what == "speed" and read_name(name.column).meaning is None:  # in another language
            other = _maps(columns, role, ["speed"], "{}/3.6")
            note = f"{text} is read as m/s; if it is in km/h, write {other}"
        return TimeExpression(text, note)
    if name.unit.dimension == dimension:
        return TimeExpression(in_si(name.unit, text))
    if name.unit.text.strip().lower() in COUNTS and dimension in ("acceleration", "rate"):
        return TimeExpression("", fault=_raw_counts(columns, what, role))
    likely = ""
    if dimension == "acceleration":  # gravity shows the unit
        bare = {w: replace(n, unit=None) if n.unit == name.unit else n for w, n in columns.names.items()}
        likely = _without_unit(replace(columns, names=bare), what, role).expression
    sentence = unknown_unit(name, what, dimension, role, likely)
    return (
        TimeExpression("", fault=sentence)
        if what in REQUIRED
        else TimeExpression("", note=f"{sentence}; this column is left out")
    )


def gravity_columns(names: Sequence[str]) -> dict[str, str]:
    """Return the columns of gravity, which a phone may report in addition to acceleration; {} unless all exist."""
    found: dict[str, str] = {}
    for name in names:
        bare = "_".join([*plain_words(re.sub(r"(?<=[a-z])(?=[A-Z])|\W*[(\[].*", "_", name)), ""])
        if axis := re.fullmatch(r".*gra(?:v(?:ity)?)?_([xyz])_*", bare):
            found[f"a{axis[1]}"] = name
    return found if len(found) == 3 else {}


def with_gravity(columns: Columns) -> dict[str, dict[str, str]]:
    """Add the columns of gravity to accelerations without gravity; return expression and note by axis, or {}."""
    axes = AXES[:3]
    parts = {a: read_name(n) for a, n in gravity_columns(columns.frame.columns).items()}
    units = {n.unit for n in (*parts.values(), *(columns.names[a] for a in axes if a in columns))}
    if not parts or not columns.has(*axes) or len(units) > 1:
        return {}
    sizes = [median_of(replace(columns, names=names).norms(axes)) for names in (columns.names, parts)]
    if not sizes[0] < 0.5 * sizes[1]:
        return {}
    unit = units.pop() or parse_unit("g" if sizes[1] < 1.5 else "m/s2")
    texts = {a: f"({columns.text(a)} + {quoted_column(parts[a].column)})" for a in axes}
    note = "accelerations and gravity are in separate columns, and are added"
    return {a: {"expression": in_si(unit, text) if unit else text, "note": note} for a, text in texts.items()}


def _web_mercator(columns: Columns, role: Role) -> str:
    """Describe x and y that may be Web Mercator, with the remedy; "" if their magnitude or a name contradicts it."""
    sizes = [median_of(columns.numbers(n).abs()) for n in "xy" if n in columns]
    if len(sizes) < 2 or not 1e5 < min(sizes) <= max(sizes) < EDGE or "utm" in columns.names["y"].plain:
        return ""
    x, y = (f"{columns.text(n)}/{RADIUS:.0f}" for n in "xy")
    read = f"{columns.text('x')} and {columns.text('y')} are read as m east and north"
    maps = f'"{role}.lat=degrees(2*atan2(exp({y}), 1)) - 90" "{role}.lon=degrees({x})"'
    return f"{read}; if they are Web Mercator (EPSG:3857), write --map {maps}"


def _without_unit(columns: Columns, what: str, role: Role) -> TimeExpression:
    """Read accelerations as g, mg or cm/s2 if their magnitude then equals gravity, and rates above 5 as deg/s.

    Other values are read in SI units. Values that are too large for a car, and rates of whole numbers, are refused as
    raw counts.
    """
    text, letter = columns.text(what), what[0]
    axes = [a for a in (f"{letter}{i}" for i in "xyz") if a in columns and columns.names[a].unit is None]
    largest = max(map(columns.largest, axes))
    if letter == "a":
        sizes = columns.norms(axes)
        size, low, high = median_of(sizes), *(float(sizes.quantile(q) or 0.0) for q in (0.25, 0.75))
        values = {a: columns.numbers(a).abs() for a in {*axes, "az"} if a in columns}
        usual = {a: median_of(v.filter(v > 0)) for a, v in values.items()}
        # steady, like gravity; accelerations without gravity are small at rest
        steady = high <= MAX_QUARTILE_RATIO * low
        if steady and (0.9 < size < 1.12 or (0.8 < usual.get("az", 0.0) < 1.2 and size < 5.0)):
            return TimeExpression(
                f"{text}*9.80665", "accelerations are read as g, since gravity has a value of about 1"
            )
        still = math.hypot(*(median_of(columns.numbers(a)) for a in axes))  # without turns and vibration
        gravity = still if still > 0.9 * size > 0 else size
        if 930 < gravity < 1050 and largest < 8000:
            return _mg_or_gal(columns, what, role, axes, gravity)
        raw = max(usual[a] for a in axes) > 30 or largest > MAX_ACCELERATION
        return TimeExpression("", fault=_raw_counts(columns, what, role)) if raw else TimeExpression(text)
    whole = all((columns.numbers(a) == columns.numbers(a).round()).all() for a in axes)
    if largest > MAX_RATE or (whole and largest > 0):
        return TimeExpression("", fault=_raw_counts(columns, what, role))
    if largest > 5.0:
        option = _maps(columns, role, axes, "{}")
        note = f"angular rates are read as deg/s, since their values exceed 5; if they are in rad/s, write {option}"
        return TimeExpression(f"radians({text})", note)
    return TimeExpression(text)


def _mg_or_gal(
    columns: Columns, what: str, role: Role, axes: Sequence[str], gravity: float
) -> TimeExpression:
    """Read accelerations as mg or cm/s2, whichever is nearer to ``gravity``; refuse them halfway between."""
    forms = {"cm/s2": "{}*1e-2", "mg": "{}*0.00980665"}
    maps = {unit: _maps(columns, role, axes, form) for unit, form in forms.items()}
    seen = f"gravity has a value of about {gravity:.4g}"
    if abs(gravity - MIDDLE_OF_MG_AND_GAL) < MAX_NEAR_MIDDLE:
        options = ", or ".join(f"{option} if they are in {unit}" for unit, option in maps.items())
        return TimeExpression("", fault=f"accelerations are in cm/s2 or mg, since {seen}; write {options}")
    unit, other = ("cm/s2", "mg") if gravity < MIDDLE_OF_MG_AND_GAL else ("mg", "cm/s2")
    note = f"accelerations are read as {unit}, since {seen}; if they are in {other}, write {maps[other]}"
    return TimeExpression(forms[unit].format(columns.text(what)), note)


def _raw_counts(columns: Columns, what: str, role: Role) -> str:
    axes = [a for a in (f"{what[0]}{i}" for i in "xyz") if a in columns]
    if what[0] == "a":
        gravity = median_of(columns.norms(axes))
        known = min(PER_G, key=lambda k: abs(gravity / k - 1))
        per = f"{known:g}" if not gravity or abs(gravity / known - 1) < 0.04 else f"{gravity:.4g}"
        form, about = f"{{}}*9.80665/{per}", _ACCELEROMETERS
        seen = "their values exceed the range of an accelerometer"
        seen = f"gravity has a value of about {gravity:.5g}" if gravity else seen
    else:
        whole = all((columns.numbers(a) == columns.numbers(a).round()).all() for a in axes)
        form, about = "radians({}/131)" if whole else "radians({})", _GYROS
        seen = f"their values reach {max(columns.largest(a) for a in axes):.5g}"
    named = ", ".join(quoted(columns.names[a].column) for a in axes)
    maps = _maps(columns, role, axes, form)
    return (
        f"columns {named} contain raw counts, or have an unknown unit ({seen}); specify their scale, for example "
        f"{maps} ({about})"
    )


def _maps(columns: Columns, role: Role, whats: Sequence[str], form: str) -> str:
    return "--map " + " ".join(f'"{role}.{what}={form.format(columns.text(what))}"' for what in whats)


def in_units(frame: pl.DataFrame, role: Role, texts: Mapping[str, str]) -> dict[str, str]:
    """Convert proposed columns to a drive's units like recognized columns, or as the remedy of a fault proposes."""
    columns, signs = Columns(frame), {what: "-" * text.startswith("-") for what, text in texts.items()}
    quoted_names = {quoted_column(column): column for column in frame.columns}
    for what, text in texts.items():
        if what in DIMENSIONS and (column := quoted_names.get(text.removeprefix("-"))):
            unit = read_name(column).unit
            columns.names[what] = Name(column, what, unit if unit and unit.known else None)
    placed = geographic_position(columns, role) if columns.has("lat", "lon") else {}
    found = {what: placed.get(what) or quantity(columns, what, role) for what in columns.names}
    # the scale of raw rates in a remedy is only an example
    faults = {w: read.fault for w, read in found.items() if DIMENSIONS[w] != "rate"}
    remedies = {w: re.search(rf'"{role}\.{w}=([^"]*)"', faults.get(w, "")) for w in found}
    converted = {w: read.expression or (fit[1] if (fit := remedies[w]) else "") for w, read in found.items()}
    return {
        what: f"{signs[what]}{converted[what]}" if converted.get(what) else text
        for what, text in texts.items()
    }


def geographic_position(columns: Columns, role: Role) -> dict[str, TimeExpression]:
    """Convert latitude and longitude to degrees, by their unit, form or magnitude, and by the letters N, S, E, W."""
    both = ("lat", "lon")
    dms = _are_dms(*(columns.frame[columns.names[what].column] for what in both))
    forms = dict.fromkeys(both, "dms({})") if dms else {**columns.degrees}
    possible = _possible(columns)
    # lat_min may also be the smallest latitude in degrees
    arcs = {} if "1" in possible else {f: k for f, k in _ARCS.items() if k in possible}
    for what in () if forms else both:
        name = columns.names[what]
        if name.unit is None:
            continue
        if name.unit.text.lower().startswith(("ddm", "dddm")):
            forms[what] = "ddmm({})"
        elif name.unit.dimension == "angle":
            text = in_si(name.unit, "{}")
            forms[what] = text[len("radians(") : -1] if text.startswith("radians(") else f"degrees({text})"
        elif name.unit.dimension == "time" and name.unit.factor in arcs:
            forms[what] = f"{{}}/{arcs[name.unit.factor]}"
        else:
            fault = unknown_unit(name, what, "angle", role).partition("; ")[0]
            return {what: TimeExpression("", fault=f"{fault}; {_with_other_units(columns, role)}")}
    found = TimeExpression("{}") if forms else _place_form(columns, role)
    if found.fault:
        return dict.fromkeys(both, found)
    places: dict[str, TimeExpression] = {}
    hemispheres = _hemispheres(columns)
    for what in both:
        text = forms.get(what, found.expression).replace("{}", columns.text(what))
        condition, fault = hemispheres.get(what, ("", ""))
        text = f"where({condition}, -abs({text}), {text})" if condition else text
        remedy = f'{fault}, write --map "{role}.{what}={text}"'
        places[what] = TimeExpression("", fault=remedy) if fault else TimeExpression(text, found.note)
    return places


def _are_dms(lat: pl.Series, lon: pl.Series) -> bool:
    """Return True for texts with degree marks or hemisphere letters: 48°07'02.3"N, 11 31.5 E, N48.12.

    Degrees and minutes must be joined to one number (4807.038) in both latitude and longitude, or in neither.
    """
    if lat.dtype != pl.String or lon.dtype != pl.String:
        return False
    both = [values.str.strip_chars().drop_nulls() for values in (lat, lon)]
    both = [values.filter(~values.str.to_lowercase().is_in(NO_VALUE)) for values in both]
    number = r"\d+(?:[.,]\d+)?"
    form = rf"^[NSEW]? *[+-]?{number}(?:[ °º:d'′’m]+{number}){{0,2}}[ °º'′’\"″”ms]*[NSEW]?$"
    fit = all(len(v) and (v.str.contains(form) & v.str.contains("[°ºNSEW]")).all() for v in both)
    joined = [v.str.contains(r"^\D*\d{4}").any() for v in both]
    return fit and joined[0] == joined[1]


def _hemispheres(columns: Columns) -> dict[str, tuple[str, str]]:
    """Return the conditions of rows in the southern and western hemispheres, and faults in the hemispheres' letters.

    The letters are in columns with names such as N/S, or in the columns that follow the coordinates. In the second case
    the columns must contain only these letters, and the coordinates must have no signs.
    """
    frame, found, sure = columns.frame, dict[str, tuple[str, str]](), list[bool]()
    for what, name, words in (("lat", "ns", "north|south"), ("lon", "ew", "east|west")):
        place, named = columns.names[what].column, name in columns
        after = frame.columns[frame.columns.index(place) + 1 :]
        column = columns.names[name].column if named else (*after, place)[0]
        rows = frame.filter(pl.col(place).is_not_null())
        if column == place or frame.schema[column] != pl.String:
            continue
        if frame.schema[place].is_nested() or not len(rows):
            continue
        cells = rows[column].fill_null("").unique(maintain_order=True).to_list()
        texts = [cell for cell in cells if re.fullmatch(f"(?i) *(?:[{name}]|{words}) *", cell)]
        numbers = rows[place].cast(pl.String).str.strip_chars()
        filled = numbers.filter(
            ~is_placeholder(numbers.cast(pl.Float64, strict=False)).fill_null(value=False)
        )
        sure.append(named or (len(texts) == len(cells) and not filled.str.contains("^-|[NSEW]").any()))
        unset = name[1] if any(text.islower() for text in texts) else name[1].upper()
        negative = [text for text in texts if text.strip()[0].lower() == name[1]] or [unset]
        fault = ""
        other = [c for c in cells if re.fullmatch(" *[A-Za-z] *", c) and c not in texts]
        if named and rows[column].is_in(other).sum() > MAX_DAMAGED_SHARE * len(rows):
            negative, (first, last) = other[:1], words.split("|")
            fault = f"column {quoted(column)}: {quoted(other[0])} is neither {first} nor {last}; if it means {last}"
        if named or texts:
            found[what] = " or ".join(f"{quoted_column(column)} == '{text}'" for text in negative), fault
    names = {"lat": "ns", "lon": "ew"}
    return {what: pair for what, pair in found.items() if names[what] in columns or sure == [True, True]}


def degrees_as_meters(columns: Columns, role: Role) -> str:
    """Describe x and y that are likely degrees, since they change by less than 0.001 per row; otherwise return ""."""
    values = [columns.numbers(what) for what in ("x", "y")]
    changes = [v.diff().abs().replace(0.0, None).drop_nulls() for v in values]
    steps = [median_of(v) for v in changes]
    ranges = [float(v.max() or 0) - float(v.min() or 0) for v in values]  # pyright: ignore[reportArgumentType]
    # If the vehicle stands most of the time, the median steps are noise.
    if all(far < 20 * step for far, step in zip(ranges, steps, strict=True)):
        steps = [float(v.max() or 0) for v in changes]  # pyright: ignore[reportArgumentType]
    far = min(median_of(v.abs()) for v in values) > 0.5
    small = far and columns.largest("x") <= 180 and columns.largest("y") <= 90
    if not small or columns.names["x"].unit or not 0 < min(steps) < 3e-4 or max(steps) > 1e-3:
        return ""
    x, y = columns.text("x"), columns.text("y")
    return (
        f"columns {x} and {y} change by {max(steps):.1g} from row to row, as degrees do; write --map "
        f'"{role}.lat={y}" "{role}.lon={x}" for degrees, or --map "{role}.x={x}" "{role}.y={y}" "{role}.lat=" for m'
    )


def from_ecef(columns: Columns) -> dict[str, TimeExpression]:
    """Convert x, y, z from the center of the earth (ECEF, WGS84) to degrees (Bowring); {} for other coordinates.

    UTM coordinates near 57 degrees have the norm of ECEF coordinates, but their z is an altitude.
    """
    if not columns.has("x", "y", "z"):
        return {}
    units = {columns.names[n].unit for n in "xyz"}
    unit = units.pop()
    if units or (unit is not None and unit.dimension != "length"):
        return {}
    low, high = (float(columns.norms(["x", "y", "z"]).quantile(q) or 0.0) for q in (0.1, 0.9))
    factors = (1.0, 0.01, 1e-3) if unit is None else (unit.factor,)
    factor = next((f for f in factors if 6.34e6 < f * low <= f * high < 6.4e6), None)
    stated = all("ecef" in columns.names[n].plain for n in "xyz")
    if factor is None or not (stated or factor * median_of(columns.numbers("z").abs()) > MAX_ALTITUDE):
        return {}
    x, y, z = (columns.text(n) if factor == 1 else f"({columns.text(n)}*{factor:g})" for n in "xyz")
    angle = f"atan2({z}*1.00336409, hypot({x}, {y}))"
    lat = f"degrees(atan2({z} + 42841.3115*sin({angle})**3, hypot({x}, {y}) - 42697.6727*cos({angle})**3))"
    note = f"{x}, {y} and {z} are read as coordinates from the center of the earth (ECEF)"
    return {"lat": TimeExpression(lat, note), "lon": TimeExpression(f"degrees(atan2({y}, {x}))")}


def _place_form(columns: Columns, role: Role) -> TimeExpression:
    """Guess the unit of latitude and longitude from their magnitude; {} in the expression stands for the column."""
    both = ("lat", "lon")
    cells = [columns.frame[columns.names[what].column] for what in both]
    if cells[0].dtype == cells[1].dtype and not cells[0].dtype.is_nested():
        apart = columns.frame.filter(cells[0] != cells[1])  # the same number in both is a placeholder
        columns = replace(columns, frame=apart)
    lat, lon = (columns.numbers(what).filter(columns.numbers(what) != 0).abs() for what in both)
    if not len(lat) or not len(lon):
        return TimeExpression("{}")
    low, high = map(median_of, (lat, lon))
    if low < 1.571 and high < 3.1416:
        radians, degrees = (_maps(columns, role, both, form) for form in ("degrees({})", "{}"))
        options = f"{radians} for radians, {degrees} for degrees"
        fault = f"latitude and longitude are below 1.6 and 3.2 and may be radians; write {options}"
        return TimeExpression("", fault=fault)
    if low <= 90 and high <= 360:
        return TimeExpression("{}")
    if low <= 180 and high <= 90:
        exchanged = f'--map "{role}.lat={columns.text("lon")}" "{role}.lon={columns.text("lat")}"'
        fault = f"the latitude of about {low:.6g} exceeds 90: latitude and longitude are exchanged; write {exchanged}"
        return TimeExpression("", fault=fault)
    minutes = all((v % 100 >= 60).sum() <= MAX_DAMAGED_SHARE * len(v) for v in (lat, lon))
    if low <= 9000 and high <= 18060 and minutes:
        note = "latitude and longitude are read as degrees and minutes, ddmm.mmmm"
        other = f"; if they are arcminutes, write {_maps(columns, role, both, '{}/60')}"
        return TimeExpression("ddmm({})", note + other * (low <= 5400 and high <= 10800))
    if [columns.names[what].plain for what in both] == ["position_lat", "position_long"] and low > 1e6:
        return TimeExpression(
            "{}*180/2147483648", "latitude and longitude are read as semicircles, as in FIT files"
        )
    if low <= 9e8 and high <= 36e8 and (low > 90e6 or high > 180e6):
        other = f"; if they are milliarcseconds, write {_maps(columns, role, both, '{}/3.6e6')}"
        note = "latitude and longitude are read as 1e-7 degrees"
        return TimeExpression("{}*1e-7", note + (other if low <= 90 * 3.6e6 and high <= 180 * 3.6e6 else ""))
    fault = f"latitude and longitude of about {low:.6g} and {high:.6g} are not degrees"
    return TimeExpression("", fault=f"{fault}; {_with_other_units(columns, role)}")


def _with_other_units(columns: Columns, role: Role) -> str:
    return f"write {other_units(role, [columns.text(n) for n in ('lat', 'lon')], _possible(columns))}"


def _possible(columns: Columns) -> list[str]:
    return possible_units(*(median_of(columns.numbers(what).abs()) for what in ("lat", "lon")))


def heading(columns: Columns, what: str, role: Role) -> TimeExpression:
    """Convert a direction to rad counter-clockwise from east; bearings and courses in deg are clockwise from north."""
    name, text = columns.names[what], columns.text(what)
    if name.unit is not None and name.unit.dimension != "angle":
        return quantity(columns, what, role)
    angle = f"radians({text})" if name.unit is None and columns.largest(what) > 6.4 else text
    angle = in_si(name.unit, text) if name.unit is not None else angle
    degrees = "radians" in angle
    if what == "bearing" or (what == "course" and degrees):
        note = f"{name.column} is read as {'degrees' if degrees else 'radians'} clockwise from north"
        return TimeExpression(f"radians(90-{text})" if angle == f"radians({text})" else f"pi/2-{angle}", note)
    assumed = what == "theta" and name.unit is None and degrees
    return TimeExpression(angle, f"{name.column} is read as degrees" if assumed else "")
