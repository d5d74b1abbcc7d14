"""Static stretches of a log, and faults that make an axis unusable."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives import gaps
from sigmaswarm.drives.tables import Gps, Imu, Mask
from sigmaswarm.errors import InputError

AXES = ("ax", "ay", "az", "gx", "gy", "gz")
MIN_DURATION = 10.0  # s, shortest stretch
MIN_SAMPLES = 50  # samples of the shortest stretch
BLOCK = 1.0  # s, length of the blocks whose means and standard deviations show motion
MIN_BLOCK_SAMPLES = 20  # samples of a block; the standard deviation of fewer samples scatters too much
MIN_MEAN_CHANGE = {"a": 0.1, "g": np.radians(0.5)}  # m/s2, rad/s; larger changes of the mean show motion
# A block is at rest if its standard deviation is at most 3 times that of the quietest tenth, or at most `STATIC_STD`
MAX_STD_RATIO = 3.0
STATIC_STD = {"a": 0.02, "g": np.radians(0.1)}  # m/s2, rad/s
MOTION_STD = 0.3  # m/s2, an accelerometer with a larger standard deviation is in motion
FIX_SPEED = 0.5  # m/s, of a line fitted to the fixes of a stretch; a larger speed shows motion
SAMPLE = 100_000  # approximate number of samples that determine the quantization step
# Saturated axis: smallest ratio of the count at the end of the range to that at the next value
MIN_SATURATION_RATIO = 3.0
MIN_SATURATION_SHARE = 1e-3  # saturated axis: smallest fraction of samples at the end of the range


@dataclass(frozen=True)
class Stretches:
    """Static stretches: slices of the samples, their fraction of all samples, and the number of gaps in the log."""

    parts: tuple[slice, ...]
    share: float
    gaps: int


def find_stretches(imu: Imu, gps: Gps | None = None) -> Stretches:
    """Find the times at which the IMU is static, from its samples and the fixes.

    Raises
    ------
    InputError
        If samples are too few or invalid, or if no stretch is long enough.
    """
    steps = np.diff(imu.time)
    if len(imu) < MIN_SAMPLES or not np.all(steps > 0):
        raise InputError(
            f"at least {MIN_SAMPLES} samples with increasing times are needed, but the log has {len(imu)} samples, "
            f"or its times do not increase; record at least {MIN_DURATION:g} s"
        )
    columns = [axis for axis in AXES if getattr(imu, axis) is not None]
    if wrong := [axis for axis in columns if not np.isfinite(getattr(imu, axis)).all()]:
        raise InputError(f"{wrong[0]} has values that are not finite numbers; leave these samples out")
    interval = float(np.median(steps))
    size = max(round(BLOCK / interval), MIN_BLOCK_SAMPLES)
    gap = max(gaps.MANY * interval, gaps.SHORTEST)
    begins = np.concatenate([[0], np.flatnonzero(steps > gap) + 1])
    ends = np.append(begins[1:], len(imu))
    blocks = (ends - begins) // size
    starts = np.concatenate([b + size * np.arange(n) for b, n in zip(begins, blocks, strict=True)])
    fresh = np.isin(starts, begins)  # a block that follows a gap has no neighbor before it
    calm = _calm_blocks(imu, starts, size, fresh)
    whole = calm.all()
    parts: list[slice] = []
    for run in _runs(calm, fresh):
        # The car still rocks in the first and the last block of a standstill.
        first, last = (run.start, run.stop) if whole else (run.start + 1, run.stop - 1)
        part = slice(int(starts[first]), int(starts[last - 1]) + size) if last > first else slice(0, 0)
        if (part.stop - part.start) * interval >= MIN_DURATION and part.stop - part.start >= MIN_SAMPLES:
            parts += [] if gps is not None and _drives(imu, gps, part) else [part]
    if not parts:
        duration = imu.time[-1] - imu.time[0]
        what = f"log is {duration:.3g} s long" if duration < 2 * MIN_DURATION else "IMU moves"
        raise InputError(
            f"the {what}, and there is no standstill of {MIN_DURATION:g} s; record the IMU at rest for this "
            "time, or for an hour to determine all noise terms"
        )
    static = sum(part.stop - part.start for part in parts)
    return Stretches(tuple(parts), static / len(imu), len(begins) - 1)


def _calm_blocks(imu: Imu, starts: NDArray[np.int_], size: int, fresh: Mask) -> Mask:
    """Return a mask of blocks at rest: their standard deviations are small, and their means like those of neighbors."""
    calm = np.ones(len(starts), np.bool_)
    for axis in AXES:
        values = getattr(imu, axis)
        if values is None or not len(starts):
            continue
        mean, squares = np.zeros(len(starts)), np.zeros(len(starts))
        for k in range(size):
            mean += values[starts + k] / size
        for k in range(size):
            squares += (values[starts + k] - mean) ** 2 / size
        std = np.sqrt(squares)
        jumps = (np.abs(np.diff(mean)) > MIN_MEAN_CHANGE[axis[0]]) & ~fresh[1:]
        calm[1:] &= ~jumps
        calm[:-1] &= ~jumps
        calm &= std <= max(MAX_STD_RATIO * np.percentile(std, 10), STATIC_STD[axis[0]])
        if axis[0] == "a":
            calm &= std <= MOTION_STD
    return calm


def _runs(calm: Mask, fresh: Mask) -> list[slice]:
    runs: list[slice] = []
    first = 0
    for i in range(1, len(calm) + 1):
        if i == len(calm) or fresh[i] or calm[i] != calm[first]:
            runs += [slice(first, i)] if calm[first] else []
            first = i
    return runs


def _drives(imu: Imu, gps: Gps, part: slice) -> bool:
    first, last = imu.time[part.start], imu.time[part.stop - 1]
    inside = (gps.time >= first) & (gps.time <= last)
    if np.count_nonzero(inside) < 3:
        return False
    time = gps.time[inside] - np.mean(gps.time[inside])
    speeds = [np.dot(time, x[inside]) / np.dot(time, time) for x in (gps.x, gps.y)]
    return bool(np.hypot(*speeds) > FIX_SPEED)


def step_of(values: Array) -> float:
    """Return the quantization step of samples (n,); 0 if there is none."""
    levels = np.unique(values[:: max(1, len(values) // SAMPLE)])
    if len(levels) < 2 or len(levels) > SAMPLE // 10:
        return 0.0
    step = float(np.median(np.diff(levels)[np.diff(levels) > 1e-9 * np.ptp(levels)]))
    steps = np.diff(levels) / step
    return step if np.all(np.abs(steps - np.round(steps)) < 0.05) else 0.0


def fault_of(values: Sequence[Array]) -> str | None:
    """Return the reason why the samples of an axis do not show its noise, or None."""
    low, high = min(np.min(v) for v in values), max(np.max(v) for v in values)
    if low == high:
        return f"constant at {low + 0.0:.6g}: defective, or quantized in steps that are larger than its noise"
    step, count = step_of(np.concatenate(values)), sum(map(len, values))
    if high - low <= 2.5 * step:
        return f"quantized in steps of {step:.3g}, which hide the noise"
    for end, inward in ((high, -1.0), (low, 1.0)):
        inner = [v[v != end] for v in values]
        follows = -inward * max(float(np.max(-inward * v)) for v in inner if len(v))
        at_end, at_next = (sum(int(np.count_nonzero(v == x)) for v in values) for x in (end, follows))
        if at_end > max(MIN_SATURATION_RATIO * at_next, MIN_SATURATION_SHARE * count, 5):
            return (
                f"saturated: {100 * at_end / count:.2g}% of the samples are {end:.6g}, the end of the range"
            )
    return None
