"""Truth that states its own deviation: what each moment of it counts, and where it is known at all."""

import math

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Truth
from sigmaswarm.drives.gaps import MANY, SHORTEST

POSITION_FLOOR = 0.3
"""m per axis: what the best filters of cheap receivers reach, so that truth which is better tells no more of them.

Without it what counts would be the open sky alone, where a reference is best and every filter good.
"""
HEADING_FLOOR = math.radians(0.3)
"""rad, likewise."""


def position_counts(truth: Truth) -> Array | None:
    """What the squared position error of each moment counts, (m,): floor^2 / (sigma^2 + floor^2); None: 1.

    sigma^2 is the mean of both axes' variances.
    """
    if truth.std_x is None or truth.std_y is None:
        return None
    return POSITION_FLOOR**2 / ((truth.std_x**2 + truth.std_y**2) / 2 + POSITION_FLOOR**2)


def heading_counts(truth: Truth) -> Array | None:
    """The same of the heading; None where truth states no deviation of it."""
    return None if truth.std_theta is None else HEADING_FLOOR**2 / (truth.std_theta**2 + HEADING_FLOOR**2)


def counts_at(truth: Truth, time: Array) -> Array | None:
    """What a position error between the moments counts, of the deviations linearly interpolated; None: 1."""
    if truth.std_x is None or truth.std_y is None:
        return None
    std_x, std_y = np.interp(time, truth.time, truth.std_x), np.interp(time, truth.time, truth.std_y)
    return POSITION_FLOOR**2 / ((std_x**2 + std_y**2) / 2 + POSITION_FLOOR**2)


def root_mean(squares: Array, counts: Array | None = None) -> float:
    """The RMS of squared errors (m,), each counted as told; NaN where there are none."""
    if not squares.size:
        return float("nan")
    return float(np.sqrt(np.mean(squares) if counts is None else np.average(squares, weights=counts)))


def is_known(truth: Truth, time: Array) -> NDArray[np.bool_]:
    """Where truth tells something, (n,) of times (n,) s: not in its gaps.

    A truth that states no deviation is taken to be known from its first row to its last one.
    """
    inside = (time >= truth.time[0]) & (time <= truth.time[-1])
    if truth.std_x is None or len(truth) < 2:
        return inside
    later = np.clip(np.searchsorted(truth.time, time, side="left"), 1, len(truth) - 1)
    return inside & (~_gaps(truth)[later - 1] | (truth.time[later] == time) | (truth.time[0] == time))


def share_known(truth: Truth | None, start: float, end: float) -> float:
    """Share of the time from ``start`` to ``end``, s, in which truth has rows, gaps aside."""
    if truth is None or len(truth) < 2 or end <= start:
        return 0.0
    edges = np.clip(truth.time, start, end)
    return float(np.sum(np.diff(edges)[~_gaps(truth)]) / (end - start))


def _gaps(truth: Truth) -> NDArray[np.bool_]:
    """Which intervals between rows, (m - 1,), are gaps: as gaps in the IMU, beside the usual interval."""
    intervals = np.diff(truth.time)
    return intervals > max(MANY * float(np.median(intervals)), SHORTEST)
