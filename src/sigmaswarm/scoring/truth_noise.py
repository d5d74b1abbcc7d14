"""Truth with stated standard deviations: the weight of each moment, and the times at which truth is known."""

import math

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Truth
from sigmaswarm.drives.gaps import MANY, SHORTEST

POSITION_FLOOR = 0.3
"""m per axis: the accuracy of the best filters of cheap receivers, beyond which better truth gets no more weight.

Without this limit only stretches under open sky would have weight, where a reference is best and every filter good.
"""
HEADING_FLOOR = math.radians(0.3)
"""rad, likewise."""


def weights_at(truth: Truth, time: Array) -> Array | None:
    """Weights of squared position errors at times, s: floor^2 / (sigma^2 + floor^2); None: 1.

    sigma^2 is the mean of both axes' variances, from linearly interpolated deviations.
    """
    if truth.std_x is None or truth.std_y is None:
        return None
    std_x, std_y = np.interp(time, truth.time, truth.std_x), np.interp(time, truth.time, truth.std_y)
    return POSITION_FLOOR**2 / ((std_x**2 + std_y**2) / 2 + POSITION_FLOOR**2)


def heading_weights(truth: Truth) -> Array | None:
    """Weights of the squared heading errors, (m,); None where truth states no deviation of the heading."""
    return None if truth.std_theta is None else HEADING_FLOOR**2 / (truth.std_theta**2 + HEADING_FLOOR**2)


def root_mean(squares: Array, weights: Array | None = None) -> float:
    """Weighted RMS of squared errors (m,); NaN where there are none."""
    if not squares.size:
        return float("nan")
    return float(np.sqrt(np.mean(squares) if weights is None else np.average(squares, weights=weights)))


def is_known(truth: Truth, time: Array) -> NDArray[np.bool_]:
    """Times (n,), s, at which truth is known, (n,): those outside of its gaps.

    Truth without deviations is known from its first row to its last one.
    """
    inside = (time >= truth.time[0]) & (time <= truth.time[-1])
    if truth.std_x is None or len(truth) < 2:
        return inside
    later = np.clip(np.searchsorted(truth.time, time, side="left"), 1, len(truth) - 1)
    return inside & (~_gaps(truth)[later - 1] | (truth.time[later] == time) | (truth.time[0] == time))


def share_known(truth: Truth | None, start: float, end: float) -> float:
    """Share of the time from ``start`` to ``end``, s, in which truth has rows, without gaps."""
    if truth is None or len(truth) < 2 or end <= start:
        return 0.0
    edges = np.clip(truth.time, start, end)
    return float(np.sum(np.diff(edges)[~_gaps(truth)]) / (end - start))


def _gaps(truth: Truth) -> NDArray[np.bool_]:
    """Intervals between rows, (m - 1,), that are gaps, as gaps in the IMU: much longer than usual."""
    intervals = np.diff(truth.time)
    return intervals > max(MANY * float(np.median(intervals)), SHORTEST)
