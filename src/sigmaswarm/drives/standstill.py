"""Standstills of the car, told from the IMU's calm and from fixes that stay where they are; causally.

A smooth road at constant speed is as calm as a standstill, so the fixes must agree; a car that departs is slow for the
fixes at first, so the IMU must agree. A gentle departure is calm, too, but it tilts and accelerates: so the
acceleration must stay what it was when the stop began. The same functions serve a whole drive and a live filter.

Samples are kept as blocks of 50 ms, each with its number, means and squares: what a sample costs does not depend on the
IMU's rate, nor does the memory. The last second is the block of the latest sample, as far as it has got, and the 20
before it; the last quarter is that block and the 5 before. Blocks are put together by the formulas of Chan, Golub and
LeVeque (Updating formulae and a pairwise algorithm for computing sample variances, 1979), which lose no digits; what is
whole is put together anew whenever a block ends, so that no rounding adds up.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.frozen import FROZEN_MOVING

BLOCK = 0.05
"""s of samples that are put together."""
SECOND = 20
"""Whole blocks that must be calm, with the one that grows."""
MOST_OF_IT = 16
"""The oldest of them must be so many blocks back, or less than a second is known."""
QUARTER = 5
"""Whole blocks, with the one that grows, in which a departure shows."""
CALM = 2.5
"""A second is calm if it is at most that many times as restless as the car is when it is calm."""
SETTLES = 0.5
"""s in which the notion of calm follows a calmer second."""
RISES = 0.1
"""per s: how fast it rises while the car is about calm, so that one lucky second does not set it for good."""
DEPARTS = 0.12
"""m/s2: an acceleration, forward or left, that is so far from what it was in the stop is a departure's."""
FOLLOWS = 1.0
"""s in which the stop's acceleration follows what is measured, while no departure shows: sensors warm up."""
FORGETS = 3.0
"""s after the last moment of calm and of fixes that stay: what comes then is another stop."""
FIX_WINDOW = 3.0
"""s of fixes that must stay where they are."""
FILLED = 1.5
"""Mean intervals of fixes by which the first of them may come after the window's beginning."""
FIX_SPEED = 0.8
"""m/s: the speed that the fixes may show while the car stands."""
TURNING = math.radians(1.5)
"""rad/s: a car that stands does not turn; a gyro's bias stays below this."""

# A detector's memory, shape (N_MEMORY, 8). Rows: blocks, by number; all whole blocks of the second; of the quarter; how
# restless the car is in calm, and the last sample's time; means of ax, ay over the second, then over the quarter.
WHOLE, PART, FLOOR, MEANS = range(SECOND + 1, SECOND + 5)
N_MEMORY = SECOND + 5
# Columns of a block: its number, how many samples, means of ax, ay, gz, sums of squares about the means.
NUMBER, COUNT, MEAN, SQUARES = 0, 1, 2, 5
# What is remembered of a stop, shape (N_STOP,): the last moment of calm and of fixes that stay, and ax, ay in it.
LAST, STOP_X, STOP_Y = range(3)
N_STOP = 3

PIECE = 100_000
"""Samples that are put side by side at once: all of a long drive's would be held twice."""


def standing(drive: Drive, kinds: Array) -> NDArray[np.bool_]:
    """Standstill at each IMU sample, shape (n,); from that sample and earlier data only.

    ``kinds`` says what each fix is: see `frozen`.
    """
    imu, gps = drive.imu, drive.gps
    stands = np.zeros(len(imu.time), dtype=np.bool_)
    fixes = np.column_stack([gps.time, gps.x, gps.y])
    memory, stop = new_memory(), new_stop()
    for first in range(0, len(stands), PIECE):
        part = slice(first, first + PIECE)
        samples = np.column_stack([imu.time[part], imu.ax[part], imu.ay[part], imu.gz[part]])
        _find_standstills(samples, fixes, kinds, memory, stop, stands[part])
    return stands


def new_memory() -> Array:
    """A detector that has seen nothing."""
    memory = np.zeros((N_MEMORY, 8))
    memory[: SECOND + 1, NUMBER] = -np.inf
    memory[FLOOR] = np.inf  # calm is still unknown
    memory[FLOOR, 3] = -np.inf
    return memory


def new_stop() -> Array:
    """No stop was seen yet."""
    return np.array([-np.inf, 0.0, 0.0])


@cached
def _find_standstills(
    samples: Array, fixes: Array, kinds: Array, memory: Array, stop: Array, stands: NDArray[np.bool_]
) -> None:
    first, end = 0, 0
    for k in range(len(samples)):
        t = samples[k, 0]
        while end < len(fixes) and fixes[end, 0] <= t:
            end += 1
        while first < end and fixes[first, 0] < t - FIX_WINDOW:
            first += 1
        calm = is_calm(memory, t, samples[k, 1], samples[k, 2], samples[k, 3])
        if calm and fixes_stand(fixes[first:end], kinds[first:end], t):
            stands[k] = is_as_it_was(stop, t, memory[MEANS])


@cached
def is_calm(memory: Array, t: float, ax: float, ay: float, gz: float) -> bool:
    """Take a sample, and tell whether the last second is calm."""
    number = np.floor(t / BLOCK)
    if not abs(number) < 1e15:  # no time of any clock
        return False
    row = int(number - (SECOND + 1) * np.floor(number / (SECOND + 1)))
    if memory[row, NUMBER] != number:
        memory[row] = 0.0
        memory[row, NUMBER] = number
        _put_together(memory, row)
    _count(memory[row], ax, ay, gz)
    dt, memory[FLOOR, 3] = min(t - memory[FLOOR, 3], 1.0), t
    before, now, part, floor, means = memory[WHOLE], memory[row], memory[PART], memory[FLOOR], memory[MEANS]
    n = before[COUNT] + now[COUNT]
    if n < 5 or before[NUMBER] > number - MOST_OF_IT:
        return False
    calm = abs(gz) < TURNING
    for c in range(3):
        away = now[MEAN + c] - before[MEAN + c]
        share = now[COUNT] / n
        squares = before[SQUARES + c] + now[SQUARES + c] + away * away * before[COUNT] * share
        restless = math.sqrt(squares / n)
        if not floor[c] < math.inf:
            floor[c] = restless
        elif restless < floor[c]:
            floor[c] += (restless - floor[c]) * min(1.0, dt / SETTLES)
        elif restless < 3.0 * floor[c]:
            floor[c] *= 1.0 + RISES * dt
        calm = calm and restless <= CALM * max(floor[c], 1e-6)
        if c < 2:
            means[c] = before[MEAN + c] + away * share
            quarter = now[COUNT] / (part[COUNT] + now[COUNT])
            means[2 + c] = part[MEAN + c] + (now[MEAN + c] - part[MEAN + c]) * quarter
    return calm


@cached
def _count(block: Array, ax: float, ay: float, gz: float) -> None:
    """Take a sample into a block."""
    block[COUNT] += 1.0
    for c, value in enumerate((ax, ay, gz)):
        away = value - block[MEAN + c]
        block[MEAN + c] += away / block[COUNT]
        block[SQUARES + c] += away * (value - block[MEAN + c])


@cached
def _put_together(memory: Array, row: int) -> None:
    """All whole blocks before the one that begins in a row, the oldest first: those of the second, of the quarter."""
    number = memory[row, NUMBER]
    memory[WHOLE], memory[PART] = 0.0, 0.0
    memory[WHOLE, NUMBER] = np.inf
    for k in range(1, SECOND + 1):
        block = memory[(row + k) % (SECOND + 1)]
        if block[NUMBER] >= number - SECOND:
            if memory[WHOLE, COUNT] == 0.0:
                memory[WHOLE, NUMBER] = block[NUMBER]
            _add(memory[WHOLE], block)
            if block[NUMBER] >= number - QUARTER:
                _add(memory[PART], block)


@cached
def _add(total: Array, block: Array) -> None:
    n = total[COUNT] + block[COUNT]
    share = block[COUNT] / n
    for c in range(3):
        away = block[MEAN + c] - total[MEAN + c]
        total[MEAN + c] += away * share
        total[SQUARES + c] += block[SQUARES + c] + away * away * total[COUNT] * share
    total[COUNT] = n


@cached
def is_as_it_was(stop: Array, t: float, means: Array) -> bool:
    """At a moment of calm and of fixes that stay: whether the acceleration is what it was when the stop began.

    ``stop`` is what is remembered of it, changed; ``means`` (4,) are those of ax, ay over the last second, then over
    the last quarter, m/s2.
    """
    since, stop[LAST] = t - stop[LAST], t
    if not since <= FORGETS:
        stop[STOP_X], stop[STOP_Y] = means[0], means[1]
    away_x, away_y = means[2] - stop[STOP_X], means[3] - stop[STOP_Y]
    stands = abs(away_x) <= DEPARTS and abs(away_y) <= DEPARTS
    if stands:
        share = min(1.0, since / FOLLOWS)
        stop[STOP_X] += share * away_x
        stop[STOP_Y] += share * away_y
    return stands


@cached
def fixes_stand(fixes: Array, kinds: Array, now: float) -> bool:
    """True if a straight line through the last seconds' fixes hardly moves; rows begin with t, x, y.

    None is after ``now``. ``kinds`` says what each is: see `frozen`. Repeats of a fix of a driving car show nothing.
    Behind an outage the window must fill up first: the slope of half of it is three times as noisy, and shows a car
    that departs, by an acceleration as steady as gravity, as standing.
    """
    n, first, last, mean = 0, now, now, 0.0
    for k in range(len(fixes)):
        if fixes[k, 0] >= now - FIX_WINDOW and kinds[k] != FROZEN_MOVING:
            first = fixes[k, 0] if n == 0 else first
            last = fixes[k, 0]
            n += 1
            mean += fixes[k, 0] - now
    if (
        n < 3
        or last - first < 0.5 * FIX_WINDOW
        or first - (now - FIX_WINDOW) > FILLED * (last - first) / (n - 1)
    ):
        return False
    mean = now + mean / n
    tt, tx, ty = 0.0, 0.0, 0.0
    for k in range(len(fixes)):
        if fixes[k, 0] >= now - FIX_WINDOW and kinds[k] != FROZEN_MOVING:
            t = fixes[k, 0] - mean
            tt += t * t
            tx += t * fixes[k, 1]
            ty += t * fixes[k, 2]
    return math.hypot(tx / tt, ty / tt) < FIX_SPEED
