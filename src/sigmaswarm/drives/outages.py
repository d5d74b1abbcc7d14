"""Artificial GPS outages: time windows in which fixes are hidden from a filter.

An array of windows has the shape (k, 2): start and end, s.
"""

import numpy as np
from numpy.typing import ArrayLike

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Mask
from sigmaswarm.errors import InputError

SECONDS_PER_OUTAGE = 15.0  # s of driving per window in `random_windows`


def hidden_fixes(time: ArrayLike, windows: ArrayLike) -> Mask:
    """Mark the fixes in the outage windows, including both ends. ``time`` (n,) and ``windows`` (k, 2) are in s.

    The drift is measured at the end of an outage, so there must be no fix at this time.
    """
    t = np.asarray(time, dtype=np.float64)
    starts, ends = np.sort(np.reshape(windows, (-1, 2)), axis=0).T
    # True if more windows have begun than ended. A comparison of each fix with each window could need a gigabyte.
    return np.searchsorted(starts, t, side="right") > np.searchsorted(ends, t, side="left")


def random_windows(
    start: float,
    end: float,
    rng: np.random.Generator,
    *,
    length: float | tuple[float, float],
    first_after: float,
    apart: float = 5.0,
    count: int | None = None,
) -> Array:
    """Draw outages (k, 2) between two times (s), uniformly among all placements with the required distances.

    ``length`` (s) is fixed or a range. The first outage begins at least ``first_after`` s after ``start``, and outages
    are at least ``apart`` s apart. ``count`` is the number of outages, by default one per 15 s but at least one. If the
    time is too short, fewer are returned.
    """
    shortest, longest = length if isinstance(length, tuple) else (length, length)
    if not (0 < shortest <= longest and first_after >= 0 and apart >= 0):
        raise InputError(
            f"outages with length = {length} s, first_after = {first_after:g} s, apart = {apart:g} s can't be drawn; "
            "use a positive length, or two lengths in ascending order, and first_after and apart of 0 or more"
        )
    available = end - start - first_after
    wanted = max(round(available / SECONDS_PER_OUTAGE), 1) if count is None else count
    lengths = rng.uniform(shortest, longest, max(wanted, 0))
    # ends of the windows, s after the earliest start of the first window, if the windows are as close as allowed
    ends = np.cumsum(lengths) + apart * np.arange(len(lengths))
    fitting = int(np.count_nonzero(ends <= available))
    ends, lengths = ends[:fitting], lengths[:fitting]
    # The remaining time is divided by sorted uniform numbers, so that every division is equally likely.
    slack = np.sort(rng.uniform(0.0, available - ends[-1], fitting)) if fitting else ends
    ends = np.minimum(start + first_after + slack + ends, end)
    return np.stack([ends - lengths, ends], axis=1)


def balanced_windows(start: float, end: float, rng: np.random.Generator) -> Array:
    """Draw outages (k, 2) of 3 to 5 s between two times (s), one in each interval of about 12 s.

    Each outage begins at least 5 s after ``start`` and after the end of the previous outage.
    """
    apart = 5.0
    # one slot for each window; the remaining time extends all slots
    count = int((end - start) / 12.0) or int(end - start >= apart + 5.0)
    slot = (end - start) / max(count, 1)
    lengths = rng.uniform(3.0, 5.0, count)
    starts = start + slot * np.arange(count) + apart + rng.uniform(0.0, 1.0, count) * (slot - apart - lengths)
    return np.stack([starts, starts + lengths], axis=1)


def snap_ends(windows: ArrayLike, imu_time: ArrayLike, *, apart: float = 5.0) -> Array:
    """Shift windows (k, 2), sorted by time, so that each ends exactly at an IMU sample. Times are in s.

    An end moves to the first sample at or after it, or to a later sample if the window would otherwise begin less than
    ``apart`` s after the previous window. The length does not change. An end after the last sample moves back to this
    sample; a window that is then too close to the previous window is left out.
    """
    samples = np.asarray(imu_time, dtype=np.float64)
    snapped: list[list[float]] = []
    free = -np.inf  # s, earliest start of the next window
    for start, end in np.asarray(windows, dtype=np.float64).tolist():
        length = end - start
        i = min(int(np.searchsorted(samples, max(end, free + length))), len(samples) - 1)
        if samples[i] < free + length:
            continue
        snapped.append([samples[i] - length, samples[i]])
        free = samples[i] + apart
    return np.reshape(snapped, (-1, 2))
