"""Find the condition of the rows to read: rows with a fix, or rows of one of several sensors that alternate."""

import math
import re

import polars as pl

from sigmaswarm.importing.expressions import compile_expression
from sigmaswarm.importing.names import plain_words, read_names
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.table_columns import (
    Columns,
    Conversion,
    column_numbers,
    is_placeholder,
    median_of,
    quoted_column,
)

# Names of columns that state whether a row has a fix: 0 means no fix; in ROS, -1 means no fix and 0 means a fix
_FIXED = "(?:gps|gnss)?_?fix_?(?:type|quality|mode|valid|ok|status)?|(?:(?:gps|gnss)_?)?valid|(?:gps|gnss)_?quality"
# Names of columns with the number of satellites; 0 means no fix
_SATELLITES = "(?:gps_|gnss_)?(?:(?:num|n|no|number_of)_?)?(?:sats?|sv|satellites)(?:_used)?"
# Names of columns that state in words whether a row has a fix
_STATUS = (
    rf"{_FIXED}|(?:(?:gps|gnss|nav|pos|position|sol|solution)_?)?(?:status|state|mode|type|solution|quality)"
)
# Names of `_STATUS` that autopilots also use; their words resemble those of receivers: AUTO, FOLLOW_GPS, ACTIVE
_PILOT = "state|mode|type"
# Words that mean no fix, in lower case and joined by "_"
_NO_FIX = (
    r"(?:no|not|un|in)_?(?:\w+_)?(?:valid|fix|fixed|solution|gps|gnss|signal|available)|no|none|false|void|bad|lost|"
    r"searching|acquiring|insufficient.*|cold_start"
)
_FIX = (
    r".*(?:[23]d|fix|rtk|float|single|ppp|sbas|gps|gnss|valid|active|ok|good|true|yes|int|computed|auto|alone|"
    r"available|psr).*"
)
# Words that mean a fix, and that only a receiver uses
_SURE_FIX = r".*(?:[23]d|fix|rtk|float|single|ppp|sbas|psr|valid).*"
# Names of columns that number the sensors, in tables with the rows of several IMUs
_SENSOR_NUMBER = (
    "i|instance|index|id|address|serial|"
    "(?:imu|sensor|device|dev|node|unit)(?:_?(?:id|no|nr|number|index|instance|name))?"
)
_RECEIVER_NUMBER = (
    "i|instance|(?:gps|gnss|receiver|antenna)_?(?:id|no|nr|number|index|instance|name)?|(?:sensor|device)_?id"
)
# For each role: columns that are filled in the rows of a sensor, names of its number, and the name of the sensor
_NUMBERED: dict[str, tuple[tuple[str, ...], str, str]] = {
    "imu": (("ax", "gz"), _SENSOR_NUMBER, "IMU"),
    "gps": (("lat", "x"), _RECEIVER_NUMBER, "receiver"),
}
MAX_SENSORS = 8  # largest number of IMUs in such a table
MIN_CHANGES = 0.1  # smallest fraction of rows whose sensor differs from that of the previous row
MAX_WORDS = 20  # largest number of different words in a column of flags
# Names of columns in which 3 means a fix in three dimensions, and 1 means no fix
_DIMENSIONS = ".*(?:type|mode)"
# largest fraction of the likely fixes that a flag may exclude, unless the positions jump at these fixes
MAX_DROPPED = 0.2
MIN_JUMP_RATIO = 5.0  # smallest ratio of a jump to the 90% quantile of the other steps


def kept_rows(columns: Columns, role: Role) -> Conversion | None:
    """Return the condition of the rows of a role, or None if all rows are read, and possibly a note."""
    found = (_of_first_sensor(columns, role), _with_fix(columns) if role == "gps" else None)
    if not (kept := [one for one in found if one is not None]):
        return None
    texts, notes = (
        filter(None, parts) for parts in zip(*((k.expression, k.note) for k in kept), strict=True)
    )
    return Conversion(" and ".join(texts), "; ".join(notes))


def _of_first_sensor(columns: Columns, role: Role) -> Conversion | None:
    """Return the condition of the rows of the first sensor if the rows of several sensors alternate in a table."""
    if role not in _NUMBERED:
        return None
    keys, numbers, several = _NUMBERED[role]
    axes = [name.column for what, name in columns.names.items() if what in keys]
    rows = columns.frame.drop_nulls(axes)
    for name in read_names(rows.columns) if axes else ():
        cells, column = rows[name.column], quoted_column(name.column)
        if not name.is_one(numbers) or not (cells.dtype.is_integer() or cells.dtype == pl.String):
            continue
        cells = cells.drop_nulls()
        sensors = [repr(v) for v in cells.unique().sort()]
        alternate = (cells != cells.shift()).sum() >= MIN_CHANGES * len(cells)
        if (
            2 <= len(sensors) <= MAX_SENSORS
            and alternate
            and all(re.fullmatch(r"\w+|'[\w .:-]*'", s) for s in sensors)
        ):
            one, another = (f"{column} == {sensor}" for sensor in sensors[:2])
            note = f"the rows of several {several}s alternate, and those with {one} are read"
            return Conversion(one, f'{note}; for another {several} write --map "{role}.keep={another}"')
    return None


def _with_fix(columns: Columns) -> Conversion | None:
    """Find a column that flags rows without a fix. Return the expression for rows with a fix, or only a note.

    The result is a note if the expression would exclude many likely fixes, since 0 is a fix without fixed ambiguities
    in some codes.
    """
    both = ("lat", "lon") if columns.has("lat", "lon") else ("x", "y")
    text = _fix_stated(columns.frame) if columns.has(*both) else ""
    names = [columns.names[what].column for what in both if what in columns]
    if not text or any(columns.frame.schema[n].is_nested() for n in names):
        return None
    rows = columns.frame.with_columns(pl.selectors.float().fill_nan(None)).drop_nulls(names)
    numbers = [pl.col(n).cast(pl.Float64, strict=False) for n in names]
    unset = [is_placeholder(number) | (number == 0) for number in numbers]
    repeated = [pl.col(n) == pl.col(n).shift() for n in names]
    fixes = rows.filter(~(pl.all_horizontal(unset) | pl.all_horizontal(repeated)).fill_null(value=False))
    kept = fixes.select(compile_expression(text, fixes.columns).truth.fill_null(value=False)).to_series()
    if not kept.any():
        return None
    if kept.sum() >= (1 - MAX_DROPPED) * len(fixes) or _jump(fixes.select(names), kept):
        return Conversion(text)
    seen = (
        f"{(~kept).sum()} of {len(fixes)} fixes are used, although the condition {text} is not true for them"
    )
    return Conversion("", note=f'{seen}; to omit these fixes, write --map "gps.keep={text}"')


def _jump(places: pl.DataFrame, kept: pl.Series) -> bool:
    """Return True if positions jump at the rows that a flag excludes, or between these rows."""

    def squares(rows: pl.DataFrame) -> pl.Series:
        east, north = (column.cast(pl.Float64, strict=False).diff().pow(2) for column in rows)
        return east + north

    usual, before, steps = squares(places.filter(kept)).quantile(0.9), kept.shift(), squares(places)
    jump = max(median_of(steps.filter(kept != before)), median_of(steps.filter(~kept & ~before)))
    return usual is not None and jump > MIN_JUMP_RATIO**2 * usual


def _fix_stated(frame: pl.DataFrame) -> str:
    """Return the condition that a row has a fix, from a column of flags in words or numbers; "" without such flags."""
    names = read_names(frame.columns)
    for name in names:
        cells, column = frame[name.column], quoted_column(name.column)
        if cells.dtype != pl.String or cells.n_unique() > MAX_WORDS:
            continue
        texts: list[str] = [text for text in cells.unique(maintain_order=True) if text and "'" not in text]
        words = {text: "_".join(plain_words(text)) for text in texts}
        none = [text for text, word in words.items() if re.fullmatch(_NO_FIX, word)]
        if {*texts} == {"A", "V"}:  # as in RMC: active, void
            none = ["V"]
        elif not name.is_one(_STATUS) or not any(
            re.fullmatch(_SURE_FIX if name.is_one(_PILOT) else _FIX, words[t]) for t in texts if t not in none
        ):
            continue
        if none or (name.is_one(_FIXED) and cells.fill_null("").eq("").any()):
            return " and ".join(f"{column} != '{text}'" for text in none or [""])
    flag = next((n for pattern in (_FIXED, _SATELLITES) for n in names if n.is_one(pattern)), None)
    kinds = sorted({*column_numbers(frame[flag.column])}) if flag else []
    if flag is None or not kinds:
        return ""
    none = (
        1 if kinds[-1] == 3 and flag.is_one(_DIMENSIONS) else kinds[0] if kinds[0] in (-1, 0) else -math.inf
    )
    return f"{quoted_column(flag.column)} > {none:g}" if kinds[0] <= none < kinds[-1] else ""
