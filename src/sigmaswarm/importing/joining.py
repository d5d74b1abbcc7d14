"""The parts of a role joined into one table: times in order, rows complete; omissions are reported."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.importing.clocks import SECOND, Nanoseconds
from sigmaswarm.importing.gather import Columns
from sigmaswarm.importing.places import Say, Values, good_places, with_longitudes
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.timeline import in_order, require_likely
from sigmaswarm.wording import shown

LEAST_STD = 1e-6
"""m: a stated standard deviation not above it means that the receiver states none."""
TURNS = {"course": 2 * np.pi, "theta": 2 * np.pi, "lon": 360.0}
"""Columns of angles, with a full turn: rad, rad, deg."""
SPARSE = 0.1
"""An optional column that is empty in more than this share of the rows is left out, instead of the rows."""


def join(
    parts: Sequence[Columns], role: Role, required: Sequence[str], say: Say, recording: int | None = None
) -> tuple[Nanoseconds, Values]:
    """One table of a role's parts: at the first part's times, the others interpolated between their neighbours.

    Parameters
    ----------
    recording : its number, from 1, if a clock restarts within a table
    """
    first, *others = [_in_order(part, role, recording, say) for part in parts]
    time, values = first
    for other_time, other in others:
        if not len(other_time):
            continue
        inside = (time >= other_time[0]) & (time <= other_time[-1])
        if left := int(np.count_nonzero(~inside)):
            say(f"{role}: {left} rows left out, since not all its tables have begun or still go on there")
        if not inside.any():
            raise InputError(f"the {role}: its tables have no time in common; put them on one clock")
        time, values = time[inside], {k: v[inside] for k, v in values.items()}
        since = other_time[0] if len(other_time) else 0
        for name, column in other.items():
            known = np.isfinite(column)
            if known.any():
                target = name.removeprefix("+")
                added = values.get(target, 0.0) if name.startswith("+") else 0.0
                values[target] = added + _between(
                    (time - since) / SECOND,
                    (other_time[known] - since) / SECOND,
                    column[known],
                    TURNS.get(target),
                )
    return _complete_rows(time, values, role, required, say)


def _between(time: Array, known: Array, values: Array, turn: float | None) -> Array:
    """Values (n,) at times (n,), s, straight between those (m,) at times (m,), s; of an angle the short way round.

    An angle that its neighbors have within half a turn stays there; others, unwrapped or no angle at all, stay near
    their neighbors, so that a wrong unit is still seen.
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


def _in_order(part: Columns, role: Role, number: int | None, say: Say) -> tuple[Nanoseconds, Values]:
    """A part's rows with their times strictly increasing."""
    table = shown(part.part.table)
    if part.unkept:
        say(
            f"{role}: {part.unkept} of {part.seen} rows of {table} left out: {part.part.columns['keep']} is not true"
        )
    if part.timeless:
        say(f"{role}: {part.timeless} rows of {table} without a time left out")
    time, values = part.time, part.values
    if not len(time):
        why = "no usable row; --show shows what it holds"
        if part.timeless:
            why = "no time within 292 years of 1970; say its column and unit with --time"
        raise InputError(f"the {role}: {table} holds {why}")
    where = f"{role}: {table}"
    for name, (value, count) in part.placeholders.items():
        say(f"{where}: {count} values of {shown(name)} are {value:g}, a placeholder: left out")
    filled = np.any([np.isfinite(v) for v in values.values()] or [np.ones(len(time), bool)], axis=0)
    if 0 < (empty := int(np.count_nonzero(~filled))) < 0.5 * len(time):
        say(f"{role}: {empty} rows with an empty cell left out")
    if role == "gps":
        filled &= ~_repeats(time, values)
    if filled.any():
        time, values = time[filled], {k: v[filled] for k, v in values.items()}
    line = in_order(time, role, where, number)
    for note in line.notes:
        say(note)
    require_likely(line.time, role, where, part.part.columns["t"])
    values = {k: v[line.rows] for k, v in values.items()}
    if role not in ("gps", "truth"):
        return line.time, values
    good = good_places(line.time, values, role, say)
    return line.time[good], with_longitudes({k: v[good] for k, v in values.items()}, role, say)


def _repeats(time: Nanoseconds, values: Values) -> NDArray[np.bool_]:
    """The rows (n,) that repeat the row before, its time and its place."""
    same = np.diff(time) == 0
    for name in ("lat", "lon", "x", "y"):
        if name in values:
            same &= np.diff(values[name]) == 0
    return np.concatenate([[False], same])


def _complete_rows(
    time: Nanoseconds, values: Values, role: Role, required: Sequence[str], say: Say
) -> tuple[Nanoseconds, Values]:
    """Rows without gaps: columns mostly empty are left out, then rows with an empty cell."""
    for name in required:
        if name not in values or not np.isfinite(values[name]).any():
            raise InputError(f"the {role}: nothing gives {name}; say what does with --map {role}.{name}=...")
    values = dict(values)
    for name in ("std_x", "std_y"):
        if name in values:
            values[name] = np.where(values[name] > LEAST_STD, values[name], np.nan)
    positions = ("lat", "lon", "x", "y")
    together = (("std_x", "std_y"), ("speed", "course"), ("vx", "vy"))
    # positions may be sparse (one table with IMU and fixes); other sparse columns are omitted
    placed = np.all(
        [np.isfinite(values[n]) for n in positions if n in values] or [np.ones(len(time), bool)], axis=0
    )
    for name in [n for n in values if n not in positions and n not in required]:
        empty = ~np.isfinite(values[name][placed]) if name in values and placed.any() else np.zeros(0)
        if empty.size and np.mean(empty) > SPARSE:
            gone = next((pair for pair in together if name in pair), (name,))
            if not empty.all():
                say(f"{role}: {' and '.join(gone)} left out, empty in {np.mean(empty):.0%} of the rows")
            for other in gone:
                values.pop(other, None)
    full = np.all([np.isfinite(v) for v in values.values()] or [np.ones(len(time), bool)], axis=0)
    if not full.any():
        raise InputError(
            f"the {role}: no row has all of {', '.join(values)}; leave one out with --map {role}.NAME="
        )
    sparse = role == "gps" and np.mean(placed) < 0.5
    if (left := int(np.count_nonzero(~full))) and not sparse:
        say(f"{role}: {left} rows with an empty cell left out")
    time, values = time[full], {k: v[full] for k, v in values.items()}
    return (time, values) if role != "gps" else _changed_only(time, values, say)


def _changed_only(time: Nanoseconds, values: Values, say: Say) -> tuple[Nanoseconds, Values]:
    """Fixes that are repeated until the next one comes (a table at the IMU's rate) count once."""
    position = [values[n] for n in ("lat", "lon", "x", "y") if n in values]
    if not position:
        return time, values
    changed = np.append(True, np.any([np.diff(p) != 0 for p in position], axis=0))
    if len(time) < 10 or np.mean(changed) > 0.5:
        return time, values
    say(f"gps: {int(np.count_nonzero(~changed))} rows that repeat the position before left out")
    return time[changed], {k: v[changed] for k, v in values.items()}
