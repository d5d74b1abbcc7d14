"""Clocks of a log: a time column that tables share, and the rate of a counter of ticks, such as 32,768 Hz."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.drives.drive import Drive
from sigmaswarm.importing.dates import SECOND
from sigmaswarm.importing.expressions import ROW, compile_expression, row_times, time_span
from sigmaswarm.importing.imu_units import MIN_CONFIRMED, MIN_EXPLAINED, turn_ratio
from sigmaswarm.importing.names import CLOCK, is_time, read_name, read_names
from sigmaswarm.importing.source import Part, Role, TickRate
from sigmaswarm.importing.table_columns import quoted_column, scaled_column
from sigmaswarm.importing.time_units import FASTEST_IMU, SLOWEST_IMU, column_time
from sigmaswarm.importing.times import find_time
from sigmaswarm.wording import printable

Roles = dict[Role, tuple[Part, ...]]
WRAPS = (2**16, 2**24, 2**31, 2**32)  # numbers of ticks after which counters wrap
MIN_CHANGES = 10  # smallest number of changes of the known clock
MIN_SPAN = 5.0  # s, smallest time from the first to the last change
MAX_JITTER = 0.5  # s, 90% quantile of the distance between counter and clock; a clock may have whole seconds
# Largest relative difference from a usual rate; the rates of crystals differ less, but stamps have jitter
RATE_TOLERANCE = 1e-3
# First digits of usual rates, in addition to powers of 2
DIGITS = (1, 1.2, 1.25, 1.5, 1.6, 2, 2.4, 2.5, 3, 3.2, 3.6, 4, 4.8, 5, 6, 6.25, 6.4, 7.2, 8, 8.4, 9, 9.6)
FIX_RATES = (0.1, 0.2, 0.5, 1, 2, 4, 5, 8, 10, 12.5, 16, 18, 20, 25, 50)  # Hz, usual rates of receivers
# Largest relative difference of turns and of accelerations at the right rate
MAX_TURN_ERROR, MAX_FORCE_ERROR = 0.08, 0.2
# Largest logarithm of a ratio of turns, or of durations, that does not contradict a unit
MAX_RATIO_ERROR = 0.2
MIN_EPOCH = 1e8  # s, smallest time of a clock that counts from an epoch


def on_common_clock(roles: Roles, samples: Mapping[str, pl.DataFrame]) -> tuple[Roles, list[str]]:
    """Return the roles and notes.

    If the tables' times do not overlap, both roles use a shared column whose times overlap.
    """
    imu, gps = ((*parts, Part("", {}))[0] for parts in (roles.get("imu", ()), roles.get("gps", ())))
    if not {"t"} <= imu.columns.keys() & gps.columns.keys() or imu.table == gps.table:
        return roles, []
    rows = samples[imu.table], samples[gps.table]
    if _overlap(rows, (imu.columns["t"], gps.columns["t"])):
        return roles, []
    for column in rows[0].columns:
        name = read_name(column)
        if column not in rows[1].columns or not is_time(name.plain):
            continue
        text, other = (
            column_time(name, rows[0], "imu").expression,
            column_time(name, rows[1], "gps").expression,
        )
        if text and text == other and _overlap(rows, (text, text)):
            apart = f"{imu.columns['t']} and {gps.columns['t']} do not overlap"
            note = f"the time of IMU and fixes is {column}, since {apart}"
            both: tuple[Role, ...] = ("imu", "gps")
            return {**roles, **{r: (_at(roles[r][0], text), *roles[r][1:]) for r in both}}, [note]
    parts: tuple[tuple[Role, Part], ...] = (("gps", gps), ("imu", imu))
    for (role, part), (_, fixed) in (parts, parts[::-1]):  # another clock of one of the tables
        frame = samples[part.table]
        rest = frame.drop(compile_expression(part.columns["t"], (*frame.columns, ROW)).columns, strict=False)
        other = find_time(rest, role)
        text = other.expression if other and not other.ticks else ""
        # Clocks that begin at 0 may overlap by chance.
        since_epoch = text and (span := time_span(text, frame)) and span[0] > MIN_EPOCH
        if since_epoch and _overlap((frame, samples[fixed.table]), (text, fixed.columns["t"])):
            apart = f"{part.columns['t']} and {fixed.columns['t']} do not overlap"
            note = f"the time of {part.table} is {text}, since {apart}"
            return {**roles, role: (_at(part, text), *roles[role][1:])}, [note]
    return roles, []


def _at(part: Part, time: str) -> Part:
    return replace(part, columns={**part.columns, "t": time})


def _overlap(rows: tuple[pl.DataFrame, pl.DataFrame], texts: tuple[str, str]) -> bool:
    spans = [time_span(text, table) for table, text in zip(rows, texts, strict=True)]
    if None in spans:
        return False
    (first, last), (begin, end) = (span for span in spans if span is not None)
    return min(last, end) - max(first, begin) > 0.5 * min(last - first, end - begin)


@dataclass(frozen=True)
class Counter:
    """Counter of the IMU's times whose unit is only guessed. ``text`` is "" if there is none."""

    text: str = ""
    shared: bool = False  # True if the fixes have the same counter

    @property
    def alone(self) -> bool:
        """True if only the IMU has the counter."""
        return bool(self.text) and not self.shared


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
        clock = row_times(known.expression, rest)
        for column in counters:
            both = pl.DataFrame({"n": frame[column].cast(pl.Float64, strict=False), "t": clock}).drop_nulls()
            seconds = both["t"].to_numpy().astype(np.float64) / SECOND
            if (rate := rate_of(both["n"].to_numpy(), seconds)) is not None:
                found.setdefault(quoted_column(column), TickRate(rate, known.expression, table))
    return found


def rate_of(ticks: Array, clock: Array) -> float | None:
    """Fit the rate (Hz) of a counter (n,) that may wrap to a known clock (n,), s. Return None if they do not agree."""
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


@dataclass(frozen=True)
class DurationRate:
    """Rate of a counter, ticks per s, at which IMU and fixes have the same duration; 0 if the guessed rate is kept."""

    rate: float = 0.0
    factor: float = 1.0  # factor of the IMU's times
    remedy: str = ""


def wrong_tick(drive: Drive, counter: Counter, time: str, other: DurationRate) -> str:
    """Describe a counter whose guessed unit is wrong, since the motions of IMU and fixes differ; otherwise return "".

    ``time`` is the expression of the IMU's time.

    A counter that the fixes do not share is refused only if the motions agree at the rate that the durations show. The
    IMU may also have recorded longer or shorter than the receiver.
    """
    if not (counter.shared or other.rate):
        return ""
    share, ratio = turn_ratio(drive)
    if share > MIN_CONFIRMED and abs(math.log(max(ratio, 1e-9))) < MAX_RATIO_ERROR:
        return ""
    if counter.shared:
        factor, found = rate_by_motion(drive), scaled_column(time)
        if factor is None or found is None or abs(math.log(factor)) < MAX_RATIO_ERROR:
            return ""
        remedy = shown_rate(counter.text, 1 / (found[1] * factor))
    else:
        if closest_rate(other.rate) != other.rate:
            return ""
        since = (drive.imu.time - drive.imu.time[0]) * other.factor
        share, ratio = turn_ratio(replace(drive, imu=replace(drive.imu, time=drive.gps.time[0] + since)))
        if share < MIN_EXPLAINED or abs(math.log(ratio)) > MAX_TURN_ERROR:
            return ""
        remedy = other.remedy
    return f"{counter.text}: the unit of the times is unknown; {remedy}"


def rate_by_motion(drive: Drive) -> float | None:
    """Return the factor of all times with which turns and accelerations agree with the fixes, or None if it is unclear.

    At a wrong rate, turns differ by a factor and accelerations by its square. A wrong unit of the gyro changes only the
    turns. A receiver has one of the usual rates, so a counter that IMU and fixes share has few possible rates.
    """
    step, interval = (float(np.median(np.diff(sensor.time))) for sensor in (drive.imu, drive.gps))
    possible = (1 / (rate * interval) for rate in FIX_RATES)
    possible = [k for k in possible if FASTEST_IMU < k * step < SLOWEST_IMU]
    fitting = [k for k in possible if _agrees(_at_rate(drive, k))]
    return fitting[0] if len(fitting) == 1 else None


def _at_rate(drive: Drive, factor: float) -> Drive:
    imu, gps = (replace(sensor, time=sensor.time * factor) for sensor in (drive.imu, drive.gps))
    return replace(drive, imu=imu, gps=gps, truth=None, odometer=None)


def _agrees(drive: Drive) -> bool:
    """Return True if turns and accelerations agree with the fixes, without regard to signs."""
    share, ratio = turn_ratio(drive)
    if share < MIN_EXPLAINED or abs(math.log(ratio)) > MAX_TURN_ERROR:
        return False
    mount = gather(drive).mount
    if mount is None or not any(mount.known):
        return False
    scales = [size for (size, _), known in zip(mount.scale, mount.known, strict=True) if known]
    return mount.unit == 1 and all(abs(size - 1) < MAX_FORCE_ERROR for size in scales)


def rate_by_duration(counter: Counter, time: str, durations: Mapping[Role, float]) -> DurationRate:
    """Return the rate of a counter at which IMU and fixes have the same duration, if it differs from the guessed rate.

    ``time`` is the expression of the IMU's time. ``durations`` are those of IMU and fixes, s, or {} if they are not
    known.
    """
    scaled, (imu, gps) = scaled_column(time), (durations.get(role, 0.0) for role in ("imu", "gps"))
    if scaled is None or not min(imu, gps) or abs(math.log(imu / gps)) < MAX_RATIO_ERROR:
        return DurationRate()
    rate = usual_rate(imu / gps / scaled[1], 0.01)
    remedy = (
        f"if IMU and fixes cover the same {gps:.0f} s, {counter.text} has about {rate:,.10g} ticks per s; write "
        f'--map "imu.t={time_of_ticks(counter.text, rate)}"'
    )
    return DurationRate(rate, 1 / (rate * scaled[1]), remedy)


def shown_rate(counter: str, rate: float) -> str:
    rate = usual_rate(rate)
    maps = " ".join(f'"{role}.t={time_of_ticks(counter, rate)}"' for role in ("imu", "gps"))
    unit = "rows" if counter == ROW else "ticks"
    return f"the motion of IMU and fixes agrees at {rate:,.10g} {unit} per s; write --map {maps}"
