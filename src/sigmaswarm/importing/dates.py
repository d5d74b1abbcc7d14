"""Convert dates in text, and GPS time, to seconds since 1970 in UTC; the importer's times are whole nanoseconds."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.importing.units import BASES

Nanoseconds = NDArray[np.int64]
SECOND = 1_000_000_000
# ns; larger times (above 11.6 days) count from 1970, or from the boot of a phone. The drive's times then begin at 0.
MIN_DATE = 1_000_000 * SECOND
GPS_EPOCH = 315_964_800  # 1980-01-06 (IS-GPS-200), s since 1970-01-01
WEEK = 604_800
# 1970-01-01 in days of spreadsheets, of MATLAB's datenum, and of the Julian date
EXCEL_EPOCH, MATLAB_EPOCH, JULIAN_EPOCH = 25569, 719_529, 2_440_587.5
# Days that follow a leap second (IERS Bulletin C); no later leap second has been announced
LEAP_DAYS = (
    *("1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01"),
    *("1992-07-01", "1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01"),
    *("2009-01-01", "2012-07-01", "2015-07-01", "2017-01-01"),
)
LEAP_SECONDS = np.array(LEAP_DAYS, dtype="datetime64[s]").astype(np.int64)
_HOURS = {
    **{0: "Z UTC GMT WET", 1: "CET BST WEST", 2: "CEST EET", 3: "EEST", 9: "JST", 10: "AEST", 11: "AEDT"},
    **{-4: "EDT", -5: "EST CDT", -6: "MDT", -7: "MST PDT", -8: "PST"},
}
# Hours ahead of UTC, by name of the time zone
ZONES = {name: float(hours) for hours, names in _HOURS.items() for name in names.split()}
_STEPS = LEAP_SECONDS + np.arange(1, len(LEAP_SECONDS) + 1)  # GPS time after each leap second, s since 1970


def gps_to_unix(seconds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert GPS time (n,), s since 1970 without leap seconds, to UTC."""
    return seconds - np.searchsorted(_STEPS, seconds, side="right")


def gps_time(week: pl.Expr, seconds: pl.Expr) -> pl.Expr:
    """Convert GPS week and seconds to UTC, s since 1970."""
    time = week * WEEK + seconds + GPS_EPOCH
    return time - pl.sum_horizontal((time >= int(step)).cast(pl.Float64) for step in _STEPS)


def as_text(columns: Sequence[str]) -> pl.Expr:
    cells = [pl.col(name).cast(pl.String).str.strip_chars() for name in columns]
    return cells[0] if len(cells) == 1 else pl.concat_str(cells, separator=" ")


def parse_dates(text: pl.Expr, form: str = "") -> pl.Expr:
    """Convert dates in text to seconds since 1970. Other texts become null, and dates without a zone are UTC.

    ``form`` contains strftime codes; "" is ISO 8601. If ``form`` contains no day, seconds count from midnight.
    """
    plain = (
        text.str.replace("T(\\d)", " ${1}")
        .str.replace(r"(\d),(\d+)", "${1}.${2}")
        .str.replace(", ", " ", literal=True)
        .str.replace(r" ?\[.*\]$", "")
    )
    named = plain.str.extract(r"\d ?([A-Z]{1,4})$").replace_strict(
        ZONES, default=None, return_dtype=pl.Float64
    )
    plain = pl.when(named.is_null()).then(plain).otherwise(plain.str.replace(r" ?[A-Z]+$", ""))
    zone = plain.str.extract_groups(r" .*:.*([+-])(\d\d)(?::?(\d\d))?$")
    ahead = zone.struct[1].cast(pl.Float64) + zone.struct[2].cast(pl.Float64).fill_null(0.0) / 60
    ahead = 3600 * pl.coalesce(named, pl.when(zone.struct[0] == "-").then(-ahead).otherwise(ahead), 0.0)
    plain = plain.str.replace(r"(\d\d:.*?) ?[+-]\d\d(?::?\d\d)?$", "${1}")
    # some spreadsheets show only minutes and seconds (12:34.5); a text without a fraction may be hours and minutes
    if form.startswith("%M"):
        plain, form = pl.when(plain.str.contains(r"\.")).then("0:" + plain), f"%H:{form}"
    if form and "%d" not in form and "%j" not in form:
        return plain.str.to_time(form, strict=False).cast(pl.Int64) / 1e9
    date = plain.str.to_datetime(form or None, time_unit="us", strict=False)
    date = pl.when(date.dt.year() > 999).then(date)  # the code %Y also accepts a year of two digits
    return date.dt.timestamp("us") / 1e6 - ahead


def parse_durations(text: pl.Expr) -> pl.Expr:
    """Convert durations such as "1.23 sec", "12 ms", "27:00:01.5" or "1 day 02:00:00" to s. Other texts become null."""
    plain = text.str.to_lowercase().str.replace(r"(\d),(\d+)", "${1}.${2}")
    counted = plain.str.extract_groups(r"^([+-]?\d+\.?\d*(?:e[+-]?\d+)?) ?([a-zµμ]+)$")
    factors = {word: factor for word, (kind, factor) in BASES.items() if kind == "T"}
    unit = (
        counted.struct[1]
        .str.replace("[µμ]", "u")
        .replace_strict(factors, default=None, return_dtype=pl.Float64)
    )
    clock = plain.str.extract_groups(r"^(?:(\d+)(?: ?d(?:ays?)?,? |:))?(\d+):([0-5]\d):([0-5]\d(?:\.\d+)?)$")
    day, hour, minute, second = (clock.struct[k].cast(pl.Float64) for k in range(4))
    whole = day.fill_null(0.0) * 86400 + hour * 3600 + minute * 60 + second
    return pl.coalesce(counted.struct[0].cast(pl.Float64) * unit, whole)
