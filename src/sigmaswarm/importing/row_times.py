"""Check times that are computed from row numbers, since each row that a logger lost shifts all later times."""

from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import white_noise
from sigmaswarm.importing.expressions import ROW
from sigmaswarm.importing.gather import PartColumns
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.table_columns import column_numbers, quoted_column
from sigmaswarm.wording import count_of, printable

# Of a column that is a clock: smallest number of changes, and smallest share of usual changes
MIN_CLOCK_STEPS, MIN_REGULAR_SHARE = 20, 0.9
MIN_LOST = 0.3  # s, smallest total length of gaps that is reported
NEIGHBORS = 5  # number of steps on each side of a gap between fixes
MIN_RATIO = 2.5  # smallest ratio of the distance across the gap to the length of these steps
MAX_TURN = 0.3  # rad, largest angle between the gap and the mean direction of these steps


def gaps_by_clock(gathered: Mapping[Role, Sequence[PartColumns]]) -> list[str]:
    """Report missing rows in tables with row numbers as times. Another column shows which rows are missing."""
    notes: list[str] = []
    for role, columns in ((role, one) for role, parts in gathered.items() for one in parts if one.counted):
        table, text = columns.part.table, columns.part.columns["t"]
        frame = pl.concat(columns.others, how="vertical_relaxed") if columns.others else pl.DataFrame()
        time = pl.DataFrame({ROW: np.arange(columns.seen)}).select(columns.expressions["t"].polars.alias("t"))
        times = time["t"].cast(pl.Float64).to_numpy()
        where, note = f"{role}: {printable(table)}", "times from row numbers do not show gaps of the logger"
        for column in frame.columns:
            clock = column_numbers(frame[column])
            if len(clock) < len(frame) or (found := _gaps_of(clock.to_numpy(), times)) is None:
                continue
            (unit, lost, row), name, note = found, quoted_column(column), ""
            if lost > MIN_LOST:
                notes.append(
                    f"{where}: according to column {name}, rows for {lost:.3g} s are missing, for example after row "
                    f"{row}, so later times from {text} are too early; instead, write --map "
                    f'"{role}.t={name}*{unit:.6g}"'
                )
                break  # another clock may count rows, and then shows no gaps
        notes += [f"{where}: {note}; after a gap, all times would be too early"] if note else []
    return notes


def _gaps_of(values: Array, time: Array) -> tuple[float, float, int] | None:
    """Return the unit of a clock (n,), s, the total length of its gaps, s, and the row before the largest gap.

    A clock increases by a constant amount. Return None for other columns. ``time`` (n,) contains times from row
    numbers.
    """
    new = np.flatnonzero(np.diff(values)) + 1
    if len(new) <= MIN_CLOCK_STEPS or not (np.diff(values) >= 0).all():
        return None
    steps, rows = np.diff(values[new]), np.diff(new)
    usual, gap = float(np.median(steps)), int(np.argmax(steps))
    if np.mean(np.abs(steps - usual) <= 0.5 * usual) < MIN_REGULAR_SHARE:
        return None
    unit = float(np.median(rows)) * float(time[-1] - time[0]) / (len(time) - 1) / usual
    return unit, unit * float(np.sum((steps - usual)[steps > 1.5 * usual])), int(new[gap + 1])


def gaps_by_distance(drive: Drive) -> str:
    """Report missing fixes if two fixes are much farther apart than the fixes around them; otherwise return ""."""
    position = drive.gps.x + 1j * drive.gps.y
    interval = np.diff(drive.gps.time)  # longer where rows without a fix are left out
    moves, noise = np.diff(position) * np.median(interval) / interval, white_noise(position)
    if len(moves) < 4 * NEIGHBORS:
        return ""
    near = np.lib.stride_tricks.sliding_window_view(moves, NEIGHBORS).mean(axis=1)
    before, after, inner = near[: -NEIGHBORS - 1], near[NEIGHBORS + 1 :], moves[NEIGHBORS:-NEIGHBORS]
    usual = np.maximum(np.abs(before), np.abs(after))
    steady = np.minimum(np.abs(before), np.abs(after)) > np.maximum(usual / 2, noise / 2)
    # position jumps of a receiver have any direction, and a jump back often follows
    ahead = np.abs(np.angle(inner * np.conj(before + after))) < MAX_TURN
    gaps = np.flatnonzero(steady & ahead & (np.abs(inner) > MIN_RATIO * usual + 6 * noise))
    if not len(gaps):
        return ""
    lost = float(np.sum(np.abs(inner[gaps]) / usual[gaps] - 1))
    return (
        f"gps: {count_of(len(gaps), 'distance')} between successive fixes, for example after fix "
        f"{gaps[0] + NEIGHBORS + 1}, {'is' if len(gaps) == 1 else 'are'} much longer than the distances before and "
        f"after, so about {lost:.0f} fixes are probably missing. The times are computed from row numbers and are too "
        "early after each gap; map the receiver's time as gps.t instead"
    )
