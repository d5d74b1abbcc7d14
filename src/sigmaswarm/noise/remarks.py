"""Remarks on a log: noise terms that the log does not determine, and signs of faults."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Imu
from sigmaswarm.geodesy import STANDARD_GRAVITY
from sigmaswarm.noise.allan import model_parts
from sigmaswarm.noise.records import DEG_PER_HOUR, HOUR, MGAL, AxisNoise
from sigmaswarm.noise.spectrum import NoiseFit
from sigmaswarm.noise.static import Stretches, step_of
from sigmaswarm.wording import count_of

MIN_DURATION = 1800.0  # s, shortest stretch that shows bias instability and rate random walk
MIN_TREND_DURATION = 300.0  # s, shortest stretch whose trend is tested
MIN_STATIC_SHARE = 0.95  # smallest fraction of samples at rest without a remark
MAX_GRAVITY_ERROR = 0.1  # relative error of gravity that suggests another unit
# 10 deg/sqrt(h) in rad/s/sqrt(Hz). Values from logs in rad/s are smaller; values from logs in deg/s are usually larger.
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
    if longest < MIN_DURATION:
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
            f"{axis} drifts by {scale * trend * HOUR:.3g} {unit} per hour, more than its noise explains, as during "
            "warm-up: start the log half an hour after switching the sensor on"
        )


def on_misfit(axes: Sequence[AxisNoise], duration: float) -> Iterator[str]:
    """Remark on axes whose Allan deviation differs from that of the model; ``duration``: longest time at rest, s."""
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
    """Return the least-squares trend, unit/s; 0 if the fitted processes explain it."""
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
