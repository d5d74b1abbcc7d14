"""Causal detection of standstills from a calm IMU and constant fixes.

A smooth road at constant speed is as calm as a standstill, so the fixes must agree. Fixes see a departure late, so the
IMU must agree. A gentle departure is calm, too, but changes the acceleration, which must therefore stay as it was when
the stop began. The same functions serve a drive and a live filter.

Samples are summed in blocks of 50 ms (count, means, squares), so cost and memory do not depend on the IMU's rate. The
last second is the current, incomplete block and the 20 before it, the last quarter that block and the 5 before. Blocks
are merged by the formulas of Chan, Golub and LeVeque (Updating formulae and a pairwise algorithm for computing sample
variances, 1979). Complete blocks are merged again whenever a block ends, so that rounding does not accumulate.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.frozen import FROZEN_MOVING

BLOCK = 0.05
"""s: length of a block."""
SECOND = 20
"""Complete blocks that must be calm, next to the current one."""
MOST_OF_IT = 16
"""Blocks since the oldest of them, at least, for a full second."""
QUARTER = 5
"""Complete blocks, next to the current one, that show a departure."""
CALM = 2.5
"""Largest ratio of the deviations of a calm second to the usual ones of calm."""
SETTLES = 0.5
"""s: time constant with which the level of calm falls."""
RISES = 0.1
"""per s: rate at which it rises while the car is nearly calm, so that no single second fixes it."""
DEPARTS = 0.12
"""m/s2: change of the acceleration, forward or left, that shows a departure."""
FOLLOWS = 1.0
"""s: time constant with which the stop's acceleration follows the sensors, which warm up."""
FORGETS = 3.0
"""s after the last moment of calm and constant fixes, after which another stop begins."""
FIX_WINDOW = 3.0
"""s of fixes that must be constant."""
FILLED = 1.5
"""Mean intervals of fixes between the start of the window and the first fix, at most."""
FIX_SPEED = 0.8
"""m/s: highest speed of the fixes at standstill."""
TURNING = math.radians(1.5)
"""rad/s: a car that stands does not turn; a gyro's bias stays below this."""

# A detector's memory, shape (N_MEMORY, 8). Rows: blocks, by number; all whole blocks of the second; of the quarter; how
# restless the car is in calm, and the last sample's time; means of ax, ay over the second, then over the quarter.
WHOLE, PART, FLOOR, MEANS = range(SECOND + 1, SECOND + 5)
N_MEMORY = SECOND + 5
# Columns of a block: its number, how many samples, means of ax, ay, gz, sums of squares about the means.
NUMBER, COUNT, MEAN, SQUARES = 0, 1, 2, 5
# Memory of a stop, shape (N_STOP,): the last moment of calm and constant fixes, and ax, ay at it.
LAST, STOP_X, STOP_Y = range(3)
N_STOP = 3

PIECE = 100_000
"""Samples per copy, to limit the memory."""


def standing(drive: Drive, kinds: Array) -> NDArray[np.bool_]:
    """Standstill at each IMU sample, shape (n,); from that sample and earlier data only.

    ``kinds``: of the fixes, see `frozen`.
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
    """Add a sample; return True if the last second is calm."""
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

    None is after ``now``. ``kinds`` has the kind of each: see `frozen`. Repeats of a fix of a driving car show nothing.
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
