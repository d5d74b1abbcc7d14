"""Join the parts of a role into one table with sorted times and complete rows; report omissions."""

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import NO_HEADING
from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import SECOND, Nanoseconds
from sigmaswarm.importing.gather import PartColumns
from sigmaswarm.importing.positions import Say, Values, valid_positions, with_longitudes
from sigmaswarm.importing.source import Part, Role
from sigmaswarm.importing.table_columns import scaled_column
from sigmaswarm.importing.timeline import (
    MAX_REPEATED_SHARE,
    from_digits,
    in_burst,
    recordings,
    require_likely,
    require_unwrappable,
    sorted_times,
    spread_stamps,
    unwrap,
)
from sigmaswarm.wording import count_of, list_names, printable, rows_left_out

MIN_STD = 1e-6  # m or rad; a standard deviation of at most this value counts as missing
# Period of each angle column, rad or deg
PERIODS = {"course": 2 * np.pi, "heading": 2 * np.pi, "theta": 2 * np.pi, "lon": 360.0}
# If a larger fraction of an optional column's cells is empty, the column is left out; otherwise the rows with an empty
# cell are left out
MAX_EMPTY_SHARE = 0.1
# Time stamps are spread over all rows, also those without a fix, only if a larger share of rows repeats the previous
# time stamp
MIN_SHARED = 0.5
# Largest number of changes of the position within bursts, relative to the number of bursts, if each burst is one fix
MAX_OTHER_SHARE = 0.1
# s, largest difference between the first times of two tables of a sensor, apart from an offset of their clocks
MAX_START = 5.0
EVER = (-np.inf, np.inf)  # span of a table without rows, s
RECIPE = "correct their times in a recipe (--show --save-recipe FILE writes one), and import with --recipe"
POSITIONS = ("lat", "lon", "x", "y")
# Largest differences between the coordinates of a fix in two messages
MAX_ROUNDED_DEGREES, MAX_ROUNDED_M = 1e-5, 1.0
# Corners of an interpolated path: smallest bend relative to the median bend, smallest number of corners, and smallest
# fraction of corners at a constant interval
MIN_CORNER, MIN_CORNERS, MIN_REGULAR_SHARE = 8.0, 20, 0.9
# Largest rounding error of a second difference, in steps of the last digit; the exact limit is two steps
MAX_ROUNDING = 2.5
MAX_RATE_RATIO = 1.5  # larger ratios of the rates of a sensor's parts are reported
COLUMN_PAIRS = (("std_x", "std_y"), ("speed", "course"), ("vx", "vy"), ("heading", "std_heading"))


def join(
    parts: Sequence[PartColumns], role: Role, required: Sequence[str], say: Say, recording: int | None = None
) -> tuple[Nanoseconds, Values]:
    """Join a role's parts at the times of the first part; other parts are interpolated linearly.

    ``recording`` is the number of the recording, counted from 1, if a clock restarts within a table.
    """
    if role == "imu":
        parts = [piece for part in parts for piece in part.separated(required)]
    (time, values), *others = [_in_order(part, role, recording, say) for part in parts]
    times = (time, *(t for t, _ in others))
    spans = [(t[0] / SECOND, t[-1] / SECOND) if len(t) else EVER for t in times]
    if apart := without_overlap(role, [part.part for part in parts], spans):
        raise InputError(apart)
    for other_time, other in others:
        if not len(other_time):
            continue
        if role == "imu" and (apart := _other_rate(time, values, other_time, other)):
            say(f"imu: {apart}")
        inside = (time >= other_time[0]) & (time <= other_time[-1])
        if left := int(np.count_nonzero(~inside)):
            say(f"{role}: {rows_left_out(left)}, since not all tables of the sensor cover their times")
        if not inside.any():
            raise InputError(
                f"{role}: no row of the first table lies within the time span of another table; {RECIPE}"
            )
        time, values = time[inside], {k: v[inside] for k, v in values.items()}
        at, known_at = ((t - other_time[0]) / SECOND for t in (time, other_time))
        for name, column in other.items():
            known = np.isfinite(column)
            if known.any():
                target = name.removeprefix("+")
                added = values.get(target, 0.0) if name.startswith("+") else 0.0
                values[target] = added + _between(at, known_at[known], column[known], PERIODS.get(target))
    return _complete_rows(time, _with_known_headings(values), role, required, say)


def without_overlap(role: Role, parts: Sequence[Part], spans: Sequence[tuple[float, float]]) -> str:
    """Describe a part whose span (begin and end, s) does not overlap that of the first part; otherwise return ""."""
    for part, (begin, end) in zip(parts[1:], spans[1:], strict=False):
        first = spans[0]
        if begin <= first[1] and first[0] <= end:
            continue
        seen = (
            f"{printable(name)} covers {low:.10g} to {high:.10g} s"
            for name, (low, high) in ((parts[0].table, first), (part.table, (begin, end)))
        )
        hours = round((begin - first[0]) / 3600)
        move = next((m for m in (3600 * hours, 18, -18) if m and abs(begin - first[0] - m) < MAX_START), 0)
        why = "the leap seconds" if abs(move) == 18 else f"{abs(move) // 3600} h"
        later = f"{part.columns['t']} {'-' if move > 0 else '+'} {abs(move)}"
        example = f', for example t = "{later}" for {printable(part.table)}, since the clocks differ by {why}'
        apart = f"{' and '.join(seen)}, so the tables do not overlap in time"
        return f"{role}: {apart}; {RECIPE}{example if move else ''}"
    return ""


def _other_rate(time: Nanoseconds, values: Values, other_time: Nanoseconds, other: Values) -> str:
    """Describe the rate of the joined table if it differs from that of the other table; otherwise return ""."""
    if min(len(time), len(other_time)) < 2:
        return ""
    rate, other_rate = (SECOND / float(np.median(np.diff(t))) for t in (time, other_time))
    if max(rate / other_rate, other_rate / rate) < MAX_RATE_RATIO:
        return ""
    names = list_names(name.removeprefix("+") for name in other)
    known = f"at the times of {list_names(values)}, {rate:.4g} Hz"
    return f"{names}, recorded at {other_rate:.4g} Hz, are interpolated {known}"


def _with_known_headings(values: Values) -> Values:
    """Set the standard deviation of missing headings to `NO_HEADING`; the fixes without a heading remain."""
    heading = values.get("heading", np.zeros(0))
    std, known = values.get("std_heading", np.full(len(heading), np.nan)), np.isfinite(heading)
    if not known.any() or (known.all() and not np.isfinite(std).any()):
        return {name: column for name, column in values.items() if name != "std_heading"}
    stated = np.where(std > MIN_STD, std, MIN_STD)  # negligible next to the variance that the filter adds
    deviation = np.where(known, stated, NO_HEADING)
    return {**values, "heading": np.where(known, heading, 0.0), "std_heading": deviation}


def _between(time: Array, known: Array, values: Array, turn: float | None) -> Array:
    """Interpolate values (m,) at times ``known`` (m,), s, linearly to ``time`` (n,), s; angles along the shorter arc.

    ``turn`` is the period of an angle, or None. Values beyond half a period, which are unwrapped or in a wrong unit,
    are not wrapped, so a wrong unit remains visible.
    """
    if turn is None:
        return np.interp(time, known, values)
    before = np.clip(np.searchsorted(known, time, side="right") - 1, 0, len(known) - 1)
    after = np.minimum(before + 1, len(known) - 1)
    apart = values[after] - values[before]
    apart -= turn * np.round(apart / turn)
    length = np.where(after > before, known[after] - known[before], 1.0)
    share = np.clip((time - known[before]) / length, 0.0, 1.0)
    angle = values[before] + share * apart
    wraps = (np.abs(angle) > turn / 2) & (np.abs(values[before]) <= turn / 2)
    return np.where(wraps, angle - np.copysign(turn, angle), angle)


def _in_order(part: PartColumns, role: Role, number: int | None, say: Say) -> tuple[Nanoseconds, Values]:
    time, values = part.finish()
    table = printable(part.part.table)
    where = f"{role}: {table}"
    if part.unkept:
        keep = part.part.columns["keep"]
        say(f"{role}: {part.unkept} of {part.seen} rows of {table} are left out, since {keep} is not true")
    if part.timeless:
        say(f"{role}: {rows_left_out(part.timeless, f' of {table}')}, since the time is missing")
    if not len(time):
        why = "no usable row; --show shows the contents of the log"
        if part.timeless:
            why = f"no time within 292 years of 1970; specify its column and unit with --map {role}.t=..."
        raise InputError(f"{role}: {table} contains {why}")
    for name, (value, count) in part.placeholders.items():
        are = "is" if count == 1 else "are"
        say(
            f"{where}: {count_of(count, 'value')} of {printable(name)} {are} left out, since {value:g} is a placeholder"
        )
    tick = (scaled_column(part.part.columns["t"]) or ("", 0.0))[1]
    require_unwrappable(time, tick, where)
    # from all rows: a counter may wrap before the first fix
    time, part.period, note = unwrap(time, tick, where, parts=bool(number))
    filled = np.asarray(_finite(values, len(time)).any(axis=0), bool)
    again = np.zeros(len(time), bool) if role == "imu" else _messages(time, values)
    if role != "imu":
        time, again, coarse = _separate_stamps(time, values, role, filled, again)
        if coarse:
            say(f"{where}: {coarse}")
    if 0 < (empty := int(np.count_nonzero(~filled))) < 0.5 * len(time):
        say(f"{role}: {rows_left_out(empty)}, since a cell is empty")
    if (copies := _copies(time, values)) is not None:
        say(f"{where}: {rows_left_out(int(copies.sum()))}, since other rows have the same content")
        filled &= ~copies
    if role == "gps" and (repeated := int(np.count_nonzero(filled & again))):
        say(f"{role}: {rows_left_out(repeated)}, since the previous position is repeated")
        values = _with_repeated(values, again)
        filled &= ~again
    if filled.any():
        time, values = time[filled], _rows(values, filled)
    if not note:  # rows without values, now left out, may have had other times
        time, digits = from_digits(time)
        time, part.period, note = unwrap(time, tick, where, parts=bool(number))
        note = "; ".join(filter(None, (digits, note)))
    if note:
        say(f"{where}: {note}")
    part.unordered = bool((np.diff(time) < 0).any())
    chosen = recordings(time, pauses=role == "imu") if number else []
    ends = [(int(time[r.start]), int(time[r.stop - 1])) for r in chosen]
    back = [end - begin for (_, end), (begin, _) in pairwise(ends)]
    part.set_back, part.set_ahead = sum(back[: (number or 1) - 1]), any(step < 0 for step in back)
    time, rows = sorted_times(time, role, where, number, say)
    require_likely(time, role, where, part.part.columns["t"])
    values = _rows(values, rows)
    if role not in ("gps", "truth"):
        return time, values
    good = valid_positions(time, values, role, say)
    return time[good], with_longitudes(_rows(values, good), role, say)


def _separate_stamps(
    time: Nanoseconds,
    values: Values,
    role: Role,
    filled: NDArray[np.bool_],
    again: NDArray[np.bool_],
) -> tuple[Nanoseconds, NDArray[np.bool_], str]:
    """Spread coarse time stamps that fixes share, or else add rows that repeat time and position to ``again``.

    Return times, marks, and a sentence if the times changed.
    """
    steps, fixes = np.diff(time), time[filled & ~again]
    if np.count_nonzero(steps == 0) <= MIN_SHARED * len(time) or (steps < 0).any():
        return time, again, ""
    if np.count_nonzero(np.diff(fixes) == 0) > MAX_REPEATED_SHARE * len(fixes):
        # the number of rows between fixes shows the time of a fix between two coarse stamps
        with suppress(InputError):
            spread, note = spread_stamps(time, role, "", arrival=False)
            if note:
                return spread, again, note
    return time, again | np.append(False, (steps == 0) & _same_position(values)), ""


def _copies(time: Nanoseconds, values: Values) -> NDArray[np.bool_] | None:
    """Mark rows that repeat an earlier row; return None if there are none, or if rows with equal times differ."""
    times = np.unique(time)
    if len(times) == len(time):
        return None
    cells = np.column_stack([time.view(np.float64), *values.values()])
    first = np.unique(cells.view(f"V{cells.strides[0]}").ravel(), return_index=True)[1]
    return ~np.isin(np.arange(len(time)), first) if len(first) == len(times) else None


def _same_position(values: Values) -> NDArray[np.bool_]:
    """Mark the rows after the first, (n - 1,), that repeat the previous position or, without positions, all values."""
    names = [n for n in POSITIONS if n in values] or list(values)
    return np.all([np.diff(values[n]) == 0 for n in names], axis=0)


def _messages(time: Nanoseconds, values: Values) -> NDArray[np.bool_]:
    """Mark rows that are further messages of the previous fix: they repeat its position within a burst.

    If rows have equal times but different filled cells, their positions may differ by rounding, or be missing in one of
    them. No row is marked if the position often changes within bursts.
    """
    filled = np.array([np.isfinite(column) for column in values.values()], np.bool_).reshape(-1, len(time))
    other = (np.diff(time) == 0) & (np.diff(filled, axis=1).any(axis=0))
    for name in values.keys() & {*POSITIONS}:
        other &= ~(
            np.abs(np.diff(values[name])) > (MAX_ROUNDED_DEGREES if name in POSITIONS[:2] else MAX_ROUNDED_M)
        )
    near, same = in_burst(time, "gps"), _same_position(values) | other
    others = np.count_nonzero(near & ~same) > MAX_OTHER_SHARE * np.count_nonzero(~near)
    return np.append(False, near & same & ~others)


def _with_repeated(values: Values, again: NDArray[np.bool_]) -> Values:
    """Fill empty cells of each fix from the rows that repeat it: RMC contains the speed, GGA the altitude."""
    first = np.maximum.accumulate(np.where(again, 0, np.arange(len(again))))
    filled = dict(values)
    for name, column in values.items():
        # in reverse order, so that the first of several values is written last
        known = np.flatnonzero(again & np.isfinite(column))[::-1]
        known = known[np.isnan(column[first[known]])]
        filled[name] = column.copy()
        filled[name][first[known]] = column[known]
    return filled


def _rows(values: Values, rows: Any) -> Values:
    return {name: column[rows] for name, column in values.items()}


def _finite(values: Values, count: int) -> NDArray[np.bool_]:
    """Mark finite values, (columns, rows); return one row of True if there are no columns."""
    return np.array([np.isfinite(v) for v in values.values()] or [np.ones(count, bool)], bool)


def without_column(role: Role, name: str) -> str:
    return f"{role}: no column contains {name}; specify one with --map {role}.{name}=..."


def _complete_rows(
    time: Nanoseconds, values: Values, role: Role, required: Sequence[str], say: Say
) -> tuple[Nanoseconds, Values]:
    """Leave out optional columns with more than 10% empty cells, then rows with an empty cell."""
    for name in required:
        if name not in values or not np.isfinite(values[name]).any():
            raise InputError(without_column(role, name))
    values = dict(values)
    for name in values.keys() & {"std_x", "std_y"}:
        values[name] = np.where(values[name] > MIN_STD, values[name], np.nan)
    # Positions may be sparse (one table with IMU and fixes); other sparse columns are left out.
    placed = _finite({n: values[n] for n in POSITIONS if n in values}, len(time)).all(axis=0)
    for name in [n for n in values if n not in POSITIONS and n not in required]:
        if name not in values or not placed.any():
            continue
        empty = ~np.isfinite(values[name][placed])
        if np.mean(empty) > MAX_EMPTY_SHARE:
            gone = next((pair for pair in COLUMN_PAIRS if name in pair), (name,))
            if not empty.all():
                are = "is" if len(gone) == 1 else "are"
                share = f"{np.mean(empty):.0%} of the cells of {name} are empty"
                say(f"{role}: {' and '.join(gone)} {are} left out, since {share}")
            values = {n: column for n, column in values.items() if n not in gone}
    full = _finite(values, len(time)).all(axis=0)
    if not full.any():
        raise InputError(
            f"{role}: no row has values in all columns ({', '.join(values)}); leave one out with --map {role}.NAME="
        )
    sparse = role == "gps" and np.mean(placed) < 0.5
    if (left := int(np.count_nonzero(~full))) and not sparse:
        say(f"{role}: {rows_left_out(left)}, since a cell is empty")
    time, values = time[full], _rows(values, full)
    position = [values[n] for n in POSITIONS if n in values]
    if role != "gps" or not position or len(time) < 10:
        return time, values
    changed = np.append(True, np.any([np.diff(p) != 0 for p in position], axis=0))
    if np.mean(changed) > 0.5:
        if (fixes := _interpolated(position)) is None:
            return time, values
        left, every = rows_left_out(len(time) - len(fixes)), round(len(time) / len(fixes))
        say(
            f"gps: {left}, since positions are interpolated between fixes; about one of {every} rows has a fix"
        )
        return time[fixes], _rows(values, fixes)
    # in a table at the IMU's rate, each fix is repeated up to the next fix
    say(f"gps: {rows_left_out(int(np.count_nonzero(~changed)))}, since the previous position is repeated")
    return time[changed], _rows(values, changed)


def _resolution(values: Array) -> float:
    """Return the smallest difference between two distinct values."""
    return float(np.min(np.diff(np.unique(values)), initial=np.inf))


def _interpolated(position: Sequence[Array]) -> NDArray[np.int64] | None:
    """Return the rows of the fixes between which a logger interpolated linearly; None if it did not interpolate.

    The path has corners only at the fixes, which are a constant number of rows apart, and is straight between them,
    except for rounding.
    """
    bends = [np.abs(np.diff(p, n=2)) for p in position[:2]]
    # If every third row is a fix, two of three rows are next to a fix.
    rounding = (MAX_ROUNDING * _resolution(p) for p in position[:2])
    if any(np.quantile(b, 0.25) > limit for b, limit in zip(bends, rounding, strict=True)):
        return None
    bend = np.max(bends, axis=0)
    corners = np.flatnonzero(bend > MIN_CORNER * float(np.quantile(bend, 0.5))) + 1
    corners = corners[np.diff(corners, prepend=-2) > 1]  # a fix between two rows bends both
    if len(corners) < MIN_CORNERS:
        return None
    steps = np.diff(corners)
    number = np.append(0.0, np.cumsum(np.round(steps / np.median(steps))))
    every, begin = np.polyfit(number, corners, 1)
    regular = np.abs(corners - begin - number * every) <= 1.0
    if every < 2 or np.mean(regular) < MIN_REGULAR_SHARE or number[-1] + 1 > 3 * len(corners):
        return None
    rows = np.round(np.arange(begin % every, len(position[0]), every)).astype(np.int64)
    return rows[rows < len(position[0])]
