"""Join the parts of a role into one table with sorted times and complete rows, and report omissions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import NO_HEADING
from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import SECOND, Nanoseconds
from sigmaswarm.importing.gather import PartColumns
from sigmaswarm.importing.positions import Say, Values, valid_positions, with_longitudes
from sigmaswarm.importing.repeated_fixes import POSITIONS, distinct_fixes, finite, select, without_repeats
from sigmaswarm.importing.source import Part, Role, texts_of
from sigmaswarm.importing.table_columns import scaled_column
from sigmaswarm.importing.timeline import (
    from_digits,
    recordings,
    require_likely,
    require_unwrappable,
    sorted_times,
    unwrap,
)
from sigmaswarm.importing.times import EVER
from sigmaswarm.wording import list_names, printable, rows_left_out

MIN_STD = 1e-6  # m or rad; a standard deviation of at most this value counts as missing
# Period of each angle column, rad or deg
PERIODS = {"course": 2 * np.pi, "heading": 2 * np.pi, "theta": 2 * np.pi, "lon": 360.0}
# If a larger fraction of an optional column's cells is empty, the column is left out; otherwise the rows with an empty
# cell are left out
MAX_EMPTY_SHARE = 0.1
# s, largest difference between the first times of two tables of a sensor, apart from an offset of their clocks
MAX_START = 5.0
RECIPE = "correct their times in a recipe (--show --save-recipe FILE writes one), and import with --recipe"
MAX_RATE_RATIO = 1.5  # larger ratios of the rates of a sensor's parts are reported
COLUMN_PAIRS = (("std_x", "std_y"), ("speed", "course"), ("vx", "vy"), ("heading", "std_heading"))


@dataclass(frozen=True)
class Clock:
    """The clock of a table."""

    time: str  # expression
    period: int = 0  # ns, if the clock wraps
    unordered: bool = False  # True if the time decreases even after `unwrap`
    set_back: int = 0  # ns, sum of the backward steps of the clock before the chosen recording
    set_ahead: bool = False  # True if the clock jumps ahead between recordings


@dataclass(frozen=True)
class Samples:
    """The complete rows of a role at strictly increasing times (n,), ns, with the clock of the first table."""

    time: Nanoseconds
    values: Values
    clock: Clock
    table: str  # name of the first table
    texts: Mapping[str, str]  # expressions of the columns


def join(
    parts: Sequence[PartColumns], role: Role, required: Sequence[str], say: Say, recording: int | None = None
) -> Samples:
    """Join a role's parts at the times of the first part. Other parts are interpolated linearly.

    ``recording`` is the number of the recording, counted from 1, if a clock restarts within a table.
    """
    if role == "imu":
        parts = [piece for part in parts for piece in part.separated(required)]
    (time, values, clock), *others = [_in_order(part, role, recording, say) for part in parts]
    times = (time, *(t for t, *_ in others))
    spans = [(t[0] / SECOND, t[-1] / SECOND) if len(t) else EVER for t in times]
    if apart := without_overlap(role, [part.part for part in parts], spans):
        raise InputError(apart)
    for other_time, other, _ in others:
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
    time, values = _complete_rows(time, _with_known_headings(values), role, required, say)
    return Samples(time, values, clock, parts[0].part.table, texts_of(part.part for part in parts))


def without_overlap(role: Role, parts: Sequence[Part], spans: Sequence[tuple[float, float]]) -> str:
    """Describe a part that does not overlap the first part in time.

    Return "" if it overlaps. Spans are begin and end, s.
    """
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
    """Set the standard deviation of missing headings to `NO_HEADING`. Fixes without a heading are kept."""
    heading = values.get("heading", np.zeros(0))
    std, known = values.get("std_heading", np.full(len(heading), np.nan)), np.isfinite(heading)
    if not known.any() or (known.all() and not np.isfinite(std).any()):
        return {name: column for name, column in values.items() if name != "std_heading"}
    stated = np.where(std > MIN_STD, std, MIN_STD)  # negligible next to the variance that the filter adds
    deviation = np.where(known, stated, NO_HEADING)
    return {**values, "heading": np.where(known, heading, 0.0), "std_heading": deviation}


def _between(time: Array, known: Array, values: Array, turn: float | None) -> Array:
    """Interpolate values (m,) at times ``known`` (m,), s, linearly to ``time`` (n,), s. Angles take the shorter arc.

    ``turn`` is the period of an angle, or None. Values beyond half a period are not wrapped, since they are unwrapped
    or in a wrong unit; thus a wrong unit remains visible.
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


def _in_order(
    part: PartColumns, role: Role, number: int | None, say: Say
) -> tuple[Nanoseconds, Values, Clock]:
    time, values = part.finish()
    table = printable(part.part.table)
    where = f"{role}: {table}"
    for note in part.omissions(role):
        say(note)
    if not len(time):
        why = "no usable row; --show shows the contents of the log"
        if part.timeless:
            why = f"no time within 292 years of 1970; specify the column and unit of the time with --map {role}.t=..."
        raise InputError(f"{role}: {table} contains {why}")
    text = part.part.columns["t"]
    tick = (scaled_column(text) or ("", 0.0))[1]
    require_unwrappable(time, tick, where)
    # from all rows: a counter may wrap before the first fix
    time, period, note = unwrap(time, tick, where, parts=bool(number))
    time, values = without_repeats(time, values, role, where, say)
    if not note:  # rows without values, now left out, may have had other times
        time, digits = from_digits(time)
        time, period, note = unwrap(time, tick, where, parts=bool(number))
        note = "; ".join(filter(None, (digits, note)))
    if note:
        say(f"{where}: {note}")
    unordered = bool((np.diff(time) < 0).any())
    chosen = recordings(time, pauses=role == "imu") if number else []
    ends = [(int(time[r.start]), int(time[r.stop - 1])) for r in chosen]
    back = [end - begin for (_, end), (begin, _) in pairwise(ends)]
    set_back, set_ahead = sum(back[: (number or 1) - 1]), any(step < 0 for step in back)
    clock = Clock(text, period, unordered, set_back, set_ahead)
    time, rows = sorted_times(time, role, where, number, say)
    require_likely(time, role, where, text)
    values = select(values, rows)
    if role not in ("gps", "truth"):
        return time, values, clock
    good = valid_positions(time, values, role, say)
    return time[good], with_longitudes(select(values, good), role, say), clock


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
    placed = finite({n: values[n] for n in POSITIONS if n in values}, len(time)).all(axis=0)
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
    full = finite(values, len(time)).all(axis=0)
    if not full.any():
        raise InputError(
            f"{role}: no row has values in all columns ({', '.join(values)}); omit one with --map {role}.NAME="
        )
    sparse = role == "gps" and np.mean(placed) < 0.5
    if (left := int(np.count_nonzero(~full))) and not sparse:
        say(f"{role}: {rows_left_out(left)}, since a cell is empty")
    time, values = time[full], select(values, full)
    return distinct_fixes(time, values, say) if role == "gps" else (time, values)
