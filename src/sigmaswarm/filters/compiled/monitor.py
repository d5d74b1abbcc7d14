"""Inputs of a live filter's divergence monitor: the last usable fix, and an approximate heading.

The samples of the last seconds are in a ring buffer: time, ax, ay, gz and the other axes.
"""

import math

from numba import njit

from sigmaswarm.drives.alignment import ALIGNMENT_FIXES, MAX_DURATION, MIN_CHORD, MIN_DURATION
from sigmaswarm.drives.stale_fixes import STALE
from sigmaswarm.filters.compiled.lanes import OPTIONS

CHECK_INTERVAL = 1.0  # s, length of a time slot; a filter is checked at most once per slot
LATEST_CHECK = 0.25  # s, longest time from a fix to its check; for late fixes, the largest delay is added
MONITOR_SPAN = MAX_DURATION + 1.0  # s, span of the samples and fixes that are stored for the monitor

_T, _X, _Y, _KIND = 0, 1, 2, 10  # columns of fixes, as in `live`, which imports this module

_plain = njit(**OPTIONS)


@_plain
def last_fix(fixes, end, until, after):
    """Return the row of the last usable fix in (after, until], among the rows before ``end``; -1 without such a fix."""
    for f in range(end - 1, -1, -1):
        if fixes[f, _T] <= after:
            break
        if fixes[f, _T] <= until and _counts(fixes, f):
            return f
    return -1


@_plain
def _counts(fixes, f):
    return fixes[f, _KIND] < STALE and math.isfinite(fixes[f, _X]) and math.isfinite(fixes[f, _Y])


@_plain
def rough_heading(samples, newest, n, fixes, end, gyro_bias):
    """Return the heading at the last sample (rad): `Alignments.course`, propagated by the gyro. NaN if it is unknown.

    ``newest`` is the row of the last of the ``n`` samples in the ring buffer, ``end`` the number of fixes.
    ``gyro_bias`` is in rad/s.
    """
    now = samples[newest, 0]
    last = last_fix(fixes, end, now, -math.inf)
    if last < 0 or n < 2:
        return math.nan
    oldest = max(fixes[last, _T] - MAX_DURATION, samples[(newest + 1 - n) % len(samples), 0])
    first, count, f = last, 0, last
    while f >= 0 and fixes[f, _T] >= oldest:
        if _counts(fixes, f):
            first = f
            count += 1
        f -= 1
    east, north = fixes[last, _X] - fixes[first, _X], fixes[last, _Y] - fixes[first, _Y]
    span = fixes[last, _T] - fixes[first, _T]
    if span < MIN_DURATION or count < ALIGNMENT_FIXES or not math.hypot(east, north) >= MIN_CHORD:
        return math.nan
    begin, steps = newest, 0
    while steps < n - 1 and samples[begin, 0] > fixes[first, _T]:
        begin = begin - 1 if begin > 0 else len(samples) - 1
        steps += 1
    east_way, north_way, turned = _way(samples, begin, steps, fixes[first, _T], fixes[last, _T], gyro_bias)
    return math.atan2(north, east) - math.atan2(north_way, east_way) + turned


@_plain
def _way(samples, k, steps, since, until, gyro_bias):
    """Return a displacement between two times (m east, m north), and the turn from the first to the last sample (rad).

    The displacement assumes a speed of 1 m/s and an initial heading of 0. Row ``k`` is the last sample at or before
    ``since``; ``steps`` samples follow.
    """
    before, east, north, turned, cos, sin = samples[k, 0], 0.0, 0.0, 0.0, 1.0, 0.0
    for _ in range(steps):
        k = k + 1 if k + 1 < len(samples) else 0
        t, gz = samples[k, 0], samples[k, 3] - gyro_bias
        if not math.isfinite(gz + samples[k, 1] + samples[k, 2]):
            continue
        turned += gz * (t - before)
        new_cos, new_sin = math.cos(turned), math.sin(turned)
        inside = min(t, until) - max(before, since)
        if inside > 0.0:
            east += 0.5 * (cos + new_cos) * inside
            north += 0.5 * (sin + new_sin) * inside
        before, cos, sin = t, new_cos, new_sin
    return east, north, turned
