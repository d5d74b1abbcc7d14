"""Standstills of the car, told from the IMU's calm and from fixes that stay where they are; causally.

A smooth road at constant speed is as calm as a standstill, so the fixes must agree; a car that departs is slow for the
fixes at first, so the IMU must agree. The same functions serve a whole drive and a live filter.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Array, Drive

WINDOW = 1.0
"""s of samples that must be calm."""
CALM = 2.5
"""A window is calm if it is at most that many times as restless as the car is when it is calm."""
SETTLES = 0.5
"""s in which the notion of calm follows a calmer window."""
RISES = 0.1
"""per s: how fast it rises while the car is about calm, so that one lucky window does not set it for good."""
FIX_WINDOW = 3.0
"""s of fixes that must stay where they are."""
FIX_SPEED = 0.8
"""m/s: the speed that the fixes may show while the car stands."""
TURNING = math.radians(1.5)
"""rad/s: a car that stands does not turn; a gyro's bias stays below this."""


def standing(drive: Drive) -> NDArray[np.bool_]:
    """Standstill at each IMU sample, shape (n,); from that sample and earlier data only."""
    imu, gps = drive.imu, drive.gps
    samples = np.column_stack([imu.time, imu.ax, imu.ay, imu.gz])
    calm = np.zeros(len(imu), dtype=np.bool_)
    _calm_throughout(samples, new_floor(), calm)
    stands = np.zeros(len(imu), dtype=np.bool_)
    seen = np.searchsorted(gps.time, imu.time, side="right")
    first = np.searchsorted(gps.time, imu.time - FIX_WINDOW, side="left")
    fixes = np.column_stack([gps.time, gps.x, gps.y])
    for k in np.flatnonzero(calm):
        stands[k] = fixes_stand(fixes[first[k] : seen[k]], imu.time[k])
    return stands


def new_floor() -> Array:
    """The deviations of ax, ay, gz while the car is calm, shape (3,), still unknown; `is_calm` learns them."""
    return np.full(3, np.inf)


@cached
def is_calm(samples: Array, last: int, floor: Array) -> bool:
    """True if the second before row ``last`` is calm; rows are t, ax, ay, gz; ``floor`` is updated.

    All three columns in one pass for the means and one for the variances: a live filter asks at each of its samples.
    """
    now, first = samples[last, 0], last + 1
    ax, ay, gz = 0.0, 0.0, 0.0
    while first > 0 and samples[first - 1, 0] >= now - WINDOW:
        first -= 1
        ax += samples[first, 1]
        ay += samples[first, 2]
        gz += samples[first, 3]
    n = last + 1 - first
    if n < 5 or now - samples[first, 0] < 0.8 * WINDOW:
        return False
    ax, ay, gz = ax / n, ay / n, gz / n
    xx, yy, zz = 0.0, 0.0, 0.0
    for k in range(first, last + 1):
        xx += (samples[k, 1] - ax) ** 2
        yy += (samples[k, 2] - ay) ** 2
        zz += (samples[k, 3] - gz) ** 2
    dt = now - samples[last - 1, 0]
    calm = abs(samples[last, 3]) < TURNING
    for c, total in enumerate((xx, yy, zz)):
        restless = math.sqrt(total / n)
        if not floor[c] < math.inf:
            floor[c] = restless
        elif restless < floor[c]:
            floor[c] += (restless - floor[c]) * min(1.0, dt / SETTLES)
        elif restless < 3.0 * floor[c]:
            floor[c] *= 1.0 + RISES * min(1.0, dt)
        calm = calm and restless <= CALM * max(floor[c], 1e-6)
    return calm


@cached
def _calm_throughout(samples: Array, floor: Array, calm: NDArray[np.bool_]) -> None:
    for k in range(len(samples)):
        calm[k] = is_calm(samples, k, floor)


@cached
def fixes_stand(fixes: Array, now: float) -> bool:
    """True if a straight line through the last seconds' fixes hardly moves; rows are t, x, y, none after ``now``."""
    first = 0
    while first < len(fixes) and fixes[first, 0] < now - FIX_WINDOW:
        first += 1
    n = len(fixes) - first
    if n < 3 or fixes[-1, 0] - fixes[first, 0] < 0.5 * FIX_WINDOW:
        return False
    mean = 0.0
    for k in range(first, len(fixes)):
        mean += fixes[k, 0] / n
    tt, tx, ty = 0.0, 0.0, 0.0
    for k in range(first, len(fixes)):
        t = fixes[k, 0] - mean
        tt += t * t
        tx += t * fixes[k, 1]
        ty += t * fixes[k, 2]
    return math.hypot(tx / tt, ty / tt) < FIX_SPEED
