"""Detect standstills from past samples: the IMU is calm and the fixes are constant.

At constant speed on a smooth road, the IMU is as calm as at a standstill, so the fixes must also be constant. Fixes
show a departure late, so the IMU must also be calm. During a gentle departure, the IMU is calm but the acceleration
changes, so the acceleration must agree with that at the beginning of the stop.

Samples are summed in blocks of 50 ms (count, means, squares), so cost and memory do not depend on the IMU's rate. The
last second consists of the current block and the 20 before it; the last quarter of a second consists of the current
block and the 5 before it. Blocks are merged as in Chan, Golub and LeVeque (Updating formulae and a pairwise algorithm
for computing sample variances, 1979). Blocks are never subtracted, since rounding errors would accumulate. The last 20
complete blocks form two stacks. When a stack is full, each of its blocks is merged with all later blocks of the stack.
FRESH is the total of the stack that is being filled.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.stale_fixes import STALE_MOVING
from sigmaswarm.drives.tables import Imu

BLOCK = 0.05  # s, length of a block
SECOND = 20  # number of complete blocks in the second that must be calm
MOST_OF_IT = 16.0  # blocks; smallest age of the oldest block with which the last second counts as complete
QUARTER = 5  # number of complete blocks in the quarter of a second that shows a departure
CALM = 2.5  # largest ratio of the standard deviations in a calm second to the usual ones at rest
SETTLES = 0.5  # s, time constant with which the estimated noise at rest falls
RISES = 0.1
"""Relative growth of the estimated noise at rest while the IMU is nearly calm, 1/s.

Without this growth, the estimate would be the noise of the calmest second, which is too low.
"""
DEPARTS = 0.12  # m/s2, change of the forward or left acceleration of a departing car
FOLLOWS = 1.0  # s, time constant with which a stop's acceleration follows slow changes (sensor warms up)
FORGETS = 3.0  # s without a calm IMU and constant fixes after which a new stop begins
MAX_AT_REST = 1.0  # m/s2, largest acceleration at rest of a level IMU, on a slope of 10%
CONFIRMED = 1.0  # s, duration after which a stop with a larger acceleration counts
FIX_WINDOW = 3.0  # s, window in which the fixes must be constant
FILLED = 1.5  # mean fix intervals; longest time from the start of the window to the first fix
FIX_SPEED = 0.8  # m/s, largest speed of the line through constant fixes
CLOSE = 1e-5  # s; the line is fitted again this time before a fix leaves the window
TURNING = math.radians(1.5)  # rad/s, largest yaw rate at a standstill, due to the gyro's bias

# Rows of a detector's memory, shape (N_MEMORY, 8). The first rows are the two stacks; the older begins at row NEXT_ROW.
NOW = SECOND  # row: the current block
FRESH = SECOND + 1  # row: the newer stack, merged
WHOLE = SECOND + 2  # row: the complete blocks of the last second, merged
PART = SECOND + 3  # row: the complete blocks of the last quarter of a second, merged
LEVEL = SECOND + 4  # row: usual standard deviations at rest (negative: unknown), then NEXT_ROW to LAST
MEANS = SECOND + 5  # row: means of ax, ay over the last second, then over the last quarter of a second
N_MEMORY = SECOND + 6
COUNT = 0  # column of a block: number of samples
MEAN = 1  # first of three columns of a block: means of ax, ay, gz
SQUARES = 4  # first of three columns of a block: sums of squares about the means
FIRST = 7  # column of a block: row of the first of the blocks that were merged into it
NEXT_ROW = 3  # column of LEVEL: row of the stacks that is filled next
AGE = 4  # column of LEVEL: age of the oldest block of WHOLE, in blocks
NUMBER = 5  # column of LEVEL: number of the current block
LAST = 6  # column of LEVEL: time of the last sample

PIECE = 100_000  # samples per copy, to limit the memory


class CalmSamples(NamedTuple):
    """The IMU samples at which the IMU is calm: times (s), indices, and rows MEANS of the detector's memory, (c, 4)."""

    time: Array
    sample: NDArray[np.intp]
    means: Array


def find_calm(imu: Imu) -> CalmSamples:
    """Find the samples at which the IMU is calm; they do not depend on the fixes."""
    memory, found = new_memory(), list[CalmSamples]()
    for first in range(0, len(imu), PIECE):
        part = slice(first, first + PIECE)
        samples = np.column_stack([imu.time[part], imu.ax[part], imu.ay[part], imu.gz[part]])
        calm, means = np.zeros(len(samples), dtype=np.bool_), np.empty((len(samples), 4))
        _find_calm(samples, memory, calm, means)
        found.append(CalmSamples(samples[calm, 0], first + np.flatnonzero(calm), means[calm]))
    return CalmSamples(*map(np.concatenate, zip(*found, strict=True)))


def detect_standstills(drive: Drive, kinds: Array, calm: CalmSamples | None = None) -> NDArray[np.bool_]:
    """Detect standstill at each IMU sample, (n,), from earlier data. ``kinds`` of the fixes are as in `stale_fixes`.

    ``calm``: the result of `find_calm`, if it is known.
    """
    gps, calm = drive.gps, find_calm(drive.imu) if calm is None else calm
    stands = np.zeros(len(drive.imu), dtype=np.bool_)
    fixes = np.column_stack([gps.time, gps.x, gps.y])
    stands[calm.sample] = _find_standstills(calm.time, calm.means, fixes, kinds)
    return stands


def new_memory() -> Array:
    memory = np.zeros((N_MEMORY, 8))
    memory[LEVEL, :3] = -1.0
    memory[LEVEL, NUMBER] = memory[LEVEL, LAST] = -np.inf
    return memory


@cached
def _find_calm(samples: Array, memory: Array, calm: NDArray[np.bool_], means: Array) -> None:
    for k in range(len(samples)):
        calm[k] = is_calm(memory, samples[k, 0], samples[k, 1], samples[k, 2], samples[k, 3])
        if calm[k]:
            for c in range(4):
                means[k, c] = memory[MEANS, c]


@cached
def _find_standstills(time: Array, means: Array, fixes: Array, kinds: Array) -> NDArray[np.bool_]:
    stands, stop = np.zeros(len(time), dtype=np.bool_), np.array([-np.inf, 0.0, 0.0, 0.0])
    end, known, still, until = 0, -1, False, np.empty(1)
    for k in range(len(time)):
        t = time[k]
        while end < len(fixes) and fixes[end, 0] <= t:
            end += 1
        if end != known or t >= until[0]:
            known, still = end, fixes_are_still(fixes, kinds, end, t, until)
        if still:
            passed, stop[0] = t - stop[0], t
            stands[k] = matches_stop(stop[1:], passed, means[k])
    return stands


@cached
def is_calm(memory: Array, t: float, ax: float, ay: float, gz: float) -> bool:
    number, level = np.floor(t / BLOCK), memory[LEVEL]
    if not abs(number) < 1e15:  # an impossible time
        return False
    begun, level[NUMBER] = min(number - level[NUMBER], SECOND + 1.0), number
    dt, level[LAST] = min(t - level[LAST], 1.0), t
    return updated_calm(memory, int(begun), dt, ax, ay, gz)


@cached
def updated_calm(memory: Array, begun: int, dt: float, ax: float, ay: float, gz: float) -> bool:
    """Add a sample, and update the estimated noise at rest. Return True if the last second is calm.

    ``dt`` is the time since the previous sample, s. ``begun`` is the number of blocks that began since then.
    """
    if begun > 0:
        _begin_block(memory, begun)
    level, now, whole, part = memory[LEVEL], memory[NOW], memory[WHOLE], memory[PART]
    values = (ax, ay, gz)
    now[COUNT] += 1.0
    for c in range(3):
        away = values[c] - now[MEAN + c]
        now[MEAN + c] += away / now[COUNT]
        now[SQUARES + c] += away * (values[c] - now[MEAN + c])
    n = whole[COUNT] + now[COUNT]
    if n < 5.0 or level[AGE] < MOST_OF_IT:
        return False
    calm, share = abs(gz) < TURNING, now[COUNT] / n
    for c in range(3):
        away = now[MEAN + c] - whole[MEAN + c]
        squares = whole[SQUARES + c] + now[SQUARES + c] + away * away * whole[COUNT] * share
        restless = math.sqrt(squares / n)
        if level[c] < 0.0:
            level[c] = restless
        elif restless < level[c]:
            level[c] += (restless - level[c]) * min(1.0, dt / SETTLES)
        elif restless < 3.0 * level[c]:
            level[c] *= 1.0 + RISES * dt
        calm = calm and restless <= CALM * max(level[c], 1e-6)
    if calm:
        if part[COUNT] == 0.0:
            _merge_quarter(memory)
        quarter = now[COUNT] / (part[COUNT] + now[COUNT])
        for c in range(2):
            memory[MEANS, c] = whole[MEAN + c] + (now[MEAN + c] - whole[MEAN + c]) * share
            memory[MEANS, 2 + c] = part[MEAN + c] + (now[MEAN + c] - part[MEAN + c]) * quarter
    return calm


@cached
def _begin_block(memory: Array, begun: int) -> None:
    """Complete the current block and any blocks without samples, and merge the blocks of the last second."""
    level, now, fresh, whole = memory[LEVEL], memory[NOW], memory[FRESH], memory[WHOLE]
    row = int(level[NEXT_ROW])
    for _ in range(begun):
        now[FIRST] = float(row)
        _copy(now, memory[row])
        _merge(fresh, now)
        _clear(now)
        row += 1
        if row == SECOND:
            row = 0
            _clear(fresh)
            for i in range(2, SECOND + 1):
                _merge(memory[SECOND - i], memory[SECOND + 1 - i])
    _copy(memory[row], whole)
    _merge(whole, fresh)
    _clear(memory[PART])  # merged on use
    level[NEXT_ROW], level[AGE] = float(row), 0.0
    if whole[COUNT] > 0.0:
        level[AGE] = level[NEXT_ROW] - whole[FIRST]
        if level[AGE] <= 0.0:
            level[AGE] += float(SECOND)


@cached
def _merge_quarter(memory: Array) -> None:
    part, row = memory[PART], int(memory[LEVEL, NEXT_ROW])
    if row < QUARTER:
        _copy(memory[SECOND - QUARTER + row], part)
    for i in range(max(row - QUARTER, 0), row):
        _merge(part, memory[i])


@cached
def _merge(total: Array, block: Array) -> None:
    if total[COUNT] == 0.0:
        _copy(block, total)
    elif block[COUNT] > 0.0:
        n = total[COUNT] + block[COUNT]
        share = block[COUNT] / n
        for c in range(3):
            away = block[MEAN + c] - total[MEAN + c]
            total[MEAN + c] += away * share
            total[SQUARES + c] += block[SQUARES + c] + away * away * total[COUNT] * share
        total[COUNT] = n


@cached
def _copy(block: Array, to: Array) -> None:
    for c in range(8):
        to[c] = block[c]


@cached
def _clear(block: Array) -> None:
    for c in range(8):
        block[c] = 0.0


@cached
def matches_stop(stop: Array, passed: float, means: Array) -> bool:
    """Return True if the acceleration still agrees with that of the stop, within `DEPARTS`.

    At the beginning of a constant acceleration the fixes can still seem constant. Therefore, some stops count only
    after `CONFIRMED`: their acceleration differs from 0, and from the acceleration of the previous stop, by more than
    `MAX_AT_REST`.

    ``stop`` (3,) contains ax, ay of the stop, and the time (s) until it counts. This acceleration follows slow changes,
    and is replaced after `FORGETS`. ``passed`` (s) is the time since the last call. ``means`` (4,) are the means of ax,
    ay (m/s2) over the last second, then over the last quarter of a second.
    """
    if not passed <= FORGETS:
        level = abs(means[0]) <= MAX_AT_REST and abs(means[1]) <= MAX_AT_REST
        as_before = abs(means[0] - stop[0]) <= MAX_AT_REST and abs(means[1] - stop[1]) <= MAX_AT_REST
        known = level or (as_before and stop[2] <= 0.0)
        stop[0] = means[0]
        stop[1] = means[1]
        stop[2] = 0.0 if known else CONFIRMED
    else:
        stop[2] -= passed
    away_x, away_y = means[2] - stop[0], means[3] - stop[1]
    stands = abs(away_x) <= DEPARTS and abs(away_y) <= DEPARTS
    if stands:
        share = min(1.0, passed / FOLLOWS)
        stop[0] += share * away_x
        stop[1] += share * away_y
    return stands and stop[2] <= 0.0


@cached
def fixes_are_still(fixes: Array, kinds: Array, n: int, now: float, until: Array) -> bool:
    """Return True if a straight-line fit to the fixes of the last few seconds has a low speed.

    Rows of ``fixes`` begin with t, x, y. Of the first ``n`` rows, those with times up to ``now`` are read, except stale
    fixes of a driving car (``kinds``, see `stale_fixes`). The result is valid until ``until[0]`` if no fix is added.
    After an outage, the result is False until the window is full. The noise of the speed is three times as large with
    half a window as with a full window, so a departing car could appear to be at rest.
    """
    count, t1, x1, y1, tt, tx, ty = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    first, last, k = 0, 0, n - 1
    until[0] = now + FIX_WINDOW
    while k >= 0 and fixes[k, 0] >= now - FIX_WINDOW:
        if fixes[k, 0] > now:
            until[0] = fixes[k, 0]
        elif kinds[k] != STALE_MOVING:
            first = k
            last = max(last, k)
            age, x, y = now - fixes[k, 0], fixes[k, 1] - fixes[last, 1], fixes[k, 2] - fixes[last, 2]
            count += 1.0
            t1 += age
            x1 += x
            y1 += y
            tt += age * age
            tx += age * x
            ty += age * y
        k -= 1
    if count < 3.0:
        return False
    until[0] = min(until[0], fixes[first, 0] + FIX_WINDOW - CLOSE)
    span = fixes[last, 0] - fixes[first, 0]
    if span < 0.5 * FIX_WINDOW:
        return False
    if fixes[first, 0] - (now - FIX_WINDOW) > FILLED * span / (count - 1.0):
        until[0] = now
        return False
    tt -= t1 * t1 / count
    tx -= t1 * x1 / count
    ty -= t1 * y1 / count
    return math.hypot(tx, ty) < FIX_SPEED * tt
