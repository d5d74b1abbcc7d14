"""Find the columns with the time of a table, and the expression of the time in seconds."""

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import polars as pl

from sigmaswarm.importing.dates import (
    EXCEL_EPOCH,
    JULIAN_EPOCH,
    MATLAB_EPOCH,
    as_text,
    parse_dates,
    parse_durations,
)
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
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.units import PARTS_OF_SECONDS, SECONDS, in_si, scaled
from sigmaswarm.wording import printable, quoted

# Largest plausible sample interval, s
MAX_STEP: dict[Role, float] = {"imu": 0.5, "gps": 15.0, "truth": 15.0, "odometer": 5.0, "mag": 5.0}
MIN_STEP = 1e-4  # s, shortest sample interval of a car's sensor
MIN_FIX_INTERVAL = 0.04  # s, shortest usual interval of fixes
# s, intervals of an IMU outside which the unit of its time is not guessed
FASTEST_IMU, SLOWEST_IMU = 4e-4, 0.15
# Fraction of decreasing steps above which rows are unordered; a counter that wraps has fewer decreasing steps
MAX_DECREASING_SHARE = 0.4
# Rows arrive in bursts (of up to 30) if the ratio of the quantile BURST_QUANTILE of the steps to their median exceeds
# MIN_BURST_RATIO. Pauses are too rare to change this quantile.
BURST_QUANTILE, MIN_BURST_RATIO = 0.967, 10.0
MIN_BURST_STEPS = 30  # smallest number of steps for this test
# Smallest step of whole numbers that are read as ms; smaller steps may be row numbers, or 0.01 s
MIN_COUNT_STEP = 4
_DAYS_FIRST = (
    *("%d-%b-%Y", "%d-%b-%y", "%d %b %Y", "%Y/%m/%d", "%d.%m.%Y", "%d.%m.%y"),
    *("%m/%d/%Y", "%d/%m/%Y", "%m/%d/%y", "%d/%m/%y", "%y/%m/%d"),
)
# In the order of trial; the first is ISO 8601
DATE_FORMATS = (
    "",
    *(f"{day} %H:%M:%S%.f" for day in _DAYS_FIRST),
    "%a %b %d %H:%M:%S%.f %Y",
    *(f"{day} %I:%M:%S%.f %p" for day in ("%m/%d/%Y", "%d/%m/%Y", "%Y-%m-%d")),
    "%Y-%m-%d %H:%M:%S:%3f",
    *("%Y-%m-%d_%H-%M-%S%.f", "%Y-%m-%d %H-%M-%S%.f", "%Y%m%d %H%M%S%.f", "%Y%m%d %H:%M:%S%.f"),
    *("%Y%m%d%H%M%S", "%Y%m%d%H%M%S%3f"),
    *("%H:%M:%S%.f", "%H:%M:%S:%3f", "%I:%M:%S%.f %p", "%M:%S%.f"),
)
# Smallest fraction of dates that must fit a format; the others are presumably damaged
MIN_FITTING_SHARE = 0.99
FORMAT_SAMPLE = 50  # number of evenly spaced texts; a format that reads none of them is excluded
UNKNOWN_TICK = "have no likely unit"  # in the fault of a counter
COUNTER_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
CALENDAR = ("year", "month", "day", "hour", "minute", "second")
# Last words of the names of the six columns of a date
_CALENDAR = {
    **{word: word for word in CALENDAR},
    **{"mon": "month", "hr": "hour", "min": "minute", "sec": "second"},
}
# Units of times, s; those of clock counters come first
UNITS = {**COUNTER_UNITS, "days": 86400.0, "h": 3600.0, "min": 60.0}
# Ranges of counts that do not begin in 1970, with the count of 1970-01-01, the unit in s, and a description
_EPOCHS = (
    (2e4, 8e4, EXCEL_EPOCH, 86400, "days since 1900"),
    (6.5e5, 8e5, MATLAB_EPOCH, 86400, "days since year 0"),
    (2.44e6, 2.5e6, JULIAN_EPOCH, 86400, "days since 4713 BC"),
    (6.2e17, 6.6e17, 621_355_968_000_000_000, 1e-7, "ticks of 100 ns since year 1"),
    (1.26e17, 1.4e17, 116_444_736_000_000_000, 1e-7, "ticks of 100 ns since 1601"),
)
# Last words of the names of the upper and lower 32 bits of a time
_HIGH, _LOW = (
    (*map(tuple, zip(words.split())),) for words in ("hi high upper msb msw h", "lo low lower lsb lsw l")
)
WORD = 2**32
_DATES_S = (3e8, 4e9)  # range of dates, s since 1970: 1979 to 2096


@dataclass(frozen=True)
class TimeExpression:
    """Expression of a time, or of another column of a drive."""

    expression: str
    note: str = ""  # an assumption
    fault: str = ""  # reason not to use the expression
    ticks: str = ""  # text of a counter whose unit is guessed from its steps


def scaled_column(text: str) -> tuple[str, float] | None:
    """Return the column of an expression ``column``, ``column*number`` or ``column/number``, and the factor."""
    plain = re.fullmatch(r"\s*(`[^`]+`|[A-Za-z_]\w*)\s*(?:\*\s*([\d.eE+-]+)|/\s*([\d.eE+-]+))?\s*", text)
    try:
        return plain and (plain[1], float(plain[2] or 1.0) / float(plain[3] or 1.0))
    except (ValueError, ZeroDivisionError):
        return None


def find_time(frame: pl.DataFrame, role: Role) -> TimeExpression | None:
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
) -> TimeExpression | None:
    """Find the time of a role in a table whose rows contain only some of the sensors.

    ``keys``: a column that is filled in the rows of each role; ``rows_of``: role whose usual rate determines the unit.
    Header stamps have priority over a clock that is filled in the rows of all roles, if each role has one. Tables that
    were pasted side by side have different numbers of rows, so each has its own time.
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
    """Return the columns of each table that was pasted next to others, by number of rows; {} for other tables.

    Such a table fills the first rows of its columns, and has its own time column. ``keys``: a column of each role.
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


def quoted_column(column: str) -> str:
    """Return the name of a column as it is written in an expression."""
    return column if re.fullmatch(r"[A-Za-z_]\w*", column) else f"`{column}`"


def column_numbers(values: pl.Series) -> pl.Series:
    """Return the numbers among the values of a column; empty for lists and bytes."""
    if values.dtype.is_nested() or isinstance(values.dtype, pl.Binary | pl.Object):
        return pl.Series([], dtype=pl.Float64)
    if values.dtype == pl.String:
        values = values.str.strip_chars()
    return values.cast(pl.Float64, strict=False).drop_nulls().drop_nans()


def median_of(values: pl.Series) -> float:
    return float(values.median() or 0.0)  # pyright: ignore[reportArgumentType]


def step_of(values: pl.Series) -> float:
    """Return the median forward step of a time, or the mean step if rows arrive in bursts.

    Rows with the same stamp count as one.
    """
    steps = column_numbers(values).diff().drop_nulls()
    if (steps < 0).sum() > MAX_DECREASING_SHARE * len(steps):
        steps = column_numbers(values).sort().diff().drop_nulls()
    forward = steps.filter(steps > 0)
    shared = len(forward) / (len(forward) + int((steps == 0).sum())) if len(forward) else 1.0
    usual, long = median_of(forward), float(forward.quantile(BURST_QUANTILE) or 0.0)
    if len(forward) > MIN_BURST_STEPS and long > MIN_BURST_RATIO * usual:
        usual = float(forward.filter(forward <= 2 * long).mean())  # pyright: ignore[reportArgumentType]
    return usual * (shared if shared < 0.9 else 1.0)


def _header_stamp(names: Sequence[Name], frame: pl.DataFrame, role: Role) -> TimeExpression | None:
    """Find the stamp in a message's header; it takes precedence over the receive time."""
    stamp = next((n for n in names if n.is_one(STAMP)), None)
    if stamp is None or not (column_numbers(frame[stamp.column]) > 0).any():
        return None
    return column_time(stamp, frame, role)


def _calendar(names: Sequence[Name], frame: pl.DataFrame) -> tuple[TimeExpression | None, Sequence[Name]]:
    """Find a date in six columns (year to second) and fractions in others; return the date and the used names."""
    parts = {**PARTS_OF_SECONDS, "milli": 1e-3, "micro": 1e-6, "nano": 1e-9}
    for begin in dict.fromkeys(name.words[:-1] for name in names):
        alike = {n.words[-1]: n for n in names if n.words and n.words[:-1] == begin}
        found = {_CALENDAR[word]: n for word, n in reversed(alike.items()) if word in _CALENDAR}
        if found.keys() != {*CALENDAR}:
            continue
        columns = [found[part].column for part in CALENDAR]
        year = "%Y" if median_of(column_numbers(frame[columns[0]])) > 99 else "%y"
        form = f"{year} %m %d %H %M %S%.f"
        dates = frame.select(parse_dates(as_text(columns), form).alias("date"))["date"]
        rest = [(n, parts[word]) for word, n in alike.items() if word in parts]
        most = sum(scale * float(column_numbers(frame[n.column]).max() or 0) for n, scale in rest)  # pyright: ignore
        if dates.null_count() > 0.1 * len(dates) or most > 1:
            continue
        text = f"utc({', '.join(map(quoted_column, columns))}, '{form}')"
        text += "".join(f" + {scaled(quoted_column(n.column), scale)}" for n, scale in rest)
        note = "the time is computed from the columns of year, month, day, hour, minute and second"
        return TimeExpression(text, note), [*found.values(), *(n for n, _ in rest)]
    return None, ()


def _seconds_and_rest(names: Sequence[Name], frame: pl.DataFrame) -> TimeExpression | None:
    """Find whole seconds in one column, and fractions in another whose name begins in the same way."""
    pairs = [
        (first, rest, PARTS_OF_SECONDS[rest.words[-1]])
        for first in names
        if first.words and first.words[-1] in SECONDS
        for rest in names
        if rest.words and rest.words[:-1] == first.words[:-1] and rest.words[-1] in PARTS_OF_SECONDS
    ]
    for first, rest, scale in sorted(pairs, key=lambda p: "stamp" not in p[0].words):
        whole, part = column_numbers(frame[first.column]), column_numbers(frame[rest.column])
        fits = (whole == whole.round()).all() and part.is_between(0, 1 / scale - 0.5).all()
        falls = rest.words[-1] != "ms" or (part.diff() < 0).any()  # otherwise ms may be the whole time
        if len(whole) and len(part) and fits and falls:
            text = f"{quoted_column(first.column)} + {scaled(quoted_column(rest.column), scale)}"
            return TimeExpression(text, f"the time is the sum of {first.column} and {rest.column}")
    return None


def _words(names: Sequence[Name], frame: pl.DataFrame, role: Role) -> TimeExpression | None:
    """Find a 64-bit time that is split into two 32-bit columns: time_hi and time_lo."""
    for high, low in product(names, names):
        known = is_time("_".join(high.words[:-1])) and high.words[:-1] == low.words[:-1]
        if not known or high.words[-1:] not in _HIGH or low.words[-1:] not in _LOW:
            continue
        values = [frame[n.column].cast(pl.Float64, strict=False) for n in (high, low)]
        first, second = (quoted_column(n.column) for n in (high, low))
        if (values[1] < 0).any():  # signed numbers
            second = f"where({second} < 0, {second} + {WORD}, {second})"
        both = values[0] * WORD + values[1].set(values[1] < 0, None).fill_null(values[1] + WORD)
        found = _of_numbers(both, f"({first}*{WORD} + {second})", role)
        note = f"the time is {high.column} and {low.column}, two 32-bit words"
        return found if found.fault else TimeExpression(found.expression, note)
    return None


def _week(names: Sequence[Name], frame: pl.DataFrame) -> TimeExpression | None:
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
    return TimeExpression(
        f"gps_time({quoted_column(week.column)}, {seconds})", "GPS week and time of week are converted to UTC"
    )


def _dates_and_times(names: Sequence[Name], frame: pl.DataFrame) -> list[tuple[Name, bool, TimeExpression]]:
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


def _single(names: Sequence[Name], frame: pl.DataFrame, role: Role) -> TimeExpression | None:
    """Find a column that is named like a time and is not always 0, preferably a changing one; else a running clock."""
    times = [
        n for n in names if n.meaning == "t" and not (n.unit and n.unit.dimension == "speed")
    ]  # Tempo [km/h]
    for name in sorted(times, key=lambda name: frame[name.column].n_unique() < 2):
        numbers = column_numbers(frame[name.column])
        if not (len(numbers) > 1 and (numbers == 0).all()):
            return column_time(name, frame, role)
    clocks = [
        n for n in names if n.is_one(CLOCK) and (step_of(frame[n.column]) > 0 or _of_words(frame[n.column]))
    ]
    # ticks have no known unit
    running = max(clocks, key=lambda n: (not n.is_one("ticks?"), frame[n.column].n_unique()), default=None)
    dated = [n for n in names if isinstance(frame.schema[n.column], pl.Datetime)]
    if running is None and (len(dated) == 1 or (names and _is_index(names[0], frame))):
        running = dated[0] if len(dated) == 1 else names[0]
    return None if running is None else column_time(running, frame, role)


def _is_index(name: Name, frame: pl.DataFrame) -> bool:
    """Return True for an unnamed first column with dates or increasing times, such as an index written by pandas."""
    if name.column != "c1" or frame.columns[1:2] == ["c2"]:
        return False
    numbers = column_numbers(frame[name.column])
    rises = len(numbers) > 1 and (numbers.diff().drop_nulls() > 0).all()
    return _of_words(frame[name.column]) or bool(rises and (numbers != numbers.round()).any())


def _of_words(values: pl.Series) -> bool:
    """Return True for texts that are not numbers, such as dates."""
    return (
        values.dtype == pl.String and not len(column_numbers(values)) and bool(values.str.len_chars().max())
    )


def column_time(name: Name, frame: pl.DataFrame, role: Role) -> TimeExpression:
    """Read the time in one column: dates in text, or numbers, by the unit in the name or by their size and steps."""
    values, text = frame[name.column], quoted_column(name.column)
    if _of_words(values):
        return date_time([name.column], frame)
    if values.dtype.is_temporal():
        return TimeExpression(text)
    if name.is_one("sample_?time_?fine"):
        if step_of(values) * 1e-4 > SLOWEST_IMU:
            return TimeExpression(f"{text}*1e-6", f"{name.column} is read as us, as in logs of Movella DOT")
        return TimeExpression(
            f"{text}*1e-4", f"{name.column} is read as ticks of 0.1 ms, as in logs of Xsens"
        )
    if values.dtype.is_integer() and median_of(values) > 19e12:  # perhaps the digits of a date
        digits = date_time([name.column], frame.select(pl.col(name.column).cast(pl.String)))
        if not digits.fault:
            return digits
    if name.unit is None:
        return _of_numbers(values, text, role)
    if name.unit.dimension == "time":
        return TimeExpression(in_si(name.unit, text))
    return TimeExpression("", fault=unknown_unit(name, "t", "time", role))


def unknown_unit(name: Name, column: str, dimension: str, role: Role, likely: str = "") -> str:
    """Describe an unknown or wrong unit; ``likely``: the likely expression in SI units, for the remedy."""
    known = name.unit is not None and name.unit.known
    kind = f"a unit of {name.unit.dimension}, not of {dimension}" if name.unit and known else "not known"
    message = (
        f"column {quoted(name.column)}: the unit {quoted(name.unit.text if name.unit else '')} is {kind}"
    )
    text = likely or f"{quoted_column(name.column)}*1.0"
    if known and column in ("x", "y") and name.unit and name.unit.dimension == "angle" and role != "imu":
        place, called = {"x": ("lon", "longitude"), "y": ("lat", "latitude")}[column]
        degrees = scaled(quoted_column(name.column), name.unit.factor * 180 / math.pi)
        return f'{message}; if it is a {called}, write --map "{role}.{place}={degrees}" "{role}.{column}="'
    if name.unit and name.unit.dimension == "angle" and dimension == "rate":
        text = in_si(name.unit, quoted_column(name.column))
    message += "; specify the factor to SI units, for example --map"
    if name.unit and dimension == "rate" and re.match(r"(?i)gr(?:ad[es]?)?(?![a-z])", name.unit.text.strip()):
        plain = quoted_column(name.column)
        degrees, gradians = (f'"{role}.{column}={t}"' for t in (f"radians({plain})", f"{plain}*pi/200"))
        return f"{message} {degrees} if it is degrees per second, or --map {gradians} if it is gradians per second"
    return f'{message} "{role}.{column}={text}"'


def date_time(columns: Sequence[str], frame: pl.DataFrame) -> TimeExpression:
    """Read dates in text by the format that fits most of them; refuse texts that fit two formats, or no format well."""
    texts = frame.select(as_text(columns).alias("date"))["date"].drop_nulls()
    texts = texts.filter(texts.str.contains(r"\d")).unique(maintain_order=True)  # a placeholder counts once
    sample = texts.gather_every(max(len(texts) // FORMAT_SAMPLE, 1))
    likely = [form for form, count in _fitting_counts(sample, DATE_FORMATS).items() if count]
    read = _fitting_counts(texts, likely or DATE_FORMATS)
    most = max(read.values())
    fitting = [
        form for form in sorted(read, key=lambda f: -read[f]) if read[form] >= MIN_FITTING_SHARE * most > 0
    ]
    called = ", ".join(map(quoted_column, columns))
    if len(columns) == 1 and most < MIN_FITTING_SHARE * len(texts):
        durations = texts.to_frame("date").select(parse_durations(pl.col("date"))).to_series().count()
        if durations >= MIN_FITTING_SHARE * len(texts):
            return TimeExpression(f"duration({called})", "times are read as durations")
    if not fitting:
        message = f"{quoted(texts[0])} is not a date of a known format" if len(texts) else "contains no dates"
        option = (
            f"--time \"utc({called}, '%d.%m.%Y %H:%M:%S%.f')\" with its format, or write the times as numbers"
        )
        return TimeExpression("", fault=f"column {quoted(columns[0])}: {message}; write {option}")
    form = fitting[0]
    if most < MIN_FITTING_SHARE * len(texts):
        left = texts.to_frame("date").filter(_date_in(form).is_null()).item(0, 0)
        whole = f"utc({called}, '{form}')" if form else f"utc({called})"
        message = (
            f"column {quoted(columns[0])}: {quoted(left)} has a format different from that of {most} of "
            f"{len(texts)} texts"
        )
        return TimeExpression(
            "", fault=f'{message}; correct rows like this, or leave them out with --time "{whole}"'
        )
    orders = [(word, f) for word in ("day", "month", "year") for f in fitting if f.startswith(f"%{word[0]}/")]
    if len(orders) > 1:
        options = (f"--time \"utc({called}, '{f}')\" if the {word} comes first" for word, f in orders)
        message = f"{printable(texts[0])} may be two different days"
        return TimeExpression(
            "", fault=f"column {quoted(columns[0])}: {message}; write {' or '.join(options)}"
        )
    note = "" if not form or "%d" in form else f"{called}: the times of day have no date"
    return TimeExpression(f"utc({called}, '{form}')" if form else f"utc({called})", note)


def _fitting_counts(texts: pl.Series, forms: Iterable[str]) -> dict[str, int]:
    """Return the number of texts that each format reads."""
    counts = (_date_in(form).count().alias(form) for form in forms)
    return texts.to_frame("date").select(counts).row(0, named=True)


def _date_in(form: str) -> pl.Expr:
    """Return an expression that parses the column ``date`` with the format ``form``, s; null for other texts."""
    dates = pl.col("date")
    return parse_dates(dates if form else pl.when(dates.str.contains(r"^\d{4}-\d")).then(dates), form)


def _of_numbers(values: pl.Series, text: str, role: Role) -> TimeExpression:
    """Read numbers without a unit: by their size if they count from a known epoch, otherwise by plausible steps."""
    numbers = column_numbers(values)
    size, step = median_of(numbers.abs()), step_of(values)
    column = text.strip("`")
    for begin, end, epoch, scale, what in _EPOCHS:
        if begin < size < end and MIN_STEP < step * scale < 4 * MAX_STEP[role]:
            return TimeExpression(f"({text} - {epoch})*{scale:g}", f"{column} is read as {what}")
    dated = [unit for unit, scale in COUNTER_UNITS.items() if _DATES_S[0] < size * scale < _DATES_S[1]]
    dated = [unit for unit in dated if unit != "s" or step == 0 or step < MAX_STEP[role]]
    if not dated and 0 < step < (FASTEST_IMU if role == "imu" else MIN_STEP / 2):
        return _too_short(numbers, text, column, step, role)
    likely = [unit for unit, scale in COUNTER_UNITS.items() if step * scale < MAX_STEP[role]]
    unit = (*dated, *likely, "s")[0]
    if role == "imu" and not dated and unit == "ms" and step < MIN_COUNT_STEP:
        rates = ", ".join(f'"{text}*1e-{k}" for {10**k / step:.4g} Hz' for k in (3, 2))
        message = f"column {quoted(column)}: steps of {step:g} may be ms, hundredths of a second, or rows"
        return TimeExpression(
            "", fault=f'{message}; specify the unit with --time: {rates}, or "{text}/100" for 100 rows per s'
        )
    if role == "imu" and not dated and unit != "s" and step * COUNTER_UNITS[unit] > SLOWEST_IMU:
        rates = ", ".join(
            f'"{scaled(text, COUNTER_UNITS[u])}" for {1 / (step * COUNTER_UNITS[u]):.4g} Hz'
            for u in ("ms", "us")
        )
        message = f"column {quoted(column)}: steps of {step:g} {UNKNOWN_TICK}"
        return TimeExpression(
            "",
            fault=f'{message}; specify the unit with --time: {rates}, "{text}*1e-4" for ticks of 0.1 ms, or the '
            f'rate of the counter, for example "{text}/32768" for 32,768 ticks per s',
            ticks=text,
        )
    if unit == "s":
        return TimeExpression(text)
    note, ticks = f"the times in {column} are read as {unit}", "" if dated else text
    return TimeExpression(scaled(text, UNITS[unit]), note, ticks=ticks)


def _too_short(numbers: pl.Series, text: str, column: str, step: float, role: Role) -> TimeExpression:
    """Read numbers as fractions of a day, or refuse them, since their steps are too short for seconds."""
    if MIN_STEP < step * 86400 < 4 * MAX_STEP[role] and numbers.is_between(1e-3, 1).all():
        return TimeExpression(f"{text}*86400", f"{column} is read as days (fractions of a day)")
    message = f'--time "{text}*86400" for days, *3600 for hours, *60 for minutes, *1 for seconds'
    seen = f"column {quoted(column)}: steps of {step:.2g} are too short for seconds"
    return TimeExpression("", fault=f"{seen}; specify the unit: {message}")


def of_one_table(message: str, role: Role) -> str:
    """Replace --time in the remedy of a log with several tables, since --time applies to all tables."""
    option = f'--map "{role}.t='
    return message.replace('--time "', option).replace("--time:", f'{option}EXPRESSION":')


def wrong_unit(text: str, rows: pl.DataFrame, role: Role) -> str:
    """Describe the wrong unit of a time ``column`` or ``column*number``, with the remedy; otherwise return "".

    The unit is wrong if no sensor has such steps and another unit makes them plausible.
    """
    column, scale = scaled_column(text) or ("", 1.0)
    name = column.strip("`")
    if name not in rows.columns or not rows[name].dtype.is_numeric():
        return ""
    step, size, longest = step_of(rows[name]), median_of(column_numbers(rows[name]).abs()), 4 * MAX_STEP[role]
    likely = [(u, f) for u, f in UNITS.items() if MIN_STEP < step * f < longest]
    if not step or MIN_STEP < step * scale < longest or not likely:
        return ""
    low, high = (FASTEST_IMU, SLOWEST_IMU) if role == "imu" else (MIN_FIX_INTERVAL, longest)
    unit, factor = min(
        likely, key=lambda u: (not _DATES_S[0] < size * u[1] < _DATES_S[1], not low < step * u[1] < high)
    )
    times = "" if factor == 1 else f"*{factor:g}".replace("e-0", "e-")
    option = '--time "' if role == "imu" else f'--map {role}.t="'
    return (
        f"with {text} in s, rows of the {role} would be {step * scale:.4g} s apart, and in {unit} "
        f'{step * factor:.4g} s apart; write {option}{column}{times}"'
    )
