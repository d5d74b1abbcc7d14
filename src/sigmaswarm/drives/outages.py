"""Artificial GPS outages: windows of time whose fixes are hidden from a filter.

Windows are arrays of shape (k, 2): the start and end of each in s.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.errors import InputError

SECONDS_PER_OUTAGE = 15.0
"""s of driving per window of ``random_windows`` without a count."""


def hidden_fixes(time: ArrayLike, windows: ArrayLike) -> NDArray[np.bool_]:
    """Return a mask of the fixes (n,) s in an outage (k, 2) s, both ends included.

    Drift is measured at the end of a window, before any new fix, so a fix exactly there is hidden, too.
    """
    t = np.asarray(time, dtype=np.float64)
    starts, ends = np.sort(_checked(windows), axis=0).T
    # More have begun than are over; each fix against each window would be a gigabyte on a long drive.
    return np.searchsorted(starts, t, side="right") > np.searchsorted(ends, t, side="left")


def hide_fixes(drive: Drive, windows: ArrayLike) -> Drive:
    """Remove the fixes of a drive inside the windows (k, 2), s."""
    return replace(drive, gps=drive.gps.select(~hidden_fixes(drive.gps.time, windows)))


def random_windows(
    start: float,
    end: float,
    rng: np.random.Generator,
    *,
    length: float | tuple[float, float] = (3.0, 5.0),
    first_after: float = 10.0,
    apart: float = 5.0,
    count: int | None = None,
) -> Array:
    """Draw outages (k, 2) between two times, s, uniformly among all placements that keep the distances.

    Each has the given ``length``, or one from that range. They begin ``first_after`` s or later, at least ``apart`` s
    apart. There are at most ``count``, by default one per 15 s of the available time, and at least one.
    """
    shortest, longest = length if isinstance(length, tuple) else (length, length)
    if not (0 < shortest <= longest and first_after >= 0 and apart >= 0):
        raise InputError(
            f"outages of length {length} s, first_after {first_after:g} s, apart {apart:g} s can't be drawn; "
            "use a positive length (shortest first) and distances of 0 or more"
        )
    available = end - start - first_after
    wanted = max(round(available / SECONDS_PER_OUTAGE), 1) if count is None else count
    lengths = rng.uniform(shortest, longest, max(wanted, 0))
    # packed as tightly as allowed, each window starts and ends so long after the earliest moment
    ends = np.cumsum(lengths) + apart * np.arange(len(lengths))
    fitting = int(np.count_nonzero(ends <= available))
    ends, lengths = ends[:fitting], lengths[:fitting]
    # the remaining time is divided by sorted uniforms: every division is equally likely
    slack = np.sort(rng.uniform(0.0, available - ends[-1], fitting)) if fitting else ends
    ends = np.minimum(start + first_after + slack + ends, end)
    return np.stack([ends - lengths, ends], axis=1)


def balanced_windows(
    start: float,
    end: float,
    rng: np.random.Generator,
    *,
    length: tuple[float, float] = (3.0, 5.0),
    apart: float = 5.0,
    every: float = 12.0,
) -> Array:
    """Draw one outage in each ``every`` seconds between two times, s, so that they cover the drive, (k, 2).

    Each has a length drawn from a range, s, and is at least ``apart`` s after the start and the one before.
    """
    if not (0 < length[0] <= length[1] and apart >= 0 and every >= length[1] + apart):
        raise InputError(
            f"outages of length {length} s, apart {apart:g} s, one in every {every:g} s can't be drawn; "
            "use a positive length (shortest first), and enough seconds for each"
        )
    # One slot for each window; the remaining time makes all of them longer.
    count = int((end - start) / every) or int(end - start >= apart + length[1])
    slot = (end - start) / max(count, 1)
    lengths = rng.uniform(*length, count)
    starts = start + slot * np.arange(count) + apart + rng.uniform(0.0, 1.0, count) * (slot - apart - lengths)
    return np.stack([starts, starts + lengths], axis=1)


def snap_ends(windows: ArrayLike, imu_time: ArrayLike, *, apart: float = 5.0) -> Array:
    """Shift windows (k, 2), in order of time, so that each ends exactly on an IMU sample (n,), s.

    Each moves later, its length unchanged, to the first sample at or after its end; farther if it were else closer than
    ``apart`` to the one before. So the first keeps its distance from the start. A window that would end after the last
    sample moves earlier, onto that sample; where this brings it too close to the one before, it is left out.
    """
    samples = np.asarray(imu_time, dtype=np.float64)
    snapped: list[list[float]] = []
    free = -np.inf  # s, from where on the next window may start
    rows: list[list[float]] = _checked(windows).tolist()
    for start, end in rows:
        length = end - start
        i = min(int(np.searchsorted(samples, max(end, free + length))), len(samples) - 1)
        if samples[i] < free + length:
            continue
        snapped.append([samples[i] - length, samples[i]])
        free = samples[i] + apart
    return _checked(snapped)


def _checked(windows: ArrayLike) -> Array:
    """Convert windows to an array (k, 2), and check that each starts before its end."""
    w = np.asarray(windows, dtype=np.float64)
    if w.size == 0:
        return np.empty((0, 2))
    if w.ndim != 2 or w.shape[1] != 2 or not np.all(w[:, 0] <= w[:, 1]):
        raise InputError(
            f"outage windows of shape {w.shape} need shape (k, 2), each a start and a later end in s"
        )
    return w
