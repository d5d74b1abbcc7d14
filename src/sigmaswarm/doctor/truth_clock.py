"""Find the delay of the truth's clock relative to that of the fixes, by their velocities."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from sigmaswarm.arrays import Array

Positions = NDArray[np.complexfloating]
STEP, FINE_STEP = 0.5, 0.01  # s, steps of the tried delays, and of those near the best delay
# Time over which a velocity is computed: in s, and in usual intervals between positions; the larger value applies
BASE, BASE_INTERVALS = 2.0, 2.0
# Longest interval between positions within this time: in s, and in usual intervals; the larger value applies
MAX_GAP, GAP_INTERVALS = 3.0, 1.5
MAX_SPEED = 150.0  # m/s, largest velocity that is compared
MIN_TIME = 20.0  # s, shortest time with both velocities
MIN_OVERLAP = 0.65  # smallest fraction of the shorter of the two tracks with both velocities
MIN_SPEED = 1.0  # m/s, lowest RMS speed
MIN_DELAY = 2.5  # s, smallest delay of a wrong clock; larger than the delay of a receiver
MAX_DIFFERENCE = 0.1  # largest relative difference of the velocities at the best delay: see `truth_delay`
# smallest ratio of the difference at other delays, and without a delay, to the difference at the best delay
MIN_RATIO = 3.0
PEAK_WIDTH = 10.0  # s; delays closer to the best delay do not count as other delays


def truth_delay(time: Array, fixes: Positions, truth_time: Array, truth: Positions) -> float | None:
    """Find the delay of the truth's clock, s, from the truth (m,) and the fixes (n,), east + i north, m.

    Return None if no delay makes the velocities agree, or if several delays do. The relative difference of the
    velocities v and w at a delay is the sum of |v - w|^2 divided by the sum of |v|^2 + |w|^2, over the times at which
    both are known.
    """
    if min(len(time), len(truth_time)) < 3:
        return None
    usual = max(float(np.median(np.diff(t))) for t in (time, truth_time))
    (begin, v, known), (start, w, seen) = (
        _velocities(*track, usual) for track in ((time, fixes), (truth_time, truth))
    )
    if not known.any() or not seen.any():
        return None
    count = correlate(seen, known, method="fft")
    power = correlate(seen, np.abs(v) ** 2, method="fft") + correlate(np.abs(w) ** 2, known, method="fft")
    enough = count >= max(MIN_TIME / STEP, MIN_OVERLAP * min(known.sum(), seen.sum()))
    valid = enough & (power > 2 * MIN_SPEED**2 * count)
    products = correlate(w, v, method="fft").real
    apart = np.where(valid, 1 - 2 * products / np.where(valid, power, 1.0), np.inf)
    delays = (np.arange(len(apart)) - (len(v) - 1)) * STEP + start - begin
    best, none = int(np.argmin(apart)), int(np.argmin(np.abs(delays)))
    least = MIN_RATIO * max(float(apart[best]), 1e-6)
    others = apart[np.abs(delays - delays[best]) > PEAK_WIDTH]
    wrong = abs(delays[best]) >= MIN_DELAY
    without = np.inf
    if wrong and abs(delays[none]) < STEP:
        # The difference without a delay over the same fixes: a delay may only exclude a part with bad fixes.
        i = np.arange(len(v))
        at, there = i + none - (len(v) - 1), i + best - (len(v) - 1)
        both = (known > 0) & _inside(there, seen) & _inside(at, seen)
        one, other = v[both], w[at[both]]
        size = float(np.sum(np.abs(one) ** 2 + np.abs(other) ** 2))
        same = float(np.sum(np.abs(one - other) ** 2)) / max(size, 1e-12)
        without = min(float(apart[none]), same)
    if apart[best] >= MAX_DIFFERENCE or min(without, others.min(initial=np.inf)) <= least:
        return None
    near = delays[best] + np.arange(-STEP, STEP + FINE_STEP / 2, FINE_STEP)
    inside = (time + near[0] >= truth_time[0]) & (time + near[-1] <= truth_time[-1])

    def distance(delay: float) -> float:
        apart = fixes[inside] - _at(time[inside] + delay, truth_time, truth)
        return float(np.mean(np.abs(apart - np.mean(apart)) ** 2))

    return round(float(min(near, key=distance)), 2)


def _inside(index: NDArray[np.intp], known: Array) -> NDArray[np.bool_]:
    """Return True where an index is inside an array and its element is not 0."""
    inside = (index >= 0) & (index < len(known))
    return inside & (known[index.clip(0, len(known) - 1)] > 0)


def _velocities(time: Array, position: Positions, usual: float) -> tuple[float, Positions, Array]:
    """Return the first time, velocities (k,), m/s, at steps of `STEP` s, and 1 where the velocity is known, else 0.

    ``usual``: the longer of the usual intervals of fixes and truth, s.
    """
    base = max(BASE, BASE_INTERVALS * usual)
    grid = np.arange(np.ceil(time[0] / STEP), np.floor(time[-1] / STEP) + 1) * STEP
    first, last = (np.asarray(grid + side * base / 2, np.float64) for side in (-1, 1))
    velocity = (_at(last, time, position) - _at(first, time, position)) / base
    # A velocity is unknown in intervals without positions.
    long = np.append(0, np.cumsum(np.diff(time) > max(MAX_GAP, GAP_INTERVALS * usual)))
    i, j = np.searchsorted(time, first), np.searchsorted(time, last, side="right") - 1
    inside = (first >= time[0]) & (last <= time[-1]) & (np.abs(velocity) < MAX_SPEED)
    known = inside & (long[np.clip(j + 1, 0, len(long) - 1)] == long[np.clip(i - 1, 0, len(long) - 1)])
    return float(grid[0]) if len(grid) else 0.0, velocity * known, known.astype(np.float64)


def _at(time: Array, known: Array, position: Positions) -> Positions:
    return np.interp(time, known, position.real) + 1j * np.interp(time, known, position.imag)
