"""Convert the time in one column to seconds: the formats of dates, and the units of numbers."""

import re
from collections.abc import Iterable, Sequence

import polars as pl

from sigmaswarm.importing.dates import (
    EXCEL_EPOCH,
    JULIAN_EPOCH,
    MATLAB_EPOCH,
    as_text,
    parse_dates,
    parse_durations,
)
from sigmaswarm.importing.names import Name
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.table_columns import (
    Conversion,
    column_numbers,
    median_of,
    quoted_column,
    refused,
    scaled_column,
    unknown_unit,
)
from sigmaswarm.importing.units import in_si, scaled
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
# Order of day and month in the name of a column
_ORDER = re.compile(r"(?<![a-z])(?:(d)d?\W?mm?|(m)m?\W?dd?)\W?y{1,4}(?![a-z])", re.IGNORECASE)
# Smallest fraction of dates that must fit a format; the others are presumably damaged
MIN_FITTING_SHARE = 0.99
FORMAT_SAMPLE = 50  # number of evenly spaced texts; a format that reads none of them is excluded
UNKNOWN_TICK = "no unit of time fits steps of"  # part of the message about a counter
COUNTER_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
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
_DATES_S = (3e8, 4e9)  # range of dates, s since 1970: 1979 to 2096


def step_of(values: pl.Series) -> float:
    """Return the median increment between the times of rows, or the mean increment if rows arrive in bursts.

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


def has_words(values: pl.Series) -> bool:
    """Return True for texts that are not numbers, such as dates."""
    return (
        values.dtype == pl.String and not len(column_numbers(values)) and bool(values.str.len_chars().max())
    )


def column_time(name: Name, frame: pl.DataFrame, role: Role) -> Conversion:
    """Read the time in one column: dates in text, or numbers, by the unit in the name or by their size and steps."""
    values, text = frame[name.column], quoted_column(name.column)
    if has_words(values):
        return date_time([name.column], frame)
    if values.dtype.is_temporal():
        return Conversion(text)
    if name.is_one("sample_?time_?fine"):
        if step_of(values) * 1e-4 > SLOWEST_IMU:
            return Conversion(f"{text}*1e-6", f"{name.column} is read as us, as in logs of Movella DOT")
        return Conversion(f"{text}*1e-4", f"{name.column} is read as ticks of 0.1 ms, as in logs of Xsens")
    if values.dtype.is_integer() and median_of(values) > 19e12:  # perhaps the digits of a date
        digits = date_time([name.column], frame.select(pl.col(name.column).cast(pl.String)))
        if not digits.fault:
            return digits
    if name.unit is None:
        return time_of_numbers(values, text, role)
    if name.unit.dimension == "time":
        return Conversion(in_si(name.unit, text))
    return refused(unknown_unit(name, "t", "time", role))


def date_time(columns: Sequence[str], frame: pl.DataFrame) -> Conversion:
    """Read dates in text by the format that fits most of them.

    Texts that fit two formats, or no format well, are refused.
    """
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
            return Conversion(f"duration({called})", "times are read as durations")
    if not fitting:
        message = f"{quoted(texts[0])} is not a date of a known format" if len(texts) else "contains no dates"
        option = (
            f"--time \"utc({called}, '%d.%m.%Y %H:%M:%S%.f')\" with its format, or write the times as numbers"
        )
        return refused(f"column {quoted(columns[0])}: {message}; write {option}")
    if order := _ORDER.search(" ".join(columns)):  # Date (DMY)
        first = f"%{(order[1] or order[2]).lower()}/"
        fitting = [f for f in fitting if f.startswith(first)] or fitting
    form = fitting[0]
    if most < MIN_FITTING_SHARE * len(texts):
        left = texts.to_frame("date").filter(_date_in(form).is_null()).item(0, 0)
        whole = f"utc({called}, '{form}')" if form else f"utc({called})"
        message = (
            f"column {quoted(columns[0])}: {quoted(left)} has a format different from that of {most} of "
            f"{len(texts)} texts"
        )
        return refused(f'{message}; correct rows like this, or omit them with --time "{whole}"')
    orders = [(word, f) for word in ("day", "month", "year") for f in fitting if f.startswith(f"%{word[0]}/")]
    if len(orders) > 1:
        options = (f"--time \"utc({called}, '{f}')\" if the {word} comes first" for word, f in orders)
        message = f"{printable(texts[0])} may be two different days"
        return refused(f"column {quoted(columns[0])}: {message}; write {' or '.join(options)}")
    note = "" if not form or "%d" in form else f"{called}: the times of day have no date"
    return Conversion(f"utc({called}, '{form}')" if form else f"utc({called})", note)


def _fitting_counts(texts: pl.Series, forms: Iterable[str]) -> dict[str, int]:
    """Return the number of texts that each format reads."""
    counts = (_date_in(form).count().alias(form) for form in forms)
    return texts.to_frame("date").select(counts).row(0, named=True)


def _date_in(form: str) -> pl.Expr:
    """Return an expression that parses the column ``date`` with the format ``form``, s. Other texts become null."""
    dates = pl.col("date")
    return parse_dates(dates if form else pl.when(dates.str.contains(r"^\d{4}-\d")).then(dates), form)


def time_of_numbers(values: pl.Series, text: str, role: Role) -> Conversion:
    """Read numbers without a unit: by their size if they count from a known epoch, otherwise by plausible steps."""
    numbers = column_numbers(values)
    size, step = median_of(numbers.abs()), step_of(values)
    column = text.strip("`")
    for begin, end, epoch, scale, what in _EPOCHS:
        if begin < size < end and MIN_STEP < step * scale < 4 * MAX_STEP[role]:
            return Conversion(f"({text} - {epoch})*{scale:g}", f"{column} is read as {what}")
    dated = [unit for unit, scale in COUNTER_UNITS.items() if _DATES_S[0] < size * scale < _DATES_S[1]]
    dated = [unit for unit in dated if unit != "s" or step == 0 or step < MAX_STEP[role]]
    if not dated and 0 < step < (FASTEST_IMU if role == "imu" else MIN_STEP / 2):
        return _too_short(numbers, text, column, step, role)
    likely = [unit for unit, scale in COUNTER_UNITS.items() if step * scale < MAX_STEP[role]]
    unit = (*dated, *likely, "s")[0]
    if role == "imu" and not dated and unit == "ms" and step < MIN_COUNT_STEP:
        rates = ", ".join(f'"{text}*1e-{k}" for {10**k / step:.4g} Hz' for k in (3, 2))
        what = f"column {quoted(column)} increases by {step:g} per row"
        message = f"{what}, so it may count ms, hundredths of a second, or rows"
        return refused(
            f'{message}; specify the unit with --time: {rates}, or "{text}/100" for 100 rows per s'
        )
    if role == "imu" and not dated and unit != "s" and step * COUNTER_UNITS[unit] > SLOWEST_IMU:
        rates = ", ".join(
            f'"{scaled(text, COUNTER_UNITS[u])}" for {1 / (step * COUNTER_UNITS[u]):.4g} Hz'
            for u in ("ms", "us")
        )
        message = f"column {quoted(column)}: {UNKNOWN_TICK} {step:g}"
        return refused(
            f'{message}; specify the unit with --time: {rates}, "{text}*1e-4" for ticks of 0.1 ms, or the '
            f'rate of the counter, for example "{text}/32768" for 32,768 ticks per s',
            ticks=text,
        )
    if unit == "s":
        return Conversion(text)
    note, ticks = f"the times in {column} are read as {unit}", "" if dated else text
    return Conversion(scaled(text, UNITS[unit]), note, ticks=ticks)


def _too_short(numbers: pl.Series, text: str, column: str, step: float, role: Role) -> Conversion:
    """Read numbers as fractions of a day. Refuse them if their steps are too short for seconds."""
    if MIN_STEP < step * 86400 < 4 * MAX_STEP[role] and numbers.is_between(1e-3, 1).all():
        return Conversion(f"{text}*86400", f"{column} is read as days (fractions of a day)")
    message = f'--time "{text}*86400" for days, *3600 for hours, *60 for minutes, *1 for seconds'
    seen = f"column {quoted(column)}: steps of {step:.2g} are too short for seconds"
    return refused(f"{seen}; specify the unit: {message}")


def wrong_unit(text: str, rows: pl.DataFrame, role: Role) -> str:
    """Describe the wrong unit of a time ``column`` or ``column*number``, with the remedy; otherwise return "".

    The unit is wrong if no sensor has such steps, and if another unit makes the steps plausible.
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
