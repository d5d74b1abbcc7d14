"""Make the times of a table strictly increasing: unwrap counters, choose a recording, spread repeated time stamps."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import MIN_DATE, SECOND, WEEK, Nanoseconds
from sigmaswarm.importing.positions import Say
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.time_units import MAX_DECREASING_SHARE, MAX_STEP, MIN_STEP, UNITS
from sigmaswarm.wording import count_of, list_names, rows_left_out

MINUTE = 60 * SECOND
BITS = (16, 24, 31, 32)  # lengths of counters, bits
# Periods of counters with a constant number of decimal digits, ns
DECIMAL_PERIODS = tuple(10**k * SECOND for k in range(7))
# Periods after which counters wrap, ns
WRAPS: tuple[tuple[int, str], ...] = (
    *((2**bits * 1000, f"a counter of 2^{bits} microseconds") for bits in (24, 31, 32)),
    *((2**bits * 1_000_000, f"a counter of 2^{bits} milliseconds") for bits in BITS),
    (2**32, "a counter of 2^32 nanoseconds"),
    (WEEK * SECOND, "the time of week"),
    (86_400 * SECOND, "the time of day"),
    (43_200 * SECOND, "a clock of 12 hours"),
    (3600 * SECOND, "minutes and seconds"),
    (MINUTE, "the seconds of the minute"),
    *((period, f"a counter of {period // SECOND} s") for period in DECIMAL_PERIODS),
)
# For counters that wrap within a minute: smallest period and longest step, both in usual steps
MIN_PERIOD_STEPS, MAX_SHORT_STEP = 15, 5
# Smallest number of rows of a separate recording; shorter runs of rows out of order are sorted
MIN_ROWS = 20
MIN_TIME_ERROR = 10.0  # s, smallest distance of a wrong time from the times of the rows around it
MAX_JUMPS = 100  # if the clock jumps more often, wrong times are not searched for
# If there are more recordings of about one second, the fractions of seconds are presumably wrong
MAX_SECONDS = 5
# Smallest jump of a clock between recordings: in s, and in median steps; the larger value applies
MIN_STEP_BACK, STEPS = 0.2, 2
MAX_STEP_AHEAD = 3590 * SECOND  # longest pause within a recording; a change to summer time is an hour
MIN_REFUSED_SHARE = 0.1  # smallest fraction of rows with a repeated time in a table that is refused
MAX_REPEATED_SHARE = 0.02  # if a larger fraction of rows repeats the previous time, rows share time stamps
# Largest step within a burst of rows, relative to the mean step and to `MAX_STEP`; the smaller value applies
MAX_BURST_STEP, MAX_BURST_INTERVAL = 0.25, 1 / 400
MIN_BURST_SHARE = 0.4  # smallest fraction of such steps in a log with bursts
MAX_ODD_SHARE = 0.2  # largest share of stamps without exactly two rows in a log with two rows per measurement
# Rows are probably lost if coarse time stamps drift relative to a constant rate: the variance of the drift over
# `WINDOW` stamps, rows^2, exceeds MIN_WALK plus MIN_GROWTH times the variance of the drift over one stamp.
MIN_WALK, MIN_GROWTH = 0.3, 1.5
# A stamp is uneven if its number of rows or its step differs from the usual value by more than this fraction
MAX_LOST = 0.2
MAX_UNEVEN_SHARE = 0.1  # if a larger fraction of stamps is uneven, rows are not spread by stamp
MIN_STAMPS = 5  # smallest number of stamps that show the number of rows of a stamp
# Smallest deviation of the steps of stamps, relative to a step, that rounding does not cause
MIN_STEP_VARIATION = 0.005
# Relative to the usual step of stamps: longest step without a pause, window in which rows have a constant rate, and
# largest width of the band of stamps at a constant rate (see `spread_stamps`)
MAX_PAUSE, WINDOW, MAX_BAND = 2.5, 20, 1.25
MIN_EVEN_SHARE = 0.9  # smallest fraction of rows with such a band
# Times in days, as in spreadsheets: rounding errors of 4 to 7 decimals, ns, and the largest deviation from a multiple
DAY_DECIMALS = tuple(86_400 * SECOND / 10**k for k in (4, 5, 6, 7))
MAX_DEVIATION = 20_000  # ns
# Rounding, relative to the mean step: above the first limit rows are spread, above the second an uneven rate is refused
MIN_DAY_ROUNDING, MAX_DAY_ROUNDING = 0.2, 0.5


def from_digits(time: Nanoseconds) -> tuple[Nanoseconds, str]:
    """Convert times of day with digits hhmmss (115959.98) to seconds. Return the times, and a sentence or "".

    In this format, the numbers, read as seconds, increase by an additional 40 at each change of the minute (59 to 100).
    """
    whole = time // SECOND
    if len(time) < 3 or int(whole.min()) < 10_000 or int(whole.max()) >= 240_000:
        return time, ""
    hour, minute, second = whole // 10_000, whole // 100 % 100, whole % 100
    fine = (hour * 3600 + minute * 60 + second) * SECOND + time % SECOND
    new, steps = np.diff(whole // 100) != 0, np.diff(fine)
    limit = max(2 * SECOND, 2 * float(np.median(np.abs(steps))))
    if (minute >= 60).any() or (second >= 60).any() or not new.any() or np.median(np.abs(steps[new])) > limit:
        return time, ""
    return fine, "the times are hours, minutes and seconds (hhmmss) and are converted"


def unwrap(
    time: Nanoseconds, tick: float = 0.0, where: str = "", *, parts: bool = False
) -> tuple[Nanoseconds, int, str]:
    """Unwrap a counter that wrapped. Return the times, its period, ns, and a sentence; 0 and "" for other clocks.

    ``tick`` is the unit of the counter, s, or 0 if it is unknown. ``parts`` is True if the user chose one of several
    recordings. Recordings may have equal durations. A clock that starts at 0 and goes back by a minute or by 10, 100,
    ... s is then always read as restarted, not as wrapped. Raises `InputError` if a counter with a period of 1, 10,
    100, ... s wraps after fewer than 15 of its usual steps.
    """
    steps = np.diff(time)
    ahead = steps[steps > 0]
    if not len(ahead) or not 0 < np.mean(steps < 0) < MAX_DECREASING_SHARE:
        return time, 0, ""
    usual = float(np.median(ahead))
    fitting: list[tuple[float, int, str]] = []
    of_ticks = {
        round(2**bits * tick * SECOND): f"a counter of 2^{bits} ticks" for bits in BITS if 0 < tick <= 1
    }
    for period, name in (of_ticks | dict(WRAPS)).items():
        wraps = steps < -0.5 * period
        # After a wrap, the times continue by about a usual step, unlike after two exchanged rows of a short log.
        lost = 5 if period >= 3600 * SECOND else 2.5  # a recording may end by chance near a short period
        near = np.abs(steps + period) <= min(max(50 * usual, 2 * SECOND), lost * usual + 1e-3 * period)
        low = -period // 2 if int(time.min()) < 0 else 0  # a signed counter
        inside = low <= int(time.min()) and int(time.max()) <= low + 1.001 * period
        # The times may have the date of the first row and the time of day of each row.
        if period == 86_400 * SECOND and wraps.any():
            edge = np.abs((np.r_[time[1:][wraps], time[:-1][wraps]] + period // 2) % period - period // 2)
            inside |= int(np.ptp(time)) <= period and int(edge.max()) <= 60 * SECOND
        # These may be two recordings of a minute each; three or more would hardly end with the same sample.
        alike = period == MINUTE or (period in DECIMAL_PERIODS and period > SECOND)
        begun = alike and int(time[0]) < 0.1 * SECOND and (parts or np.count_nonzero(wraps) == 1)
        if not (wraps.any() and np.array_equal(wraps, wraps & near) and inside) or begun:
            continue
        if period in DECIMAL_PERIODS and period < MIN_PERIOD_STEPS * usual:
            raise wraps_too_fast(period / SECOND, where)
        # after a pause, the number of wraps would be unknown
        paused = period < MINUTE and int(np.max(steps % period)) > MAX_SHORT_STEP * usual
        if not (paused and period in DECIMAL_PERIODS):
            fitting.append((float(np.median(np.abs(steps[wraps] + period - usual))), period, name))
    if not fitting:
        return time, 0, ""
    _, period, name = min(fitting)
    turns = np.concatenate([[0], np.cumsum(steps < -0.5 * period)])
    return time + turns * period, period, f"{name} wraps {count_of(int(turns[-1]), 'time')} and is unwrapped"


def require_unwrappable(time: Nanoseconds, tick: float, where: str) -> None:
    """Refuse a counter that wraps too fast for the rate of the rows. ``tick`` is its unit, s, or 0."""
    backwards = float(np.mean(np.diff(time) < 0)) if len(time) > MIN_ROWS else 0.0
    span = int(np.ptp(time)) / SECOND if len(time) else 0.0
    period = next((2**bits * tick for bits in BITS if 0.9 < span / max(2**bits * tick, 1e-12) < 1.001), None)
    if backwards >= MAX_DECREASING_SHARE and period and int(time.min()) >= 0:
        raise wraps_too_fast(period, where)


def wraps_too_fast(period: float, where: str) -> InputError:
    """Return the error of a counter that wraps too fast. ``period`` is its period, s."""
    return InputError(
        f"{where}: the counter of the time wraps every {period:.3g} s, which is too fast for the rate of the rows, "
        "so their times are ambiguous; specify another time column"
    )


def recordings(time: Nanoseconds, *, pauses: bool) -> list[slice]:
    """Return the rows of each recording. Between two recordings the clock goes back or, if ``pauses``, jumps ahead."""
    steps = np.diff(time)
    falls = np.flatnonzero((steps < 0) | ((steps > MAX_STEP_AHEAD) & pauses)) + 1
    whole = [slice(0, len(time))]
    if not len(falls) or len(falls) > max(len(time) // MIN_ROWS, 1):
        return whole
    least = max(MIN_STEP_BACK * SECOND, STEPS * float(np.median(np.abs(np.diff(time)))))
    ends = [0]
    for fall in falls.tolist():
        enough = min(fall - ends[-1], len(time) - fall) >= MIN_ROWS
        if enough and abs(int(time[fall - 1]) - int(time[fall])) > least:
            ends.append(fall)
    parts = [slice(*ends) for ends in pairwise([*ends, len(time)])]
    spans = sorted((int(time[p].min()), int(time[p].max())) for p in parts)
    gaps = [begin - end for (_, end), (begin, _) in pairwise(spans)]
    # without gaps: one recording, reordered
    return whole if all(-least < gap < least for gap in gaps) else parts


def _rate_by_rows(time: Nanoseconds, parts: list[slice]) -> float:
    """Return the rows per second of a clock with wrong fractions; 0 if the recordings do not last one second each."""
    inner = parts[1:-1]
    first = np.array([int(time[p].min()) for p in inner])
    rows = float(np.median([p.stop - p.start for p in inner]))
    apart = float(np.median(np.diff(first))) or float(np.median([np.ptp(time[p]) for p in inner])) * rows / (
        rows - 1
    )
    return rows if abs(apart / SECOND - 1) < 0.1 else 0.0


def _stray(time: Nanoseconds) -> NDArray[np.bool_]:
    """Mark rows with wrong times: a few rows whose times are far from those of the rows around them."""
    stray = np.zeros(len(time), bool)
    steps = np.diff(time)
    jumps = np.flatnonzero((steps < 0) | (steps > MIN_DATE)) + 1  # ahead: the clock was set
    far = max(MIN_TIME_ERROR * SECOND, 100 * float(np.median(np.abs(steps)))) if len(time) > 1 else 0.0
    near = (jumps[:, None] + np.arange(-MIN_ROWS, MIN_ROWS)).ravel() if len(jumps) <= MAX_JUMPS else jumps[:0]
    for k in near[(near >= 0) & (near < len(time))].tolist():
        around = time[max(k - MIN_ROWS, 0) : k + MIN_ROWS + 1]
        stray[k] = abs(int(time[k]) - int(np.partition(around, len(around) // 2)[len(around) // 2])) > far
    return stray


def choose_part(time: Nanoseconds, part: int | None, role: Role, where: str) -> tuple[slice, str]:
    """Return the rows of the chosen recording, and a sentence or "". Refuse several recordings if none is chosen."""
    # a receiver may be without fixes for hours; after a jump ahead, the span of the IMU selects the fixes
    parts = recordings(time, pauses=role == "imu")
    if len(parts) == 1:
        note = f"{where}: the clock does not restart, so --part does not select rows"
        return parts[0], note if part else ""
    if part is None and len(parts) > MAX_SECONDS and (rate := _rate_by_rows(time, parts)):
        raise InputError(
            f"{where}: the clock goes back {len(parts) - 1} times, about once per second; if the fractions of seconds "
            "lack leading zeros, or whole seconds are missing, compute the time from the row number: "
            f'--map "{role}.t=row/{rate:.4g}"'
        )
    lengths = [f"{(int(time[p].max()) - int(time[p].min())) / SECOND:.1f} s" for p in parts]
    many = f"{len(parts)} recordings ({list_names(lengths)})"
    ahead = (int(time[parts[1].start]) - int(time[parts[1].start - 1])) / SECOND
    what = "restarts" if ahead < 0 else f"jumps by {ahead:.0f} s"
    message = f"{where}: the clock {what} at row {parts[1].start + 1}: {many}"
    if part is None:
        raise InputError(f"{message}; import each recording separately: --part 1 to --part {len(parts)}")
    if not 1 <= part <= len(parts):
        raise InputError(f"{message}; there is no recording {part}; choose --part 1 to --part {len(parts)}")
    return parts[part - 1], f"{message}; recording {part} is used"


def in_burst(time: Nanoseconds, role: Role) -> NDArray[np.bool_]:
    """Mark steps, (n - 1,), that are so short that both rows may belong to one time stamp or burst."""
    steps = np.diff(time)
    step = int(np.sum(np.maximum(steps, 0))) / max(len(steps), 1)
    small = max(MAX_BURST_STEP * step, 1.0)
    return (steps >= 0) & (steps < min(small, MAX_BURST_INTERVAL * MAX_STEP[role] * SECOND))


def spread_stamps(
    time: Nanoseconds, role: Role, where: str, *, arrival: bool = True
) -> tuple[Nanoseconds, str]:
    """Spread rows that share a stamp or arrive in bursts evenly. Refuse shared stamps of rows without a constant rate.

    At a constant rate, the stamps minus a straight line over the rows are in a band. The times are at its upper edge
    for coarse stamps, which are rounded down, and at its lower edge for arrival times, which are late. Pairs of rows
    are two messages of one measurement, or two sensors, rather than a buffer, and keep their times. Without
    ``arrival``, only coarse stamps are spread.
    """
    if len(time) < 3:
        return time, ""
    steps = np.diff(time)
    step = max(int(np.sum(steps)) / len(steps), 1.0)
    shared, ahead = float(np.mean(steps == 0)), steps[steps > 0]
    if not len(ahead):
        raise InputError(
            f"{where}: all {len(time)} rows have the same time; specify a finer time with --map {role}.t=..., or, if "
            f'the rate is known, compute it from the row number: --map "{role}.t=row/100" for 100 Hz (replace 100 by '
            "the rate of this log)"
        )
    if (rounding := _rounding_of_days(time, int(ahead.min()))) > MIN_DAY_ROUNDING * step:
        seen = f"the times in days are rounded to {rounding / SECOND:.3g} s"
        if (even := _spread_days(time, rounding)) is not None:
            spread = f"rows are spread evenly at a constant rate of {SECOND / even[1]:.4g} Hz"
            return even[0], f"{seen}; {spread} (if they were truncated instead of rounded, all are too early)"
        if rounding > MAX_DAY_ROUNDING * step and shared < MIN_REFUSED_SHARE:
            raise InputError(
                f"{where}: {seen}, but rows of the {role} are {step / SECOND:.3g} s apart, and their rate is not "
                "constant; write the times with more decimals"
            )
    near = in_burst(time, role)
    first = np.flatnonzero(np.append(True, ~near))  # row of each stamp or burst
    sizes, apart_in_burst = np.diff(first, append=len(time)), float(np.mean(near[steps > 0]))
    pairs = np.mean(sizes) < 3 and np.mean(sizes != 2) <= MAX_ODD_SHARE and apart_in_burst >= MIN_BURST_SHARE
    if pairs or (shared <= MAX_REPEATED_SHARE and np.mean(near) < MIN_BURST_SHARE):
        return time, ""
    apart = np.diff(time[first])
    length = float(np.median(apart)) if len(apart) else step
    off_grid = np.abs(apart - np.round(apart / length) * length) > MIN_STEP_VARIATION * length
    coarse = apart_in_burst < 0.5 and np.mean(off_grid) < 0.5
    if not coarse and not arrival:
        return time, ""
    late, low, high, step = _bands(time, first if coarse else first[1:] - 1, length)
    even = np.mean(high - low <= MAX_BAND * length) >= MIN_EVEN_SHARE
    if coarse and (not even or _lost(late[first] / step, apart, length)):
        fine = _by_stamp(time[first], sizes)
        if fine is not None:
            spread = f"rows with the same stamp are spread evenly over the {length / SECOND:.4g} s after this stamp"
            return fine, f"the stamps are coarse and the rate is not constant; {spread}"
    if even:
        edge = np.minimum(high, (high + low + length) / 2) if coarse else low
        fine = np.maximum.accumulate(time + np.round(edge - late).astype(np.int64))
        kind = "are coarse" if coarse else "are the times of arrival"
        return fine, f"the stamps {kind}; rows are spread evenly at a constant rate of {SECOND / step:.4g} Hz"
    if shared < MIN_REFUSED_SHARE:
        return time, ""
    lost, begin = int(np.count_nonzero(steps == 0)), f"{time[0] / SECOND:.10g} + " if time[0] else ""
    rate, example = (SECOND / step, "") if len(first) >= MIN_STAMPS else (100, " for 100 Hz")
    raise InputError(
        f"{where}: {lost} of {len(time)} rows ({shared:.0%}) repeat the previous time, so the times of the {role} are "
        f"too coarse; specify a finer time with --map {role}.t=..., or, if the rate is constant, --map "
        f'"{role}.t={begin}row/{rate:.4g}"{example}'
    )


def _rounding_of_days(time: Nanoseconds, smallest: int) -> float:
    """Return the last decimal of times in days, ns, if all times have this resolution; otherwise 0.

    ``smallest`` is the smallest step between different times, ns.
    """
    units = (unit for unit in DAY_DECIMALS if unit <= smallest + MAX_DEVIATION)
    passed = time - time[0]
    return next((u for u in units if np.abs(passed - np.round(passed / u) * u).max() <= MAX_DEVIATION), 0.0)


def _spread_days(time: Nanoseconds, rounding: float) -> tuple[Nanoseconds, float] | None:
    """Spread rows with rounded times in days evenly.

    Return the times and the step, ns, or None if the rate is not constant.
    """
    length = max(rounding, float(np.median(np.diff(time))))
    late, low, high, step = _bands(time, np.arange(len(time)), length)
    even = high - low <= MAX_BAND * rounding
    if np.mean(even) < MIN_EVEN_SHARE:
        return None
    moves = np.where(even, (low + high) / 2 - late, 0.0)
    return np.maximum.accumulate(time + np.round(moves).astype(np.int64)), step


def _lost(late: Array, apart: Nanoseconds, length: float) -> bool:
    """Return True if rows are lost. In this case ``late`` (m,), stamps minus a constant rate, in rows, drifts."""
    paused = np.append(0, np.cumsum(apart > MAX_PAUSE * length))

    def growth(k: int) -> float:
        changes = (late[k:] - late[:-k])[paused[k:] == paused[:-k]]
        return float(np.var(changes)) if len(changes) else 0.0

    return growth(min(WINDOW, max(len(late) // 3, 1))) > MIN_GROWTH * growth(1) + MIN_WALK


def _by_stamp(stamps: Nanoseconds, sizes: NDArray[np.intp]) -> Nanoseconds | None:
    """Spread the rows of each stamp (m,) over its interval. Return None if the numbers of rows are uneven."""
    apart, usual = np.diff(stamps), float(np.median(sizes))
    length = int(np.median(apart))
    uneven = np.abs(apart - length) > MAX_LOST * length
    inner = sizes[1:-1] if len(sizes) > 3 else sizes
    odd = np.abs(inner - usual) > max(1.0, MAX_LOST * usual)
    if usual < 2 or len(sizes) < MIN_STAMPS or max(np.mean(odd), np.mean(uneven)) > MAX_UNEVEN_SHARE:
        return None
    lengths = np.append(np.where(uneven, np.minimum(apart, length), apart), length)
    # The first and last stamp, and stamps next to a pause, may have only a part of their rows.
    begins, ends = np.append(True, uneven), np.append(uneven, True)
    whole = np.where(begins | ends, np.maximum(sizes, usual), sizes)
    place = np.arange(sizes.sum()) - np.repeat(
        np.cumsum(sizes) - sizes - np.where(begins, whole - sizes, 0), sizes
    )
    return np.repeat(stamps, sizes) + np.round(place / np.repeat(whole / lengths, sizes)).astype(np.int64)


def _bands(time: Nanoseconds, known: NDArray[np.intp], length: float) -> tuple[Array, Array, Array, float]:
    """Return the stamps minus a line over the rows, the lower and upper edges of the band (n,), and the slope, ns.

    ``known`` contains the rows through which the line is fitted. ``length`` is the usual step between different stamps,
    ns.
    """
    steps = np.diff(time)
    pauses = np.where(steps > MAX_PAUSE * length, steps - round(length), 0)
    edges, since = np.flatnonzero(pauses) + 1, time - time[0] - np.append(0, np.cumsum(pauses))
    # without the groups of rows next to a pause, which may be incomplete
    known = np.setdiff1d(known, np.concatenate([[0], edges, edges - 1]))
    of = np.append(0, np.cumsum(pauses > 0))[known]  # a pause changes the phase of the stamps
    rows, times = (
        v - (np.bincount(of, v) / np.maximum(np.bincount(of), 1))[of] for v in (known, since[known])
    )
    step = float(rows @ times / (rows @ rows)) if np.any(rows) else length
    late = since - step * np.arange(len(time))
    window, parts = max(round(WINDOW * length / max(step, 1.0)), 3), np.split(late, edges)
    filters = (minimum_filter1d, maximum_filter1d)
    low, high = (np.concatenate([edge(part, window, mode="nearest") for part in parts]) for edge in filters)
    return late, low, high, step


def sorted_times(
    time: Nanoseconds, role: Role, where: str, part: int | None, say: Say
) -> tuple[Nanoseconds, NDArray[np.int64]]:
    """Return a table's times (n,), strictly increasing, and the indices of their rows."""
    rows = np.flatnonzero(~_stray(time))
    if len(rows) < len(time):
        say(
            f"{where}: {rows_left_out(len(time) - len(rows))}, since the time is far from that of the adjacent rows"
        )
    taken, chosen = choose_part(time[rows], part, role, where)
    rows = rows[taken]
    time = time[rows]
    if chosen:
        say(chosen)
    if backwards := int(np.count_nonzero(np.diff(time) < 0)):
        order = np.argsort(time, kind="stable")
        say(f"{where}: the time decreases at {count_of(backwards, 'row')}; the rows are sorted by time")
        time, rows = time[order], rows[order]
    time, note = spread_stamps(time, role, where)
    if note:
        say(f"{where}: {note}")
    new = np.diff(time, prepend=time[0] - 1) > 0
    if not new.all():
        say(
            f"{where}: {rows_left_out(int(np.count_nonzero(~new)))}, since the time of the previous row is repeated"
        )
    return time[new], rows[new]


def require_likely(time: Nanoseconds, role: Role, where: str, text: str) -> None:
    """Refuse times whose steps, read as seconds, are impossible for a car's sensor, since their unit is not seconds."""
    step = float(np.median(np.diff(time))) / SECOND if len(time) > 2 else MIN_STEP * 2
    if MIN_STEP / 2 < step < 4 * MAX_STEP[role]:
        return
    remedy = "map another column as the time"
    for unit, factor in reversed(UNITS.items()):
        if MIN_STEP < step * factor < MAX_STEP[role]:
            remedy = f'if the times are in {unit}, write --map "{role}.t=({text})*{factor:g}"'
    raise InputError(
        f"{where}: with {text} in seconds, rows of the {role} would be {step:.4g} s apart; {remedy}"
    )
