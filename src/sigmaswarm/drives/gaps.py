"""Gaps in the IMU: intervals of which no sample tells what the car did.

An interval is a gap beside the ones before it, so that a live filter on an IMU of any rate finds the same gaps as one
over a whole drive.
"""

import numpy as np

from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Array

MANY = 5.0
"""A gap is longer than so many usual intervals,"""
SHORTEST = 0.05
"""s, and longer than this: in less no car does much."""
OVER = 32.0
"""Intervals, about, over which the usual one is a mean."""
MOST = 3.0
"""An interval counts at most so many times the usual one in that mean, so that a gap does not become usual."""


def gaps_before(time: Array) -> Array:
    """How long the gap is that ends at each sample, shape (n,) s; 0 where none does. ``time``: (n,) s."""
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
    """The interval (s) if it is a gap beside the usual one (s; 0: not known yet), else 0."""
    return interval if usual > 0.0 and interval > max(MANY * usual, SHORTEST) else 0.0


@cached
def usual_after(interval: float, usual: float) -> float:
    """The usual interval, s, after another one: a mean that forgets."""
    return usual + (min(interval, MOST * usual) - usual) / OVER if usual > 0.0 else interval
