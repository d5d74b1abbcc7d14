"""Search for a large clock offset at which the turns of the gyro match those of the course."""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.mounting import level_rotation, rotate_imu
from sigmaswarm.doctor.verdicts import DEGREE
from sigmaswarm.doctor.windows import integral
from sigmaswarm.drives.drive import Drive

MAX_OFFSET = 40.0  # s; GPS time minus UTC (18 s) and the start-up of most receivers are shorter
STEP = 0.1  # s, step of the tried offsets
PEAK_WIDTH = 4.0  # s, distance from the best offset within which other offsets belong to the same peak
TURN_INTERVAL = 5.0  # s, interval over which turns are compared
MIN_EXPLAINED = 0.8  # smallest fraction of the variance of the turns that the best offset explains
MIN_LEAD = 0.15  # smallest lead in this fraction over offsets outside of the peak
# Alternative to the lead: smallest ratio of the unexplained fraction of any other offset to that of the best offset. If
# turns repeat, other offsets may also explain a large fraction.
MIN_UNEXPLAINED_RATIO = 4.0
MIN_PAIRS = 20  # smallest number of pairs of fixes: see `_pairs`
MIN_SEARCH_TURN = 0.15  # rad, smallest RMS change of the course within `TURN_INTERVAL`


def search_offset(drive: Drive, course: Course, *, scaled: bool = False) -> float | None:
    """Find the delay of the fixes, s; None if no delay is significant.

    ``scaled``: also accept any factor of the yaw rate, and a yaw rate in column gx or gy.
    """
    imu, at = drive.imu, course.time
    first, last = _pairs(course)
    if len(first) < MIN_PAIRS:
        return None
    turn = course.angle[last] - course.angle[first]
    whole = float(np.sum((turn - turn.mean()) ** 2))
    if np.sqrt(np.mean((turn - np.mean(turn)) ** 2)) < MIN_SEARCH_TURN:
        return None
    # The rate about the vertical for any mounting, or gz if the IMU lacks one of the six axes.
    planar = imu.az is None or imu.gx is None or imu.gy is None
    rates = [imu.gz if planar else rotate_imu(imu, level_rotation(imu)).gz]
    if scaled and not planar:
        rates += [rate for rate in (imu.gx, imu.gy) if rate is not None]
    totals = [integral(imu.time, rate) for rate in rates]

    def explained(lag: float, total: Array) -> float:
        start, end = at[first] - lag, at[last] - lag
        inside = (start >= imu.time[0]) & (end <= imu.time[-1])
        if np.count_nonzero(inside) < max(MIN_PAIRS, len(turn) / 3):
            return 0.0
        seen = np.interp(end[inside], imu.time, total) - np.interp(start[inside], imu.time, total)
        seen, true = seen - seen.mean(), turn[inside] - turn[inside].mean()
        power = float(true @ true)
        if power < 0.3 * whole:
            return 0.0
        factors = (
            [float(true @ seen) / max(float(seen @ seen), 1e-12)] if scaled else [1.0, -1.0, DEGREE, -DEGREE]
        )
        return max(1 - float(np.sum((true - k * seen) ** 2)) / power for k in factors)

    lags = np.arange(-MAX_OFFSET, MAX_OFFSET + STEP / 2, STEP)
    found = np.array([max(explained(lag, total) for total in totals) for lag in lags])
    best = int(np.argmax(found))
    others = found[np.abs(lags - lags[best]) > PEAK_WIDTH]
    clearly = min(others.max() + MIN_LEAD, 1 - (1 - others.max()) / MIN_UNEXPLAINED_RATIO)
    return float(lags[best]) if found[best] >= max(MIN_EXPLAINED, clearly) else None


def _pairs(course: Course) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of pairs of fixes about 5 s apart between which the car never stops."""
    interval = float(np.median(np.diff(course.time)))
    step = max(round(TURN_INTERVAL / interval), 1)
    first = np.arange(max(len(course.time) - step, 0))
    moves = np.append(0, np.cumsum(course.moving))
    first = first[moves[first + step + 1] - moves[first] == step + 1] if len(first) else first
    first = first[course.time[first + step] - course.time[first] < 1.5 * max(TURN_INTERVAL, interval)]
    return first, first + step
