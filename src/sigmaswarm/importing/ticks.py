"""Find the rate of a counter of ticks, such as 32,768 Hz, from a known clock in the same table."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.importing.dates import SECOND
from sigmaswarm.importing.expressions import time_expression
from sigmaswarm.importing.names import CLOCK, read_names
from sigmaswarm.importing.source import TickRate
from sigmaswarm.importing.table_columns import quoted_column
from sigmaswarm.importing.time_units import column_time
from sigmaswarm.importing.times import find_time
from sigmaswarm.wording import printable

WRAPS = (2**16, 2**24, 2**31, 2**32)  # numbers of ticks after which counters wrap
MIN_CHANGES = 10  # smallest number of changes of the known clock
MIN_SPAN = 5.0  # s, smallest time from the first to the last change
MAX_JITTER = 0.5  # s, 90% quantile of the distance between counter and clock; a clock may have whole seconds
# Largest relative difference from a usual rate; the rates of crystals differ less, but stamps have jitter
RATE_TOLERANCE = 1e-3
# First digits of usual rates, in addition to powers of 2
DIGITS = (1, 1.2, 1.25, 1.5, 1.6, 2, 2.4, 2.5, 3, 3.2, 3.6, 4, 4.8, 5, 6, 6.25, 6.4, 7.2, 8, 8.4, 9, 9.6)


@dataclass(frozen=True)
class Counter:
    """Counter of the IMU's times whose unit is only guessed; ``text`` is "" if there is none."""

    text: str = ""
    shared: bool = False  # True if the fixes have the same counter


def time_of_ticks(text: str, rate: float) -> str:
    """Return the expression of a counter's time, s."""
    return f"{text}/{rate:.10g}"


def rates_by_clock(samples: Mapping[str, pl.DataFrame]) -> dict[str, TickRate]:
    """Return the tick rates of counters in tables that also have a known clock; keys are the quoted column names."""
    found: dict[str, TickRate] = {}
    for table, frame in samples.items():
        names = [n for n in read_names(frame.columns) if n.meaning == "t" or n.is_one(CLOCK)]
        counters = [n.column for n in names if column_time(n, frame, "gps").ticks]
        rest = frame.drop(counters)
        known = find_time(rest, "gps") if counters else None
        if known is None or not known.expression or known.ticks:
            continue
        try:
            clock = rest.select(time_expression(known.expression, rest).alias("t"))["t"]
        except pl.exceptions.PolarsError:
            continue
        for column in counters:
            both = pl.DataFrame({"n": frame[column].cast(pl.Float64, strict=False), "t": clock}).drop_nulls()
            seconds = both["t"].to_numpy().astype(np.float64) / SECOND
            if (rate := rate_of(both["n"].to_numpy(), seconds)) is not None:
                found.setdefault(quoted_column(column), TickRate(rate, known.expression, table))
    return found


def rate_of(ticks: Array, clock: Array) -> float | None:
    """Fit the rate of a counter (n,), Hz, that may wrap, to a known clock (n,), s; None if they do not agree."""
    new = np.flatnonzero(np.diff(clock) > 0) + 1  # a clock of whole seconds repeats
    if len(new) < MIN_CHANGES or clock[new[-1]] - clock[new[0]] < MIN_SPAN:
        return None
    n, t = ticks[new] - ticks[new[0]], clock[new] - clock[new[0]]
    steps = np.diff(n)
    period = next((p for p in WRAPS if p > ticks.max()), 0) if (steps < 0).any() else 0
    steps = steps % period if period else steps
    rate, span = float(np.median(steps / np.diff(t))), 10 * float(np.median(np.diff(t)))
    if rate <= 0:
        return None
    while True:  # the rate of a short span determines the number of wraps in a longer span
        near = np.abs(t) <= span
        whole = n + (np.round((rate * t - n) / period) * period if period else 0.0)
        rate, first = np.polyfit(t[near], whole[near], 1).tolist()
        if span >= t[-1]:
            break
        span *= 3
    off = np.quantile(np.abs(whole - first - rate * t), 0.9) / rate if rate > 0 else np.inf
    return usual_rate(rate) if off < min(MAX_JITTER, 0.02 * float(t[-1])) else None


def usual_rate(rate: float, tolerance: float = RATE_TOLERANCE) -> float:
    """Return the usual rate of a clock, Hz, that is closest to an estimate, or the estimate if none is close."""
    best = closest_rate(rate)
    return best if abs(rate / best - 1) < tolerance else float(f"{rate:.6g}")


def closest_rate(rate: float) -> float:
    powers = [10.0 ** (math.floor(math.log10(rate)) + k) for k in (0, 1)]
    usual = [*(digits * power for digits in DIGITS for power in powers), 2.0 ** round(math.log2(rate))]
    return min(usual, key=lambda one: abs(rate / one - 1))


def describe_rate(text: str, found: TickRate) -> str:
    return (
        f"{text} is read as ticks of {found.rate:,.10g} Hz, since it agrees with {found.clock} of "
        f"{printable(found.table)} at this rate"
    )
