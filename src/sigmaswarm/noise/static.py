"""Static stretches of a log, faults that make an axis unusable, and remarks on the noise of the other axes."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives import gaps
from sigmaswarm.drives.tables import Gps, Imu, Mask
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import STANDARD_GRAVITY
from sigmaswarm.noise.records import DEG_PER_HOUR, HOUR, MGAL, AxisNoise
from sigmaswarm.noise.spectrum import NoiseFit, model_parts
from sigmaswarm.wording import count_of

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
    if wrong := [axis for axis in imu.axes if not np.isfinite(getattr(imu, axis)).all()]:
        raise InputError(f"{wrong[0]} has values that are not finite numbers; omit these samples")
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
            "time, or for an hour to estimate all noise terms"
        )
    static = sum(part.stop - part.start for part in parts)
    return Stretches(tuple(parts), static / len(imu), len(begins) - 1)


def _calm_blocks(imu: Imu, starts: NDArray[np.int_], size: int, fresh: Mask) -> Mask:
    """Return a mask of blocks at rest. Their standard deviations are small, and their means like those of neighbors."""
    calm = np.ones(len(starts), np.bool_)
    for axis in imu.axes if len(starts) else ():
        values = getattr(imu, axis)
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


MIN_SLOW_NOISE_DURATION = 1800.0  # s, shortest stretch that shows bias instability and rate random walk
MIN_TREND_DURATION = 300.0  # s, shortest stretch whose trend is tested
MIN_STATIC_SHARE = 0.95  # smallest fraction of samples at rest without a remark
MAX_GRAVITY_ERROR = 0.1  # relative error of gravity that suggests another unit
# 10 deg/sqrt(h) in rad/s/sqrt(Hz). Gyros in cars have less noise; the values are usually larger if a log in deg/s is
# read as rad/s.
MAX_GYRO_NOISE = 3e-3
MIN_INTERVALS = 30.0  # least number of averaging intervals (duration / tau) for an accurate Allan deviation
MISFIT = 1.5  # smallest reported ratio of the Allan deviation to that of the model, or its inverse
TREND = 4.0  # smallest reported ratio of a trend to its standard deviation under the fitted processes
MIN_STEP_RATIO = 0.5  # smallest reported ratio of the quantization step to the standard deviation


def on_stretches(stretches: Stretches, lengths: list[float]) -> Iterator[str]:
    total, longest = sum(lengths), max(lengths)
    if stretches.gaps:
        yield f"{count_of(stretches.gaps, 'gap')} in the log; each part between gaps is a separate stretch"
    if stretches.share < MIN_STATIC_SHARE:
        yield (
            f"the sensor moves or is disturbed in {100 * (1 - stretches.share):.0f}% of the log; only "
            f"{count_of(len(lengths), 'standstill')}, {total:.0f} s in total, {'is' if len(lengths) == 1 else 'are'} "
            "used; an engine's vibration counts as noise"
        )
    if longest < MIN_SLOW_NOISE_DURATION:
        yield (
            f"the longest stretch at rest lasts {longest:.0f} s, long enough for the white noise but too short for "
            "bias instability and rate random walk; use the upper ends of their intervals, or log an hour at rest"
        )


def on_gravity(imu: Imu, part: slice) -> Iterator[str]:
    if imu.az is None:
        return
    force = math.hypot(*(float(np.mean(column[part])) for column in (imu.ax, imu.ay, imu.az)))
    if not abs(force / STANDARD_GRAVITY - 1) < MAX_GRAVITY_ERROR:
        yield (
            f"the accelerometer measures {force:.3g} m/s2 at rest instead of {STANDARD_GRAVITY:.3g}: the unit looks "
            'wrong (if the value is about 1, the unit is g); convert each axis, as in --map "ax=acc_x*9.80665"'
        )


def on_gyro(axes: Sequence[AxisNoise]) -> Iterator[str]:
    if rough := [a.axis for a in axes if a.axis[0] == "g" and a.white.value > MAX_GYRO_NOISE]:
        yield (
            f"the noise of {', '.join(rough)} is as large as that of a gyro in deg/s: the unit looks wrong; convert "
            'each axis, as in --map "gz=radians(gyro_z)"'
        )


def on_step(axis: str, values: Array) -> Iterator[str]:
    step, deviation = step_of(values), float(np.std(values))
    if step > MIN_STEP_RATIO * deviation:
        yield (
            f"{axis} is quantized in steps of {step:.3g}, {step / deviation:.1f} times its standard deviation: the "
            "white noise includes quantization noise"
        )


def on_trend(axis: str, trend: float) -> Iterator[str]:
    """Remark on an axis with a trend, unit/s."""
    scale, unit = (DEG_PER_HOUR, "deg/h") if axis[0] == "g" else (MGAL, "mGal")
    if trend:
        yield (
            f"{axis} drifts by {scale * trend * HOUR:.3g} {unit} per hour, which its noise does not explain. "
            "Sensors drift during warm-up: start the log half an hour after the sensor is switched on"
        )


def on_misfit(axes: Sequence[AxisNoise], duration: float) -> Iterator[str]:
    """Remark on axes whose Allan deviation differs from that of the model.

    ``duration`` is the longest time at rest, s.
    """
    misfits: list[str] = []
    for a in axes:
        parts = model_parts(a.tau, a.white.value, a.instability.value, a.walk.value, a.correlation_time)
        ratio = (a.deviation / np.sqrt(np.sum(np.square(parts), axis=0)))[a.tau <= duration / MIN_INTERVALS]
        worst = int(np.argmax(np.abs(np.log(ratio))))
        if not 1 / MISFIT < ratio[worst] < MISFIT:
            misfits.append(
                f"{a.axis}: {ratio[worst]:.2g} times that of the model at tau = {a.tau[worst]:.2g} s"
            )
    if misfits:
        yield (
            f"the model does not fit the Allan deviation ({', '.join(misfits)}). Vibration, or a filter in the sensor, "
            "can be the cause. The model then describes only the slow noise, the part that a navigation filter "
            "integrates"
        )


def trend_of(values: Array, interval: float, noise: NoiseFit) -> float:
    """Return the least-squares trend, unit/s, or 0 if the fitted processes explain it."""
    n = len(values)
    duration = n * interval
    if duration < MIN_TREND_DURATION:
        return 0.0
    time = (np.arange(n) - (n - 1) / 2) * interval
    trend = float(np.dot(time, values - np.mean(values)) / np.dot(time, time))
    # The variance of a trend is the integral of the density times the squared response of the least-squares fit.
    x = np.geomspace(1e-2, 1e3, 2000)
    omega = 2 * x / duration
    rate = 0.0 if math.isinf(noise.time) else 1 / noise.time
    w, b, k = (term.value for term in (noise.white, noise.instability, noise.walk))
    density = w**2 + b**2 / omega + k**2 / (omega**2 + rate**2)
    response = 24 * (np.sin(x) - x * np.cos(x)) / (omega**2 * duration**3)
    variance = float(np.trapezoid(density * response**2, omega)) / math.pi
    return trend if abs(trend) > TREND * math.sqrt(variance) else 0.0
