"""Find the columns with the time of a table."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import product

import polars as pl

from sigmaswarm.importing.dates import SECOND, as_text, parse_dates
from sigmaswarm.importing.expressions import ROW, compile_expression, row_times, time_span, with_row_numbers
from sigmaswarm.importing.names import (
    CLOCK,
    STAMP,
    TIME_OF_WEEK,
    WEEK,
    Name,
    is_time,
    read_names,
    split_words,
)
from sigmaswarm.importing.source import Log, Role
from sigmaswarm.importing.table_columns import Conversion, column_numbers, median_of, quoted_column
from sigmaswarm.importing.time_units import (
    COUNTER_UNITS,
    column_time,
    date_time,
    has_words,
    step_of,
    time_of_numbers,
)
from sigmaswarm.importing.units import PARTS_OF_SECONDS, SECONDS, in_si, scaled

CALENDAR = ("year", "month", "day", "hour", "minute", "second")
# Last words of the names of the six columns of a date
_CALENDAR = {
    **{word: word for word in CALENDAR},
    **{"mon": "month", "hr": "hour", "min": "minute", "sec": "second"},
}
# Last words of the names of the upper and lower 32 bits of a time
_HIGH, _LOW = (
    (*map(tuple, zip(words.split())),) for words in ("hi high upper msb msw h", "lo low lower lsb lsw l")
)
WORD = 2**32
EVER = (-math.inf, math.inf)  # span of a table without times, s


def find_time(frame: pl.DataFrame, role: Role) -> Conversion | None:
    names = read_names(frame.columns)
    several = _seconds_and_rest(names, frame) or _words(names, frame, role)
    several = several or _header_stamp(names, frame, role) or _week(names, frame)
    pairs = [] if several else _dates_and_times(names, frame)
    good = [pair for pair in pairs if not pair[2].fault]
    if several or (good and good[0][1]):
        return several or good[0][2]
    calendar, parts = _calendar(names, frame)
    parts = [*parts, *(clock for clock, *_ in pairs)]  # a time of day without its day
    single = _single([n for n in names if n not in parts], frame, role) or calendar
    lacking = single is None or single.fault
    usable = [found for _, known, found in (*good, *pairs) if known or (lacking and not found.fault)]
    if usable and (lacking or not usable[0].fault):
        return usable[0]
    return single or (pairs[0][2] if pairs else None)


def time_of_rows(
    frame: pl.DataFrame, role: Role, keys: Mapping[Role, str], rows_of: Role
) -> Conversion | None:
    """Find the time of a role in a table whose rows contain only some of the sensors.

    ``keys`` is a column that is filled in the rows of each role. The unit is chosen by the usual rate of the role
    ``rows_of``. Header stamps have priority over a clock that is filled in the rows of all roles, if each role has one.
    Tables that were pasted side by side have different numbers of rows, so each has its own time.
    """
    known = frame.with_columns(pl.selectors.float().fill_nan(None))
    if role in keys and (pasted := _pasted(known, keys.values())):
        return find_time(frame.select(pasted[known[keys[role]].count()]), role)
    rows = {of: some for of, key in keys.items() if len(some := known.drop_nulls(key))}
    filled = {
        of: [c for c in some.columns if 2 * some[c].null_count() <= len(some)] for of, some in rows.items()
    }
    own = filled.get(role, frame.columns)
    common = [c for c in own if all(c in columns for columns in filled.values())]
    stamped = (
        any(name.is_one(STAMP) and name.column not in common for name in read_names(columns))
        for columns in filled.values()
    )
    found = None if filled and all(stamped) else find_time(frame.select(common), rows_of)
    return found or find_time(rows[role].select(own) if role in rows else frame, role)


def _pasted(frame: pl.DataFrame, keys: Collection[str]) -> dict[int, list[str]]:
    """Find tables that were pasted next to each other: return the columns of each by its number of rows; otherwise {}.

    Such a table fills the first rows of its columns, and has its own time column. ``keys`` contains a column of each
    role.
    """
    counts = {name: frame[name].count() for name in frame.columns}
    tables = {counts[key]: [n for n, count in counts.items() if count == counts[key]] for key in keys}
    if len(tables) < 2 or 0 in tables or any(frame[key].head(counts[key]).null_count() for key in keys):
        return {}
    timed = all(find_time(frame.select(names).head(rows), "gps") for rows, names in tables.items())
    return tables if timed else {}


def time_of(frame: pl.DataFrame, role: Role = "imu") -> str | None:
    found = find_time(frame, role)
    return found.expression or None if found else None


def sample_rate(frame: pl.DataFrame, time: str | None) -> float | None:
    """Return the rate, Hz, from the median step of ``time`` or of a recognized time, or None if there is no time."""
    if len(frame) < 2 or (time := time or time_of(frame)) is None:
        return None
    steps = row_times(time, frame).diff().drop_nulls()
    step = steps.filter(steps > 0).median()
    return SECOND / step if isinstance(step, int | float) and step > 0 else None


def span_of_table(log: Log, table: str, time: str) -> tuple[float, float]:
    """Return the earliest and the latest time of a whole table, s; `EVER` if the times of some rows can't be read."""
    columns = log.tables[table].columns
    used = compile_expression(time, (*columns, ROW)).columns & {*columns}
    spans, first = list[tuple[float, float]](), 0
    for _, rows, _ in log.batches({table: used or columns}):
        spans.append(time_span(time, with_row_numbers(rows, first)) or EVER)
        first += len(rows)
    return min((low for low, _ in spans), default=EVER[0]), max((high for _, high in spans), default=EVER[1])


def rising_time(frame: pl.DataFrame, role: Role) -> str:
    """Return the time, s, as an expression of the first increasing column without a known name; otherwise "".

    A counter may wrap. A counter of rows, which increases by 1, is not a time.
    """
    names = [name for name in read_names(frame.columns) if name.meaning is None]
    steps = [column_numbers(frame[name.column]).diff().drop_nulls() for name in names]
    for falls in (0.0, 0.01):
        for name, of in zip(names, steps, strict=True):
            if len(of) and (of <= 0).sum() <= falls * len(of) and not (of == 1).all():
                return column_time(name, frame, role).expression or quoted_column(name.column)
    return ""


def _header_stamp(names: Sequence[Name], frame: pl.DataFrame, role: Role) -> Conversion | None:
    """Find the stamp in a message's header; it takes precedence over the receive time."""
    stamp = next((n for n in names if n.is_one(STAMP)), None)
    if stamp is None or not (column_numbers(frame[stamp.column]) > 0).any():
        return None
    return column_time(stamp, frame, role)


def _calendar(names: Sequence[Name], frame: pl.DataFrame) -> tuple[Conversion | None, Sequence[Name]]:
    """Find a date in six columns (year to second) and fractions in others. Return the date and the used names."""
    parts = {**PARTS_OF_SECONDS, "milli": 1e-3, "micro": 1e-6, "nano": 1e-9}
    for begin in dict.fromkeys(name.words[:-1] for name in names):
        alike = {n.words[-1]: n for n in names if n.words and n.words[:-1] == begin}
        found = {_CALENDAR[word]: n for word, n in reversed(alike.items()) if word in _CALENDAR}
        if found.keys() not in ({*CALENDAR}, {*CALENDAR[3:]}):
            continue
        rest = [(n, parts[word]) for word, n in alike.items() if word in parts]
        more = "".join(f" + {scaled(quoted_column(n.column), scale)}" for n, scale in rest)
        most = sum(scale * float(column_numbers(frame[n.column]).max() or 0) for n, scale in rest)  # pyright: ignore
        if most > 1:  # a counter, not a fraction of a second
            continue
        if found.keys() == {*CALENDAR[3:]}:
            hour, minute, second = (quoted_column(found[part].column) for part in CALENDAR[3:])
            note = "the time is computed from the columns of hour, minute and second"
            return Conversion(f"{hour}*3600 + {minute}*60 + {second}{more}", note), [
                *found.values(),
                *(n for n, _ in rest),
            ]
        columns = [found[part].column for part in CALENDAR]
        year = "%Y" if median_of(column_numbers(frame[columns[0]])) > 99 else "%y"
        form = f"{year} %m %d %H %M %S%.f"
        dates = frame.select(parse_dates(as_text(columns), form).alias("date"))["date"]
        if dates.null_count() > 0.1 * len(dates):
            continue
        text = f"utc({', '.join(map(quoted_column, columns))}, '{form}'){more}"
        note = "the time is computed from the columns of year, month, day, hour, minute and second"
        return Conversion(text, note), [*found.values(), *(n for n, _ in rest)]
    return None, ()


def _seconds_and_rest(names: Sequence[Name], frame: pl.DataFrame) -> Conversion | None:
    """Find whole seconds in one column, and fractions in another whose name begins in the same way."""
    pairs = [
        (first, rest, PARTS_OF_SECONDS[rest.words[-1]])
        for first in names
        if first.words and first.words[-1] in SECONDS
        for rest in names
        if rest.words and rest.words[:-1] == first.words[:-1] and rest.words[-1] in PARTS_OF_SECONDS
    ]
    minutes = {n.words[:-1] for n in names if n.words and _CALENDAR.get(n.words[-1]) == "minute"}
    pairs = [pair for pair in pairs if pair[0].words[:-1] not in minutes]  # see `_calendar`
    for first, rest, scale in sorted(pairs, key=lambda p: "stamp" not in p[0].words):
        whole, part = column_numbers(frame[first.column]), column_numbers(frame[rest.column])
        fits = (whole == whole.round()).all() and part.is_between(0, 1 / scale - 0.5).all()
        falls = rest.words[-1] != "ms" or (part.diff() < 0).any()  # otherwise ms may be the whole time
        if len(whole) and len(part) and fits and falls:
            text = f"{quoted_column(first.column)} + {scaled(quoted_column(rest.column), scale)}"
            return Conversion(text, f"the time is the sum of {first.column} and {rest.column}")
    return None


def _words(names: Sequence[Name], frame: pl.DataFrame, role: Role) -> Conversion | None:
    """Find a 64-bit time that is split into two 32-bit columns, such as time_hi and time_lo."""
    for high, low in product(names, names):
        known = is_time("_".join(high.words[:-1])) and high.words[:-1] == low.words[:-1]
        if not known or high.words[-1:] not in _HIGH or low.words[-1:] not in _LOW:
            continue
        values = [frame[n.column].cast(pl.Float64, strict=False) for n in (high, low)]
        first, second = (quoted_column(n.column) for n in (high, low))
        if (values[1] < 0).any():  # signed numbers
            second = f"where({second} < 0, {second} + {WORD}, {second})"
        both = values[0] * WORD + values[1].set(values[1] < 0, None).fill_null(values[1] + WORD)
        found = time_of_numbers(both, f"({first}*{WORD} + {second})", role)
        note = f"the time is {high.column} and {low.column}, two 32-bit words"
        return found if found.fault else Conversion(found.expression, note)
    return None


def _week(names: Sequence[Name], frame: pl.DataFrame) -> Conversion | None:
    week = next((n for n in names if n.is_one(WEEK)), None)
    tow = next((n for n in names if n.is_one(TIME_OF_WEEK)), None)
    if week is None or tow is None or not len(column_numbers(frame[week.column])):
        return None
    if tow.unit is not None and tow.unit.dimension == "time":
        seconds = in_si(tow.unit, quoted_column(tow.column))
    else:
        largest = float(column_numbers(frame[tow.column]).max() or 0)  # pyright: ignore[reportArgumentType]
        unit = next((u for u, scale in COUNTER_UNITS.items() if largest * scale <= 604_800), "ns")
        seconds = scaled(quoted_column(tow.column), COUNTER_UNITS[unit])
    return Conversion(
        f"gps_time({quoted_column(week.column)}, {seconds})", "GPS week and time of week are converted to UTC"
    )


def _dates_and_times(names: Sequence[Name], frame: pl.DataFrame) -> list[tuple[Name, bool, Conversion]]:
    """Combine a column of days with a text column of times of day (a clock).

    For each pair, return the clock, True if the names are the usual ones, and the time. Clocks with at most half as
    many distinct times as the finest clock come last.
    """
    schema = frame.schema
    texts = [n for n in names if schema[n.column] == pl.String and not len(column_numbers(frame[n.column]))]
    days, clocks = _prefixed(names, "date|day"), _prefixed(texts, "time|time_of_day|clock")
    pairs = [
        (clock, known, day.column)
        for day, of_day in days
        for clock, of_clock in clocks
        for known in [of_day in ("", "utc", "gps")]
        if of_clock == of_day or (known and not of_clock) or (not of_day and of_clock in ("utc", "gps"))
    ]
    finest = max((frame[clock.column].n_unique() for clock, *_ in pairs), default=0)
    pairs.sort(key=lambda pair: (frame[pair[0].column].n_unique() * 2 <= finest, not pair[1]))
    return [(clock, known, date_time([day, clock.column], frame)) for clock, known, day in pairs]


def _prefixed(names: Sequence[Name], words: str) -> list[tuple[Name, str]]:
    """Return the names that end in one of the words, such as utc_date or rtcDate, and the part before the word."""
    found: list[tuple[Name, str]] = []
    for name in names:
        split = "_".join(split_words(name.column))
        fits = [fit for text in (name.plain, split) if (fit := re.fullmatch(f"(?:(.+)_)?(?:{words})", text))]
        found += [(name, fits[0][1] or "")] if fits else []
    return found


def _single(names: Sequence[Name], frame: pl.DataFrame, role: Role) -> Conversion | None:
    """Find a column that is named like a time and is not always 0, preferably a changing one, or a running clock.

    Dates of an unknown format are refused only if no other column is a time.
    """
    times = [
        n for n in names if n.meaning == "t" and not (n.unit and n.unit.dimension == "speed")
    ]  # Tempo [km/h]
    unread: Conversion | None = None
    for name in sorted(times, key=lambda name: frame[name.column].n_unique() < 2):
        numbers = column_numbers(frame[name.column])
        if len(numbers) > 1 and (numbers == 0).all():
            continue
        if not (found := column_time(name, frame, role)).fault or len(numbers):
            return found
        unread = unread or found  # dates of an unknown format
    clocks = [
        n for n in names if n.is_one(CLOCK) and (step_of(frame[n.column]) > 0 or has_words(frame[n.column]))
    ]
    # ticks have no known unit
    running = max(clocks, key=lambda n: (not n.is_one("ticks?"), frame[n.column].n_unique()), default=None)
    dated = [n for n in names if isinstance(frame.schema[n.column], pl.Datetime)]
    if running is None and (len(dated) == 1 or (names and _is_index(names[0], frame))):
        running = dated[0] if len(dated) == 1 else names[0]
    found = None if running is None else column_time(running, frame, role)
    return unread if unread and (found is None or found.fault) else found


def _is_index(name: Name, frame: pl.DataFrame) -> bool:
    """Return True for an unnamed first column with dates or increasing times, such as an index written by pandas."""
    if name.column != "c1" or frame.columns[1:2] == ["c2"]:
        return False
    numbers = column_numbers(frame[name.column])
    rises = len(numbers) > 1 and (numbers.diff().drop_nulls() > 0).all()
    return has_words(frame[name.column]) or bool(rises and (numbers != numbers.round()).any())


def of_one_table(message: str, role: Role) -> str:
    """Replace --time in the remedy of a log with several tables, since --time applies to all tables."""
    option = f'--map "{role}.t='
    return message.replace('--time "', option).replace("--time:", f'{option}EXPRESSION":')
