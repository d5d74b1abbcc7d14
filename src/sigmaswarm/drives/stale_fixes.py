"""Find stale fixes: a receiver without satellites repeats its last position exactly while the car moves on.

A receiver with static hold also repeats its position at a red light; these repeats are correct. Earlier fixes show
whether the car had stopped before the first repeat. Later fixes are not used, so live filters can use the same
function.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Gps

NEW, HELD, STALE, STALE_MOVING = range(4)
"""Kinds of fixes: a new position, a repeat at rest, and two kinds of repeats while the car may move.

The speed at the first repeat is at most `NO_REST` for STALE. For STALE_MOVING the speed is higher, so these repeats are
not evidence of a standstill.
"""

BEFORE = 3.0  # s, age of the oldest fix that is compared; the previous fix is always compared
SPEED_WINDOW = 2.5  # s, window of fixes (at least two) for the speed; three fixes at 1 Hz show braking
REST = 0.8  # m/s, largest speed at rest, as `standstill.FIX_SPEED`
NO_REST = 2.0  # m/s; above this speed, the first repeat is not evidence of a standstill
BRAKING = 4.0  # m/s2, largest deceleration of a car; larger values are noise
ENOUGH = 3.0  # smallest number of new fixes that show braking; fewer give only a mean speed


def classify_fixes(gps: Gps) -> Array:
    """Classify all fixes, (n,): `NEW`, `HELD`, `STALE` or `STALE_MOVING`."""
    # This array has the layout of a live filter's array, so that `kind_of` is compiled once.
    fixes = np.column_stack([gps.time, gps.x, gps.y, np.zeros(len(gps.time))])
    kinds = fixes[:, 3]
    if len(kinds):
        _classify_all(fixes, kinds)
    return kinds.copy()


def stale_fixes(gps: Gps) -> NDArray[np.bool_]:
    """Mark the stale fixes, (n,); no filter uses their positions."""
    return classify_fixes(gps) >= STALE


@cached
def _classify_all(fixes: Array, kinds: Array) -> None:
    for k in range(len(fixes)):
        kinds[k] = kind_of(fixes, kinds, k)


@cached
def kind_of(fixes: Array, kinds: Array, k: int) -> int:
    """Classify fix ``k`` by the earlier fixes.

    The fix is compared with all fixes of the last few seconds, so that each of two receivers is compared with itself.
    The first repeat of a position determines the kind of all repeats that follow it.
    """
    now = fixes[k, 0]
    last = k - 1
    while last >= 0 and not fixes[last, 0] < now:  # fixes with equal times are from several receivers
        last -= 1
    j = last
    while j >= 0 and (j == last or fixes[j, 0] >= now - BEFORE):
        if fixes[j, 1] == fixes[k, 1] and fixes[j, 2] == fixes[k, 2]:
            if kinds[j] != NEW:
                return int(kinds[j])
            speed = _speed_at(fixes, kinds, j, now)
            return HELD if speed <= REST else (STALE if speed <= NO_REST else STALE_MOVING)
        j -= 1
    return NEW


@cached
def _speed_at(fixes: Array, kinds: Array, last: int, now: float) -> float:
    """Estimate the car's speed (m/s) at the time ``now`` from the new fixes of the last seconds, up to fix ``last``.

    The result is the smaller of the speeds of a fitted line and a fitted parabola, since a car that brakes to a halt
    was fast a second before. In a log that begins with repeated fixes, the result is 0.
    """
    origin, n = fixes[last, 0], 0.0
    t1, t2, t3, t4 = 0.0, 0.0, 0.0, 0.0
    x0, x1, x2, y0, y1, y2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    j = last
    while j >= 0 and (n < 2.0 or fixes[j, 0] >= origin - SPEED_WINDOW):
        if kinds[j] == NEW:
            t, x, y = -(origin - fixes[j, 0]), fixes[j, 1] - fixes[last, 1], fixes[j, 2] - fixes[last, 2]
            tt = t * t
            n += 1.0
            t1 += t
            t2 += tt
            t3 += tt * t
            t4 += tt * tt
            x0 += x
            x1 += x * t
            x2 += x * tt
            y0 += y
            y1 += y * t
            y2 += y * tt
        j -= 1
    s11 = t2 - t1 * t1 / max(n, 1.0)  # sums about the means
    if not s11 > 0.0:
        return 0.0
    sx, sy = (x1 - x0 * t1 / n) / s11, (y1 - y0 * t1 / n) / s11
    line = math.hypot(sx, sy)
    s12, s22 = t3 - t1 * t2 / n, t4 - t2 * t2 / n
    det = s11 * s22 - s12 * s12
    if n < ENOUGH or not det > 1e-9 * s11 * s22 or not line > 0.0:
        return line
    along1 = ((x1 - x0 * t1 / n) * sx + (y1 - y0 * t1 / n) * sy) / line
    along2 = ((x2 - x0 * t2 / n) * sx + (y2 - y0 * t2 / n) * sy) / line
    slope, bend = (s22 * along1 - s12 * along2) / det, (s11 * along2 - s12 * along1) / det
    slowest = line - BRAKING * (now - origin - t1 / n)  # the line has the speed at the mean time
    return min(line, max(slowest, slope + 2.0 * bend * (now - origin)))
