"""Times inside the importer: whole nanoseconds of a log's own clock, and GPS time as UTC."""

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.importing.expressions import compile_expression, integer_scale

Nanoseconds = NDArray[np.int64]

SECOND = 1_000_000_000
"""ns."""

LONG_AGO = 1_000_000 * SECOND
"""Clocks beyond this (12 days) count from 1970 or a phone's start: a drive then counts from its own beginning."""

GPS_EPOCH = 315_964_800
"""s from 1970-01-01 to 1980-01-06, the beginning of GPS time (IS-GPS-200)."""

_LEAP_DAYS = (
    *("1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01"),
    *("1992-07-01", "1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01"),
    *("2009-01-01", "2012-07-01", "2015-07-01", "2017-01-01"),
)
"""Days that began with a leap second just past (IERS Bulletin C); none has been announced since."""
LEAP_SECONDS = np.array(_LEAP_DAYS, dtype="datetime64[s]").astype(np.int64)


def gps_to_unix(seconds: NDArray[np.float64]) -> NDArray[np.float64]:
    """UTC, s since 1970, of GPS time given as s since 1970 without leap seconds (a calendar date in GPS time).

    Parameters
    ----------
    seconds : ndarray, shape (n,)
    """
    leaps = np.searchsorted(LEAP_SECONDS + np.arange(1, len(LEAP_SECONDS) + 1), seconds, side="right")
    return seconds - leaps


_COUNTED = {"ms": 1000, "us": 1_000_000, "ns": SECOND}
"""A date's units in a second."""


def _whole(count: pl.Expr, factor: int) -> pl.Expr:
    """A count (64 bits) times a factor; null where that leaves 64 bits, instead of some other time."""
    most = (2**63 - 1) // max(factor, 1)
    return pl.when(count.is_between(-most, most)).then(count * factor)


def time_expression(text: str, frame: pl.DataFrame) -> pl.Expr:
    """The expression of a time (s) as whole nanoseconds; integer columns keep all their digits."""
    columns = frame.columns
    scaled = integer_scale(text, columns)
    if scaled is not None:
        name, factor = scaled
        kind = frame.schema[name]
        if isinstance(kind, pl.Datetime) and factor == 1:
            return _whole(pl.col(name).dt.timestamp(kind.time_unit), SECOND // _COUNTED[kind.time_unit])
        whole = round(factor * SECOND)
        if kind.is_integer() and abs(whole - factor * SECOND) < 1e-9 * whole and whole < SECOND:
            return _whole(pl.col(name).cast(pl.Int64, strict=False), whole)
    return (compile_expression(text, columns).polars * float(SECOND)).round().cast(pl.Int64, strict=False)
