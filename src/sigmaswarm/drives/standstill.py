"""When does the car stand? Told from the IMU's calm and from fixes that stay where they are; causally."""

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive

WINDOW = 1.0
"""s of samples that must be calm."""
CALM = 2.5
"""A window is calm if it is at most that many times as restless as the calmest one so far."""
FIX_WINDOW = 3.0
"""s of fixes that must stay where they are."""
FIX_SPEED = 0.5
"""m/s: the speed that the fixes may show while the car stands."""
TURNING = np.radians(1.5)
"""rad/s: a car that stands does not turn; a gyro's bias stays below this."""


def standing(drive: Drive) -> NDArray[np.bool_]:
    """Whether the car stands at each IMU sample, shape (n,); from that sample and earlier data only.

    A smooth road at constant speed is as calm as a standstill, so the fixes must agree; a car that departs is slow for
    the fixes at first, so the accelerometer must agree.
    """
    imu = drive.imu
    restless = [_spread(imu.time, column) for column in (imu.ax, imu.ay, imu.gz)]
    calm = np.abs(imu.gz) < TURNING
    for spread in restless:
        floor = np.minimum.accumulate(np.where(np.isfinite(spread), spread, np.inf))
        calm &= spread <= CALM * np.maximum(floor, 1e-6)
    return calm & (_speed_of_fixes(drive) < FIX_SPEED)


def _spread(time: Array, values: Array) -> Array:
    """Standard deviation over the last second, shape (n,); inf where there is no whole second yet."""
    first = np.searchsorted(time, time - WINDOW, side="left")
    count = np.arange(1, len(time) + 1) - first
    centred = values - values.mean()  # sums of squares stay small
    sums, squares = (np.concatenate([[0.0], np.cumsum(v)]) for v in (centred, centred**2))
    after = np.arange(1, len(time) + 1)
    mean = (sums[after] - sums[first]) / count
    variance = (squares[after] - squares[first]) / count - mean**2
    whole = time - time[0] >= WINDOW
    return np.where(whole & (count >= 5), np.sqrt(np.maximum(variance, 0.0)), np.inf)


def _speed_of_fixes(drive: Drive) -> Array:
    """Speed (m/s) of a straight line through the last seconds' fixes, at each IMU sample; inf with too few fixes."""
    gps, time = drive.gps, drive.imu.time
    known = np.searchsorted(gps.time, time, side="right")  # fixes up to each sample
    speed = np.full(len(gps.time) + 1, np.inf)
    first = np.searchsorted(gps.time, gps.time - FIX_WINDOW, side="left")
    for i in range(len(gps.time)):
        t = gps.time[first[i] : i + 1]
        if len(t) < 3 or t[-1] - t[0] < 0.6 * FIX_WINDOW:
            continue
        t = t - t.mean()
        slopes = [float(t @ c[first[i] : i + 1] / (t @ t)) for c in (gps.x, gps.y)]
        speed[i + 1] = np.hypot(*slopes)
    recent = np.concatenate([[-np.inf], gps.time])[known]
    return np.where(time - recent < FIX_WINDOW, speed[known], np.inf)
