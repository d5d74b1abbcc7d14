"""A column's quantity in a drive's units: by the unit in its name, or by the size of its values."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import polars as pl

from sigmaswarm.importing.names import Name
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.times import Found, numbers_of, unknown_unit, written
from sigmaswarm.importing.units import COUNTS, Dimension, in_si
from sigmaswarm.wording import quoted

PLACEHOLDERS = (-999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, 1e10, -1e10)
"""Markers of missing values in logs."""
DIMENSIONS: dict[str, Dimension] = {
    **dict.fromkeys(("ax", "ay", "az"), "acceleration"),
    **dict.fromkeys(("gx", "gy", "gz"), "rate"),
    **dict.fromkeys(("lat", "lon", "course", "bearing", "theta"), "angle"),
    **dict.fromkeys(("alt", "x", "y", "std_x", "std_y"), "length"),
    **dict.fromkeys(("speed", "wheel_speed", "vx", "vy"), "speed"),
}
REQUIRED = ("ax", "ay", "az", "gx", "gy", "gz", "lat", "lon", "x", "y", "theta", "wheel_speed")
"""Columns whose unit must be known; others of an unknown unit are left out."""
MOST_FORCE = 100.0
"""m/s2: a car's accelerometer shows no more, but for bumps."""
FASTEST = 700.0
"""deg/s: a car's gyro shows no more."""
_ACCELEROMETERS = "usual 16-bit sensors: 16384 counts per g at +-2 g, 8192 at 4, 4096 at 8, 2048 at 16"
_GYROS = "usual 16-bit sensors: 131 counts per deg/s at +-250 deg/s, 65.5 at 500, 32.8 at 1000, 16.4 at 2000"


@dataclass
class Columns:
    """A table's first rows, and its columns by quantity."""

    frame: pl.DataFrame
    names: dict[str, Name] = field(default_factory=dict[str, Name])

    def __contains__(self, what: str) -> bool:
        return what in self.names

    def has(self, *whats: str) -> bool:
        """Return True if all of them are there."""
        return self.names.keys() >= set(whats)

    def numbers(self, what: str) -> pl.Series:
        """The numbers in a column, without placeholders."""
        values = numbers_of(self.frame[self.names[what].column])
        return values.filter(~values.is_in(PLACEHOLDERS))

    def median(self, what: str) -> float:
        """The median size of a column over the sample, 0 where it has no numbers."""
        return float(self.numbers(what).abs().median() or 0.0)  # pyright: ignore[reportArgumentType]

    def largest(self, what: str) -> float:
        """The 99th percentile of a column's size."""
        return float(self.numbers(what).abs().quantile(0.99) or 0.0)

    def norm(self, axes: Sequence[str]) -> float:
        """The median size of a vector (3,)."""
        series = [self.frame[self.names[a].column] for a in axes]
        if any(s.dtype.is_nested() for s in series):
            return 0.0
        squares = [s.cast(pl.Float64, strict=False).pow(2) for s in series]
        return float(sum(squares[1:], squares[0]).sqrt().median() or 0.0)  # pyright: ignore[reportArgumentType]

    def text(self, what: str) -> str:
        """A column as an expression names it."""
        return written(self.names[what].column)


def quantity(columns: Columns, what: str, role: Role) -> Found:
    """A column in a drive's units; angles of places and headings in the unit that ``what`` has in a drive."""
    name, text = columns.names[what], columns.text(what)
    dimension = DIMENSIONS[what]
    if name.unit is not None:
        if name.unit.dimension == dimension:
            return Found(in_si(name.unit, text))
        if name.unit.text.strip().lower() in COUNTS and dimension in ("acceleration", "rate"):
            return Found("", fault=_raw_counts(columns, what, role))
        sentence = unknown_unit(name, what, dimension, role)
        if what in REQUIRED:
            return Found("", fault=sentence)
        return Found("", note=f"{sentence}; left out")
    if dimension == "acceleration":
        return _acceleration(columns, what, role)
    if dimension == "rate":
        return _rate(columns, what, role)
    return Found(text)


def _acceleration(columns: Columns, what: str, role: Role) -> Found:
    """Without a unit: g or mg, where that makes gravity of the three axes; m/s2; or raw counts."""
    text = columns.text(what)
    axes = [a for a in ("ax", "ay", "az") if a in columns and columns.names[a].unit is None]
    size = columns.norm(axes) if len(axes) == 3 else 0.0
    if ("az" in columns and 0.8 < columns.median("az") < 1.2) or 0.9 < size < 1.12:
        return Found(f"{text}*9.80665", "accelerations taken as g, since gravity in them is about 1")
    if 930 < size < 1050 and max(columns.largest(a) for a in axes) < 8000:
        return Found(f"{text}*0.00980665", "accelerations taken as mg, since gravity in them is about 1000")
    if max(columns.median(a) for a in axes) > 30 or max(columns.largest(a) for a in axes) > MOST_FORCE:
        return Found("", fault=_raw_counts(columns, what, role))
    return Found(text)


def _rate(columns: Columns, what: str, role: Role) -> Found:
    """Without a unit: deg/s where they exceed 5; or raw counts, where no car turns so fast."""
    axes = [a for a in ("gx", "gy", "gz") if a in columns and columns.names[a].unit is None]
    largest = max(columns.largest(a) for a in axes)
    whole = all((columns.numbers(a) == columns.numbers(a).round()).all() for a in axes)
    if largest > FASTEST or (whole and largest > 100):
        return Found("", fault=_raw_counts(columns, what, role))
    if largest > 5.0:
        return Found(f"radians({columns.text(what)})", "angular rates taken as deg/s, since they exceed 5")
    return Found(columns.text(what))


def _raw_counts(columns: Columns, what: str, role: Role) -> str:
    """The sentence on a sensor's raw counts: one for all three axes, with the way to map them."""
    letter = what[0]
    axes = [a for a in (f"{letter}{i}" for i in "xyz") if a in columns]
    if letter == "a":
        gravity = columns.norm(axes) if len(axes) == 3 else 0.0
        known = [k for k in (16384, 8192, 4096, 2048, 1000) if abs(gravity / k - 1) < 0.12]
        per = known[0] if known else 16384
        form, about = f"{{}}*9.80665/{per}", _ACCELEROMETERS
        seen = (
            f"gravity is about {gravity:.5g} in them"
            if gravity
            else "they exceed what an accelerometer shows"
        )
    else:
        form, about = "radians({}/131)", _GYROS
        seen = f"they reach {max(columns.largest(a) for a in axes):.5g}"
    maps = " ".join(f'"{role}.{a}={form.format(columns.text(a))}"' for a in axes)
    named = ", ".join(quoted(columns.names[a].column) for a in axes)
    return f"columns {named} hold raw counts, or an unknown unit: {seen}; give their scale, as --map {maps} ({about})"


def place(columns: Columns, role: Role) -> dict[str, Found]:
    """Latitude and longitude in degrees: of radians, 1e-7 degrees, degrees and minutes, with N, S, E, W in columns."""
    texts: dict[str, str] = {}
    for what in ("lat", "lon"):
        unit = columns.names[what].unit
        if unit is None:
            continue
        if unit.text.lower().startswith("ddm") or unit.text.lower().startswith("dddm"):
            texts[what] = f"ddmm({columns.text(what)})"
        elif unit.dimension != "angle":
            return {what: Found("", fault=unknown_unit(columns.names[what], what, "angle", role))}
        else:
            texts[what] = in_degrees(in_si(unit, columns.text(what)))
    note = ""
    if not texts:
        found = _unnamed_place(columns, role)
        if found.fault:
            return {"lat": found, "lon": found}
        texts = {what: found.expression.format(columns.text(what)) for what in ("lat", "lon")}
        note = found.note
    for what, letters, negative in (("lat", "ns", "S"), ("lon", "ew", "W")):
        text = texts.setdefault(what, columns.text(what))
        if letters in columns and columns.frame[columns.names[letters].column].dtype == pl.String:
            texts[what] = f"where({columns.text(letters)} == '{negative}', -1, 1)*{text}"
    return {what: Found(texts[what], note) for what in ("lat", "lon")}


def in_degrees(text: str) -> str:
    """An expression in rad as degrees."""
    return text[len("radians(") : -1] if text.startswith("radians(") else f"degrees({text})"


def _unnamed_place(columns: Columns, role: Role) -> Found:
    """The form of latitude and longitude whose unit is not named, with {} for the column."""
    lat, lon = (columns.numbers(what).filter(columns.numbers(what) != 0) for what in ("lat", "lon"))
    if not len(lat) or not len(lon):
        return Found("{}")
    low, high = (float(v.abs().quantile(0.99) or 0.0) for v in (lat, lon))
    texts = [columns.text(what) for what in ("lat", "lon")]

    def remedy(form: str) -> str:
        return " ".join(f'"{role}.{w}={form.format(t)}"' for w, t in zip(("lat", "lon"), texts, strict=True))

    if low <= 90 and high <= 360:
        if low < 1.571 and high < 3.1416:
            said = f"--map {remedy('degrees({})')} where they are, --map {remedy('{}')} where not"
            return Found(
                "", fault=f"latitude and longitude are within 1.6 and 3.2 and may be radians; write {said}"
            )
        return Found("{}")
    if low <= 9000 and high <= 18060 and all((v.abs() % 100 < 60).all() for v in (lat, lon)):
        return Found("ddmm({})", "latitude and longitude taken as degrees and minutes, ddmm.mmmm")
    if low <= 9e8 and high <= 36e8 and (low > 90e6 or high > 180e6):
        return Found("{}*1e-7", "latitude and longitude taken as 1e-7 degrees")
    said = f"--map {remedy('{}*1e-7')} (or another factor)"
    return Found(
        "", fault=f"latitude and longitude of about {low:.6g} and {high:.6g} are no degrees; write {said}"
    )


def heading(columns: Columns, what: str, role: Role) -> Found:
    """A direction in rad counter-clockwise from east: a bearing runs clockwise from north, also a course in degrees."""
    name, text = columns.names[what], columns.text(what)
    unit = name.unit
    if unit is not None and unit.dimension != "angle":
        return quantity(columns, what, role)
    degrees = unit is not None and "radians" in in_si(unit, text)
    note = ""
    if unit is None:
        degrees = columns.largest(what) > 6.4
    angle = (
        text if unit is None and not degrees else f"radians({text})" if unit is None else in_si(unit, text)
    )
    if what == "bearing" or (what == "course" and degrees):
        note = f"{name.column} taken as {'degrees' if degrees else 'radians'} clockwise from north"
        return Found(f"radians(90-{text})" if angle == f"radians({text})" else f"pi/2-{angle}", note)
    if what == "theta" and unit is None and degrees:
        note = f"{name.column} taken as degrees"
    return Found(angle, note)
