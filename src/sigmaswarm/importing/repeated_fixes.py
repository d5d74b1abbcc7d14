"""Find rows that repeat a fix: further messages, tables at the IMU's rate, and interpolated positions."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import Nanoseconds
from sigmaswarm.importing.positions import Say, Values
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.timeline import MAX_REPEATED_SHARE, in_burst, spread_stamps
from sigmaswarm.wording import rows_left_out

POSITIONS = ("lat", "lon", "x", "y")
# Largest differences between the coordinates of a fix in two messages
MAX_ROUNDED_DEGREES, MAX_ROUNDED_M = 1e-5, 1.0
# Corners of an interpolated path: smallest bend relative to the median bend, smallest number of corners, and smallest
# fraction of corners at a constant interval
MIN_CORNER, MIN_CORNERS, MIN_REGULAR_SHARE = 8.0, 20, 0.9
# Largest rounding error of a second difference, in steps of the last digit; the exact limit is two steps
MAX_ROUNDING = 2.5
# Time stamps are spread over all rows, also those without a fix, only if a larger share of rows repeats the previous
# time stamp
MIN_SHARED = 0.5
# Largest number of changes of the position within bursts, relative to the number of bursts, if each burst is one fix
MAX_OTHER_SHARE = 0.1


def select(values: Values, rows: Any) -> Values:
    return {name: column[rows] for name, column in values.items()}


def finite(values: Values, count: int) -> NDArray[np.bool_]:
    """Mark finite values, (columns, rows). If there are no columns, return one row of True."""
    return np.array([np.isfinite(v) for v in values.values()] or [np.ones(count, bool)], bool)


def without_repeats(
    time: Nanoseconds, values: Values, role: Role, where: str, say: Say
) -> tuple[Nanoseconds, Values]:
    """Leave out empty rows, copies of rows and further messages of a fix, and spread coarse stamps that fixes share."""
    filled = np.asarray(finite(values, len(time)).any(axis=0), bool)
    again = np.zeros(len(time), bool)
    if role != "imu":
        time, again, coarse = _separate_stamps(time, values, role, filled, _messages(time, values))
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
    return (time[filled], select(values, filled)) if filled.any() else (time, values)


def _separate_stamps(
    time: Nanoseconds,
    values: Values,
    role: Role,
    filled: NDArray[np.bool_],
    again: NDArray[np.bool_],
) -> tuple[Nanoseconds, NDArray[np.bool_], str]:
    """Spread coarse time stamps that fixes share. Otherwise, add rows that repeat time and position to ``again``.

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
    """Mark rows that repeat an earlier row. Return None if there are none, or if rows with equal times differ."""
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

    If rows have equal times but different filled cells, their positions may differ by rounding, or one of them may have
    no position. No row is marked if the position often changes within bursts.
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


def distinct_fixes(time: Nanoseconds, values: Values, say: Say) -> tuple[Nanoseconds, Values]:
    """Leave out rows between fixes, in which the previous position is repeated or positions are interpolated."""
    position = [values[n] for n in POSITIONS if n in values]
    if not position or len(time) < 10:
        return time, values
    changed = np.append(True, np.any([np.diff(p) != 0 for p in position], axis=0))
    if np.mean(changed) <= 0.5:  # in a table at the IMU's rate, each fix is repeated up to the next fix
        say(f"gps: {rows_left_out(int(np.count_nonzero(~changed)))}, since the previous position is repeated")
        return time[changed], select(values, changed)
    if (fixes := _interpolated(position)) is None:
        return time, values
    left, every = rows_left_out(len(time) - len(fixes)), round(len(time) / len(fixes))
    say(f"gps: {left}, since positions are interpolated between fixes; about one of {every} rows has a fix")
    return time[fixes], select(values, fixes)


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
