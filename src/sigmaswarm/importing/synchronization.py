"""Put the times of all sensors on one clock: offsets, wraps, recordings, and remedies if they do not overlap."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import GPS_EPOCH, MIN_DATE, SECOND, WEEK, Nanoseconds, gps_to_unix
from sigmaswarm.importing.joining import Samples
from sigmaswarm.importing.positions import Say
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import ROLES, Role
from sigmaswarm.importing.time_units import FASTEST_IMU, MAX_STEP, MIN_FIX_INTERVAL, SLOWEST_IMU
from sigmaswarm.importing.timeline import DECIMAL_PERIODS, MINUTE, STEPS, wraps_too_fast
from sigmaswarm.wording import printable, rows_left_out

Sensors = dict[Role, Samples]
Seconds = dict[Role, Array]
_BOTH: tuple[Role, Role] = ("imu", "gps")


def synchronized(sensors: Sensors, recipe: Recipe, say: Say) -> tuple[Sensors, Seconds, int]:
    """Return the sensors, their times, s, and the origin of the times, s.

    If the IMU's clock jumps ahead between recordings, rows outside of the chosen recording are left out.
    """
    sensors = dict(sensors)
    _report_other_clocks(sensors, say)
    seconds, zero = in_seconds(_in_same_period(sensors, say), recipe)
    begin, end = seconds["imu"][0], seconds["imu"][-1]
    for role, time in seconds.items() if sensors["imu"].clock.set_ahead else ():
        inside = (time >= begin) & (time <= end)
        if inside.any() and not inside.all():
            outside = rows_left_out(int(np.count_nonzero(~inside)))
            say(f"{role}: {outside}, since the recording of the IMU does not cover their times")
            values = {name: column[inside] for name, column in sensors[role].values.items()}
            seconds[role], sensors[role] = time[inside], replace(sensors[role], values=values)
    return sensors, seconds, zero


def in_seconds(times: Mapping[Role, Nanoseconds], recipe: Recipe) -> tuple[Seconds, int]:
    """Return the times in s, with the recipe's offsets, and their origin: a whole second for dates, otherwise 0."""
    moved: dict[Role, Nanoseconds] = {}
    for role in ROLES:
        offset = getattr(recipe, f"{role}_offset_s", 0.0)
        if not abs(offset) < 4e9:  # 126 years; after larger offsets, times in ns could exceed 64 bits
            raise InputError(
                f"--{role}-offset {offset:g} is out of range; specify a value between -4e9 and 4e9 s"
            )
        if role in times:
            moved[role] = times[role] + round(offset * SECOND)
    # A wrong time stamp years before the others must not become the origin: relative to it, the other times would be so
    # large that rounding removes their last digits.
    begins = {role: int(t[np.searchsorted(t, t[len(t) // 2] - MIN_DATE)]) for role, t in moved.items()}
    begin = min(t for role, t in begins.items() if role in ("imu", "gps") or "gps" not in moved)
    zero = begin // SECOND if begin >= MIN_DATE else 0
    return {role: (time - zero * SECOND) / SECOND for role, time in moved.items()}, zero


def _report_other_clocks(sensors: Sensors, say: Say) -> None:
    back = sensors["imu"].clock.set_back
    for role, sensor in sensors.items():
        if back and not sensor.clock.set_back and back > STEPS * np.median(np.diff(sensor.time)):
            message = "the clock does not restart when the IMU's clock restarts. If the pause before this recording was"
            say(f"{role}: {message} short, add --{role}-offset {-back / SECOND:.3f}")


def _in_same_period(sensors: Sensors, say: Say) -> dict[Role, Nanoseconds]:
    """Shift tables by whole periods of a wrapping clock, so that they overlap the IMU in time.

    Of several possible shifts, use the one with which the table ends nearest to the end of the IMU samples.
    """
    imu, own = sensors["imu"].time, sensors["imu"].clock
    moved: dict[Role, Nanoseconds] = {role: sensor.time for role, sensor in sensors.items()}
    for role, sensor in sensors.items():
        if role == "imu":
            continue
        time, clock = sensor.time, sensor.clock
        period, same = max(own.period, clock.period), clock.time == own.time
        if (same or period in DECIMAL_PERIODS) and 0 < period < MINUTE and clock.unordered:
            raise wraps_too_fast(period / SECOND, f"{role}: {printable(sensor.table)}")  # between two rows
        other = not same or (not clock.period and int(np.ptp(time)) > period)
        if own.period in DECIMAL_PERIODS and period < MINUTE and other:
            rate = SECOND * (len(imu) - 1) / int(np.ptp(imu))
            raise InputError(
                f"imu: the counter {own.time} wraps every {period / SECOND:g} s and the {role} has another "
                "clock, so the offset between the clocks is unknown; specify another time column, or, if both clocks "
                f'begin at 0 s, compute the time from the row number: --map "imu.t=row/{rate:.4g}"'
            )
        if not period or not same:
            continue
        first, last = (int(edge) // period for edge in (imu[0] - time[-1], imu[-1] - time[0]))
        moves = np.arange(first, last + 2) * period
        inside = np.array([np.sum((time + m >= imu[0]) & (time + m <= imu[-1])) for m in moves])
        best = moves[inside == inside.max()]
        best = best[np.argsort(np.abs(time[-1] + best - imu[-1]))]
        moved[role] = time + best[0]
        if len(best) > 1 and role in ("gps", "truth", "odometer"):
            shift = (best[1] - best[0]) / SECOND
            message = (
                f"the clock wraps every {period / SECOND:.6g} s, so several shifts fit the IMU's times; the import "
                "uses the shift with which the table ends nearest to the last IMU sample"
            )
            say(f"{role}: {message}. If this shift is wrong, add --{role}-offset {shift:.10g}")
    return moved


def overlap_remedy(sensors: Sensors, seconds: Seconds, zero: int) -> str:
    """Return a remedy for fixes that do not overlap the IMU samples in time."""
    if remedy := _as_digits(seconds, sensors) or ("" if zero else _one_unit(seconds, sensors)):
        return remedy
    moves = "".join(f"--gps-offset {move:.10g} if {why}, or " for move, why in _moves(seconds, zero))
    offset = seconds["imu"][0] - seconds["gps"][0]
    return f": add {moves}--gps-offset {offset:.3f} if both logs began at the same time"


def _as_digits(seconds: Seconds, sensors: Sensors) -> str:
    """Return a remedy if the times of one table are digits hhmmss that were read as seconds; otherwise "".

    In this case, the tables overlap in time only after the digits are converted to seconds.
    """
    for role, other in (_BOTH[::-1], _BOTH):
        text = sensors[role].clock.time if role in sensors else ""
        time, others = seconds[role], seconds[other]
        digits = (time >= 10_000) & (time < 240_000) & (time % 10_000 < 6000) & (time % 100 < 60)
        converted = time % 100 + (time % 10_000 - time % 100) * 0.6 + (time - time % 10_000) * 0.36
        if text and digits.all() and np.mean((converted >= others[0]) & (converted <= others[-1])) > 0.5:
            t = text if re.fullmatch(r"\w+|`[^`]+`", text) else f"({text})"
            mapped = f"{t} % 100 + ({t} % 10000 - {t} % 100)*0.6 + ({t} - {t} % 10000)*0.36"
            return f'; if the times of {role}.csv are digits hhmmss, write --map "{role}.t={mapped}"'
    return ""


def _moves(seconds: Seconds, zero: int) -> Iterator[tuple[float, str]]:
    """Yield each offset (s) with which the fixes overlap the IMU samples in time, and the reason for it."""
    imu, gps = seconds["imu"] + zero, seconds["gps"] + zero
    leap = float(max(imu[0], gps[0]) - gps_to_unix(np.array([max(imu[0], gps[0])]))[0])
    short, dated = min(imu[0], gps[0]), max(imu[0], gps[0]) * SECOND > MIN_DATE
    reasons = (
        (900, 0.0, "the clocks show the local times of two zones", short * SECOND > MIN_DATE),
        (86_400, 0.0, "one clock counts from midnight UTC", dated and short < 2 * 86_400),
        (WEEK, GPS_EPOCH % WEEK - leap, "one clock shows the GPS time of week", dated and short < WEEK),
        (1e12, GPS_EPOCH - leap, "one clock shows GPS time", short * SECOND > MIN_DATE),
        (2**32 * 1e-6, 0.0, "a counter of 2^32 microseconds has wrapped", not dated),
    )
    for period, begin, why, fits in reasons:
        sign = 1 if imu[0] > gps[0] else -1
        apart = sign * (float(np.median(imu)) - float(np.median(gps)))
        move = sign * (round((apart - begin) / period) * period + begin)
        inside = np.mean((gps + move >= imu[0]) & (gps + move <= imu[-1]))
        if fits and inside > 0.5 and (period != 900 or abs(move) <= 14 * 3600):
            yield move, why


def _one_unit(seconds: Seconds, sensors: Sensors) -> str:
    """Return a remedy if times of IMU and fixes have the same unit but were read in different units; otherwise "".

    For example, an IMU at 100 Hz with times in hundredths of a second has steps of 1, which the import reads as 1 ms.
    """
    texts = {role: sensors[role].clock.time for role in _BOTH if role in sensors}
    read = {role: re.fullmatch(r"(\w+|`[^`]+`)(?:\*(1e-\d))?", text) for role, text in texts.items()}
    columns = {role: (match[1], float(match[2] or 1)) for role, match in read.items() if match}
    if len(columns) < 2 or columns["imu"][1] == columns["gps"][1]:
        return ""
    imu, gps = (seconds[role] / columns[role][1] for role in _BOTH)
    shares = [np.mean((one >= other[0]) & (one <= other[-1])) for one, other in ((gps, imu), (imu, gps))]
    if max(shares) < 0.5:
        return ""
    options: list[str] = []
    for k in range(1, 7):
        steps = [10.0**-k * float(np.median(np.diff(time))) for time in (imu, gps)]
        if FASTEST_IMU < steps[0] < SLOWEST_IMU and MIN_FIX_INTERVAL < steps[1] < MAX_STEP["gps"]:
            maps = " ".join(f'"{role}.t={column}*1e-{k}"' for role, (column, _) in columns.items())
            options.append(f"{maps} for {1 / steps[0]:.4g} Hz and {1 / steps[1]:.4g} Hz")
    if not options:
        return ""
    return (
        "; without the factors the times of IMU and fixes overlap, so they have the same unit, but "
        f"{' and '.join(texts.values())} have different factors; write --map {', or '.join(options)}"
    )
