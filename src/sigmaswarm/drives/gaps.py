"""Find gaps in the IMU data and in the truth.

A gap in the IMU data is an interval that is long compared with the preceding intervals. Only these intervals are used,
since a live filter does not know later ones.
"""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.tables import Mask, Truth

MANY = 5.0  # a gap is longer than this number of usual intervals
SHORTEST = 0.05  # s; a gap is also longer than this time
OVER = 32.0  # approximate number of averaged intervals
# usual intervals; a longer interval counts in the average as this number, so gaps hardly change the usual interval
MOST = 3.0


def gaps_before(time: Array) -> Array:
    """Return the length of the gap that ends at each sample of ``time`` (n,), s; 0 without a gap."""
    gaps = np.zeros(len(time))
    _find_gaps(np.ascontiguousarray(time, dtype=np.float64), gaps)
    return gaps


@cached
def _find_gaps(time: Array, gaps: Array) -> None:
    usual = 0.0
    for k in range(1, len(time)):
        interval = time[k] - time[k - 1]
        gaps[k] = gap_of(interval, usual)
        usual = usual_after(interval, usual)


@cached
def gap_of(interval: float, usual: float) -> float:
    """Return an interval (s) if it is a gap relative to the usual interval (s; 0 if unknown), otherwise 0."""
    return interval if usual > 0.0 and interval > max(MANY * usual, SHORTEST) else 0.0


@cached
def usual_after(interval: float, usual: float) -> float:
    """Update the usual interval (s), an exponentially weighted mean, with the next interval, s."""
    return usual + (min(interval, MOST * usual) - usual) / OVER if usual > 0.0 else interval


def is_known(truth: Truth, time: Array) -> Mask:
    """Mark the times (n,), s, between the start and the end of the truth that are not in a gap of the truth.

    Truth without standard deviations is used across gaps.
    """
    inside = (time >= truth.time[0]) & (time <= truth.time[-1])
    if truth.std_x is None or len(truth) < 2:
        return inside
    later = np.clip(np.searchsorted(truth.time, time, side="left"), 1, len(truth) - 1)
    return inside & (~_truth_gaps(truth)[later - 1] | (truth.time[later] == time) | (truth.time[0] == time))


def share_known(truth: Truth | None, start: float, end: float) -> float:
    """Return the fraction of the time from ``start`` to ``end`` (s) that the truth covers, without its gaps."""
    if truth is None or len(truth) < 2 or end <= start:
        return 0.0
    edges = np.clip(truth.time, start, end)
    return float(np.sum(np.diff(edges)[~_truth_gaps(truth)]) / (end - start))


def _truth_gaps(truth: Truth) -> Mask:
    """Mark intervals between rows of the truth, shape (m - 1,), that are much longer than the median."""
    intervals = np.diff(truth.time)
    return intervals > max(MANY * float(np.median(intervals)), SHORTEST)
