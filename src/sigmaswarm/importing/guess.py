"""A guess at what the columns of a table are, by their names, the units in them, and some of their values."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.source import Guess, Part, Role
from sigmaswarm.limits import LONGEST_NAME
from sigmaswarm.wording import names_shown

_TIME = "t|ts|time|timestamp|time_?stamp|stamp|secs?|seconds|seconds_elapsed|date_?time|utime|epoch|unix_?time|utc"
_CLOCK = (
    "boot|up_?time|ticks?|elapsed|i?tow|tod|sod|sow|(?:time|sec|secs|seconds)_of_(?:the_)?(?:day|week)|"
    "(?:boot|sys(?:tem)?|device|sensor|host|log(?:ger)?|gps|gnss|rx|recv|local|mono(?:tonic)?|elapsed)_?(?:time|clock|stamp)"
)
"""Names of times that are taken where a table has none of the usual ones."""
_ACCELERATION = "a|acc|accel|acceleration|accelerometer|lin(?:ear)?_?acc(?:el|eleration)?|specific_force|f"
_RATE = "g|w|gyr|gyro|gyroscope|omega|ang(?:ular)?_?vel(?:ocity)?|ang(?:ular)?_?rate|rot|rotation_?rate|rate"
_STD = "(?:std|stdev|std_?dev|sigma|sd)"  # as receivers of survey grade have them, in m for degrees, too
_NAMES: tuple[tuple[str, str], ...] = (
    ("t", _TIME),
    *((f"a{i}", f"(?:{_ACCELERATION})_?{i}") for i in "xyz"),
    *((f"g{i}", f"(?:{_RATE})_?{i}") for i in "xyz"),
    ("gz", "yaw_?rate"),
    ("lat", "lat|latitude"),
    ("lon", "lon|lng|long|longitude"),
    ("alt", "alt|altitude|height|elevation|ele"),
    ("x", "x|east|easting|e|pos(?:ition)?_?x"),
    ("y", "y|north|northing|n|pos(?:ition)?_?y"),
    ("vx", "vx|ve|v_?east|east_?vel(?:ocity)?|vel(?:ocity)?_?e(?:ast)?"),
    ("vy", "vy|vn|v_?north|north_?vel(?:ocity)?|vel(?:ocity)?_?n(?:orth)?"),
    ("std_x", f"std_?x|sigma_?x|std_?e(?:ast)?|sd_?e|std_?lon|(?:lon(?:gitude)?|east(?:ing)?)_?{_STD}"),
    ("std_y", f"std_?y|sigma_?y|std_?n(?:orth)?|sd_?n|std_?lat|(?:lat(?:itude)?|north(?:ing)?)_?{_STD}"),
    (
        "wheel_speed",
        "(?:wheels?|vehicle|car|can|odo(?:meter)?)_?(?:speed|velocity)|speed_?(?:can|wheels?)|odometer",
    ),
    ("speed", "speed|(?:ground_?)?speed|velocity|vel|v"),
    ("course", "course"),
    ("bearing", "bearing|track|heading|cog"),
    ("theta", "theta|yaw"),
)
_UNITS: tuple[tuple[str, str], ...] = (
    ("deg/s", r"deg/s(?:ec)?|°/s|dps|degps|degs|deg_s"),
    ("rad/s", r"rad/s(?:ec)?|radps|rps|rad_s"),
    ("m/s2", r"m/s\^?2|m/s²|m/s/s|mps2|ms2|m_s2|m_s_2|ms-2"),
    ("km/h", r"km/h|kmh|kph"),
    ("m/s", r"m/s|mps|m_s"),
    ("mg", r"mg|milli_?g"),
    ("g", r"g"),
    ("ns", r"ns|nanos(?:econds)?|nsec"),
    ("us", r"us|µs|μs|micros(?:econds)?|usec"),
    ("ms", r"ms|millis(?:econds)?|msec"),
    ("s", r"s|sec|secs|seconds"),
    ("deg", r"deg|degrees|°"),
    ("rad", r"rad|radians"),
    ("m", r"m|meters?|metres?"),
)
_SCALES = {
    **{"deg/s": "radians({})", "g": "{}*9.80665", "mg": "{}*0.00980665", "km/h": "{}/3.6"},
    **{"ns": "{}*1e-9", "us": "{}*1e-6", "ms": "{}*1e-3"},
}
_GIVEN_IN = {
    "t": ("s", "ms", "us", "ns"),
    "a": ("m/s2", "g", "mg"),
    "g": ("rad/s", "deg/s"),
    "s": ("m/s", "km/h"),
}
"""Units that a column of time, acceleration, rate and speed may have; others in its name mean nothing."""
SAMPLE = 2000
"""Rows by which units are guessed."""
_WHEELS = re.compile(r"odo|wheel|(?:^|[^a-z])can(?:[^a-z]|$)", re.IGNORECASE)
_TRUTH = re.compile(r"truth|ground|reference|(?:^|[^a-z])(?:gt|ref)(?:[^a-z]|$)", re.IGNORECASE)


@dataclass
class _Found:
    """A table's columns by what they are, with the units in their names, and what was assumed."""

    frame: pl.DataFrame
    name: dict[str, str] = field(default_factory=dict[str, str])
    unit: dict[str, str] = field(default_factory=dict[str, str])

    def median(self, what: str) -> float:
        """The median size of a column over the sample, 0 where it has no numbers."""
        values = numbers_of(self.frame[self.name[what]]).abs()
        return float(values.median() or 0.0)  # pyright: ignore[reportArgumentType]

    def largest(self, what: str) -> float:
        """The 99th percentile of a column's size."""
        values = numbers_of(self.frame[self.name[what]]).abs()
        return float(values.quantile(0.99) or 0.0)


def numbers_of(values: pl.Series) -> pl.Series:
    """The numbers among a column's values; lists and bytes are none."""
    if values.dtype.is_nested() or isinstance(values.dtype, pl.Binary | pl.Object):
        return pl.Series([], dtype=pl.Float64)
    return values.cast(pl.Float64, strict=False).drop_nulls().drop_nans()


def guess_roles(samples: Mapping[str, pl.DataFrame], chosen: Mapping[str, str] | None = None) -> Guess:
    """Which tables hold IMU, fixes and truth, by their columns, and by their names where several could.

    Parameters
    ----------
    samples : the first rows of each table
    chosen : the table of a role, where the user said which
    """
    chosen = chosen or {}
    found = {table: _find(frame) for table, frame in samples.items()}
    roles: dict[Role, tuple[Part, ...]] = {}
    notes: list[str] = []
    candidates: dict[Role, list[str]] = {
        "imu": [t for t, f in found.items() if {"ax", "ay", "gz"} <= f.name.keys()],
        "truth": [t for t, f in found.items() if _TRUTH.search(t) and _placed(f)],
        "gps": [t for t, f in found.items() if _placed(f) and not _TRUTH.search(t)],
        "odometer": [t for t, f in found.items() if _counted(t, f)],
    }
    hints: dict[Role, str] = {
        "imu": "imu",
        "gps": "gps|gnss|fix|location",
        "truth": "truth",
        "odometer": "odo|wheel",
    }
    for role, tables in candidates.items():
        if role in chosen and chosen[role] not in samples:
            raise InputError(f"there is no table {chosen[role]!r}; there are {names_shown(samples)}")
        if tables or role in chosen:
            best = chosen[role] if role in chosen else _best(tables, hints[role])
            notes.extend(_alike(role, best, [t for t in tables if t not in chosen.values()], samples))
            roles[role] = (Part(best, dict(_expressions(found[best], role, notes))),)
    downward = _downward(found[roles["imu"][0].table]) if "imu" in roles else ""
    return Guess(roles, tuple(dict.fromkeys(notes)), downward=downward)


def _downward(imu: _Found) -> str:
    """A sentence where the vertical axis of an IMU points down."""
    middle = numbers_of(imu.frame[imu.name["az"]]).median() if "az" in imu.name else 0.0
    if float(middle or 0.0) >= 0:  # pyright: ignore[reportArgumentType]
        return ""
    return (
        f"{imu.name['az']} is negative, so that axis points down; where the others point forward and to the right, say "
        "--mount x=x,y=-y; `sigmaswarm doctor` tells whether it was right"
    )


def _alike(
    role: Role, taken: str, tables: Sequence[str], samples: Mapping[str, pl.DataFrame]
) -> Iterator[str]:
    """Tables of the same columns as the one that is taken: another part of the log, or another log."""
    alike = [t for t in tables if t != taken and samples[t].columns == samples[taken].columns]
    if alike:
        yield (
            f"{names_shown(alike)} {'has' if len(alike) == 1 else 'have'} the columns of {taken}, and only {taken} is "
            f"taken for the {role}; choose with --{role}-table, and import each log into a drive of its own"
        )


def _best(tables: Sequence[str], hint: str) -> str:
    """The first table whose name fits, or else the first."""
    return max(tables, key=lambda table: bool(re.search(hint, table, re.IGNORECASE)))


def time_of(frame: pl.DataFrame) -> str | None:
    """The expression of a table's time, if a column looks like it."""
    found = _find(frame)
    return dict(_expressions(found, "imu", [])).get("t") if "t" in found.name else None


def _placed(found: _Found) -> bool:
    return {"lat", "lon"} <= found.name.keys() or {"x", "y"} <= found.name.keys()


def _counted(table: str, found: _Found) -> bool:
    """Whether a table has the wheels' speed: by the column's name, or by the table's where it has no position."""
    named = "speed" in found.name and bool(_WHEELS.search(table)) and not _placed(found)
    return "wheel_speed" in found.name or named


def _find(frame: pl.DataFrame) -> _Found:
    """Which column is what; of several that could be one, the first."""
    found = _Found(frame)
    for column in frame.columns:
        plain, unit = _split(column)
        for what, pattern in _NAMES:
            if re.fullmatch(pattern, plain) and what not in found.name:
                found.name[what], found.unit[what] = column, unit
                break
    if "t" not in found.name:
        clocks = (c for c in frame.columns if re.fullmatch(_CLOCK, _split(c)[0]) and _step(frame[c]) > 0)
        if (clock := next(clocks, None)) is not None:
            found.name["t"], found.unit["t"] = clock, _split(clock)[1]
    return found


def _split(column: str) -> tuple[str, str]:
    """A column's name in small letters without the unit, and the unit: "Acceleration x (m/s^2)", "gyro_z_dps"."""
    name = column.strip().lower()
    if len(name) > LONGEST_NAME:  # the patterns' time grows with the square of the length
        return name[:LONGEST_NAME], ""
    bracketed = re.fullmatch(r"(.*?)\s*[\[(](.*)[\])]\s*", name)
    said = bracketed[2].strip() if bracketed else ""
    name = re.sub(r"[^a-z0-9]+", "_", bracketed[1] if bracketed else name).strip("_")
    if said:
        return name, next((unit for unit, pattern in _UNITS if re.fullmatch(pattern, said)), "")
    for unit, pattern in _UNITS:
        ending = re.fullmatch(rf"(.+)_(?:{pattern})", name)
        if ending and any(re.fullmatch(p, ending[1]) for p in (_CLOCK, *(p for _, p in _NAMES))):
            return ending[1], unit
    return name, ""


LONGEST_STEP: dict[Role, float] = {"imu": 0.5, "gps": 15.0, "truth": 15.0, "odometer": 5.0}
"""s between samples that is still likely."""
SHORTEST_STEP = 1e-4
"""s: no car's sensor is faster."""

_WANTED: dict[Role, tuple[str, ...]] = {
    "imu": ("t", "ax", "ay", "az", "gx", "gy", "gz"),
    "gps": ("t", "lat", "lon", "alt", "x", "y", "std_x", "std_y", "speed", "course", "bearing", "vx", "vy"),
    "truth": ("t", "lat", "lon", "alt", "x", "y", "vx", "vy", "theta"),
    "odometer": ("t", "wheel_speed", "speed"),
}


def _expressions(found: _Found, role: Role, notes: list[str]) -> Iterator[tuple[str, str]]:
    """The drive's columns of a role, as expressions in a drive's units."""
    for what in _WANTED[role]:
        if what not in found.name or (what in ("x", "y") and "lat" in found.name and "lon" in found.name):
            continue
        column = found.name[what]
        text = column if re.fullmatch(r"[A-Za-z_]\w*", column) else f"`{column}`"
        if what == "t":
            yield "t", _time(found, text, role, notes)
        elif what == "wheel_speed":
            yield "speed", _SCALES.get(_unit(found, what, notes), "{}").format(text)
        elif what == "speed" and role == "odometer" and "wheel_speed" in found.name:
            continue
        elif what == "bearing" or (what == "course" and found.largest("course") > 6.4):
            notes.append(f"{column} taken as degrees clockwise from north")
            yield "course", f"radians(90-{text})"
        else:
            yield what, _SCALES.get(_unit(found, what, notes), "{}").format(text)


def _time(found: _Found, text: str, role: Role, notes: list[str]) -> str:
    """A time in s: text are dates; else the unit in the name, the size of numbers, or the step between them."""
    column = found.name["t"]
    values = found.frame[column]
    if values.dtype == pl.String and not len(numbers_of(values)):
        return f"utc({text})"
    if values.dtype.is_temporal():
        return text
    unit = found.unit["t"] if found.unit["t"] in _GIVEN_IN["t"] else ""
    if not unit:
        unit = _time_unit(found, values, role)
        if unit != "s":
            notes.append(f"{column} taken as {unit}")
    return _SCALES.get(unit, "{}").format(text)


_UNITS_OF_TIME = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))


def _time_unit(found: _Found, values: pl.Series, role: Role) -> str:
    """The unit in which a time counts from 1970 to our days, or else makes a likely step between samples."""
    units = _UNITS_OF_TIME
    size = found.median("t")
    for unit, scale in units:
        dates = 3e8 < size * scale < 4e9  # 1979 to 2096
        if dates and (unit != "s" or _step(values) < LONGEST_STEP[role]):
            return unit
    return next((unit for unit, scale in units if _step(values) * scale < LONGEST_STEP[role]), "s")


def wrong_unit(text: str, rows: pl.DataFrame, role: Role) -> str:
    """What is wrong with the unit of a time, ``column`` or ``column*number``, and the cure; empty where nothing is.

    Its unit is wrong if its steps are far from what a sensor's are, and another unit makes them likely.
    """
    plain = re.fullmatch(r"\s*(`[^`]+`|[A-Za-z_]\w*)\s*(?:\*\s*([\d.eE+-]+)|/\s*([\d.eE+-]+))?\s*", text)
    name = plain[1].strip("`") if plain else ""
    if plain is None or name not in rows.columns or not rows[name].dtype.is_numeric():
        return ""
    try:
        scale = float(plain[2] or 1.0) / float(plain[3] or 1.0)
    except (ValueError, ZeroDivisionError):
        return ""
    step = _step(rows[name])
    if not step or SHORTEST_STEP < step * scale < 4 * LONGEST_STEP[role]:
        return ""
    unit = _time_unit(_Found(rows, {"t": name}), rows[name], role)
    said = _SCALES.get(unit, "{}").format(plain[1])
    likely = step * dict(_UNITS_OF_TIME)[unit]
    if not SHORTEST_STEP < likely < 4 * LONGEST_STEP[role]:
        return ""
    t = "--time" if role == "imu" else f"--map {role}.t="
    return (
        f"{text} in s would put {step * scale:.4g} s between two rows of the {role}; in {unit} it is {likely:.4g} s: "
        f'write {t}{" " if role == "imu" else ""}"{said}"'
    )


def _step(values: pl.Series) -> float:
    """The median of a time's forward steps."""
    steps = numbers_of(values).diff().drop_nulls()
    return float(steps.filter(steps > 0).median() or 0.0)  # pyright: ignore[reportArgumentType]


def _unit(found: _Found, what: str, notes: list[str]) -> str:
    """The unit of a column: in its name, or by the size of its values."""
    kind = (
        "a"
        if what in ("ax", "ay", "az")
        else "g"
        if what in ("gx", "gy", "gz")
        else "s"
        if what in ("speed", "wheel_speed")
        else ""
    )
    if kind and found.unit[what] in _GIVEN_IN[kind]:
        return found.unit[what]
    if kind == "a" and "az" in found.name and 0.8 < found.median("az") < 1.2:
        notes.append("accelerations taken as g, since the one along z is about 1")
        return "g"
    if kind == "g" and max(found.largest(n) for n in ("gx", "gy", "gz") if n in found.name) > 5.0:
        notes.append("angular rates taken as deg/s, since they exceed 5")
        return "deg/s"
    return ""
