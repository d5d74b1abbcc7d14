"""Convert accelerations, rates, speeds and directions to a drive's units, by the unit in the name or by the values."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import polars as pl

from sigmaswarm.importing.coordinates import (
    MAX_ALTITUDE,
    describe_web_mercator,
    geographic_position,
    map_options,
)
from sigmaswarm.importing.names import Name, plain_words, read_name, split_words
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.table_columns import (
    AXES,
    DIMENSIONS,
    Columns,
    Conversion,
    median_of,
    quoted_column,
    refused,
    unknown_unit,
)
from sigmaswarm.importing.units import COUNTS, in_si, parse_unit
from sigmaswarm.wording import quoted

# Columns whose unknown unit is a fault; other columns with an unknown unit are left out
REQUIRED = ("ax", "ay", "az", "gx", "gy", "gz", "lat", "lon", "x", "y", "theta", "wheel_speed")
MIDDLE_OF_MG_AND_GAL = 990.3  # between the values of gravity in cm/s2 (981) and in mg (1000)
MAX_NEAR_MIDDLE = 3.0  # if gravity is closer to this middle, the unit is unknown
# Largest ratio of the third to the first quartile of the magnitude of accelerations with gravity
MAX_QUARTILE_RATIO = 1.5
MAX_ACCELERATION = 100.0  # m/s2, largest acceleration of a car on a smooth road
MAX_RATE = 250.0  # deg/s, largest angular rate of a car
# Units per g: counts of common sensors, then mg, cg, ug, mm/s2, cm/s2 and ft/s2
PER_G = (16384, 8192, 4096, 4000, 2048, 1024, 256, 1000, 100, 1e6, 9806.65, 980.665, 9.80665 / 0.3048)
_ACCELEROMETERS = (
    "common 16-bit sensors: 16384 counts per g at +-2 g, 8192 at +-4 g, 4096 at +-8 g, 2048 at +-16 g"
)
_GYROS = (
    "common 16-bit sensors: 131 counts per deg/s at +-250 deg/s, 65.5 at +-500 deg/s, 32.8 at +-1000 deg/s, "
    "16.4 at +-2000 deg/s; mrad/s: each column*1e-3; deg/s: radians(column)"
)


def quantity(columns: Columns, what: str, role: Role) -> Conversion:
    name, text, dimension = columns.names[what], columns.text(what), DIMENSIONS[what]
    if name.unit is None and what == "alt" and columns.largest(what) > MAX_ALTITUDE:
        seen = f"{name.column} is left out, since {columns.largest(what):.6g} is not an altitude in m"
        example = map_options(columns, role, ["alt"], "{}*1e-3")
        return Conversion("", note=f"{seen}; map the column: {example} if it is in mm, *1e-2 if it is in cm")
    if name.unit is None:
        if dimension in ("acceleration", "rate"):
            return _without_unit(columns, what, role)
        note = describe_web_mercator(columns, role) if what == "y" else ""
        if what == "speed" and read_name(name.column).meaning is None:  # in another language
            other = map_options(columns, role, ["speed"], "{}/3.6")
            note = f"{text} is read as m/s; if it is in km/h, write {other}"
        return Conversion(text, note)
    if name.unit.dimension == dimension:
        return Conversion(in_si(name.unit, text))
    if name.unit.text.strip().lower() in COUNTS and dimension in ("acceleration", "rate"):
        return refused(_raw_counts(columns, what, role))
    likely = ""
    if dimension == "acceleration":  # gravity shows the unit
        bare = {w: replace(n, unit=None) if n.unit == name.unit else n for w, n in columns.names.items()}
        likely = _without_unit(replace(columns, names=bare), what, role).expression
    sentence = unknown_unit(name, what, dimension, role, likely)
    return (
        refused(sentence) if what in REQUIRED else Conversion("", note=f"{sentence}; this column is left out")
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
    """Add the columns of gravity to accelerations without gravity.

    Return the expression and the note by axis, or {}.
    """
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


def _without_unit(columns: Columns, what: str, role: Role) -> Conversion:
    """Read accelerations as g, mg or cm/s2 if their magnitude then equals gravity, and rates above 5 as deg/s.

    Other values are read in SI units. Values that are too large for a car, and rates in whole numbers, are refused as
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
            return Conversion(
                f"{text}*9.80665", "accelerations are read as g, since gravity has a value of about 1"
            )
        still = math.hypot(*(median_of(columns.numbers(a)) for a in axes))  # without turns and vibration
        gravity = still if still > 0.9 * size > 0 else size
        if 930 < gravity < 1050 and largest < 8000:
            return _mg_or_gal(columns, what, role, axes, gravity)
        raw = max(usual[a] for a in axes) > 30 or largest > MAX_ACCELERATION
        return refused(_raw_counts(columns, what, role)) if raw else Conversion(text)
    whole = all((columns.numbers(a) == columns.numbers(a).round()).all() for a in axes)
    if largest > MAX_RATE or (whole and largest > 0):
        return refused(_raw_counts(columns, what, role))
    if largest > 5.0:
        option = map_options(columns, role, axes, "{}")
        note = f"angular rates are read as deg/s, since their values exceed 5; if they are in rad/s, write {option}"
        return Conversion(f"radians({text})", note)
    return Conversion(text)


def _mg_or_gal(columns: Columns, what: str, role: Role, axes: Sequence[str], gravity: float) -> Conversion:
    """Choose the unit mg or cm/s2 from ``gravity``, the value at rest. A value near the middle of both is refused."""
    forms = {"cm/s2": "{}*1e-2", "mg": "{}*0.00980665"}
    maps = {unit: map_options(columns, role, axes, form) for unit, form in forms.items()}
    seen = f"gravity has a value of about {gravity:.4g}"
    if abs(gravity - MIDDLE_OF_MG_AND_GAL) < MAX_NEAR_MIDDLE:
        options = ", or ".join(f"{option} if they are in {unit}" for unit, option in maps.items())
        return refused(f"accelerations are in cm/s2 or mg, since {seen}; write {options}")
    unit, other = ("cm/s2", "mg") if gravity < MIDDLE_OF_MG_AND_GAL else ("mg", "cm/s2")
    note = f"accelerations are read as {unit}, since {seen}; if they are in {other}, write {maps[other]}"
    return Conversion(forms[unit].format(columns.text(what)), note)


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
    maps = map_options(columns, role, axes, form)
    return (
        f"columns {named} contain raw counts, or have an unknown unit ({seen}); specify their scale, for example "
        f"{maps} ({about})"
    )


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


def heading(columns: Columns, what: str, role: Role) -> Conversion:
    """Convert a direction to rad counter-clockwise from east. Bearings and courses in deg are clockwise from north."""
    name, text = columns.names[what], columns.text(what)
    if name.unit is not None and name.unit.dimension != "angle":
        return quantity(columns, what, role)
    angle = f"radians({text})" if name.unit is None and columns.largest(what) > 6.4 else text
    angle = in_si(name.unit, text) if name.unit is not None else angle
    degrees = "radians" in angle
    if what == "bearing" or (what == "course" and degrees):
        note = f"{name.column} is read as {'degrees' if degrees else 'radians'} clockwise from north"
        return Conversion(f"radians(90-{text})" if angle == f"radians({text})" else f"pi/2-{angle}", note)
    assumed = what == "theta" and name.unit is None and degrees
    return Conversion(
        angle, f"{name.column} is read as degrees unless the course shows another unit" if assumed else ""
    )


RATE = "SAMPLES_PER_S"  # stands for the rate, Hz, in the expressions
_INCREMENTS = {
    "a": ("speed", r"(?:delta_?|d)v(?:el(?:ocity)?)?_?([xyz])"),
    "g": ("angle", r"(?:delta_?|d)(?:theta|ang(?:le)?|rot(?:ation)?)_?([xyz])"),
}


def increments(names: Sequence[str]) -> dict[str, str]:
    """Return the expressions of the six axes, with `RATE`; {} unless there are increments on all axes."""
    found: dict[str, str] = {}
    for name in names:
        bare = re.sub(r"\s*[\[(][^\[\]()]*[\])]\s*$", "", name)
        plain = "_".join(split_words(bare))
        unit = read_name(name).unit
        for letter, (dimension, words) in _INCREMENTS.items():
            axis = re.fullmatch(rf"(?:.*_)?{words}", plain)
            if axis and (unit is None or unit.dimension == dimension):
                text = quoted_column(name)
                found.setdefault(f"{letter}{axis[1]}", f"{in_si(unit, text) if unit else text}*{RATE}")
    return found if len(found) == 6 else {}
