"""Records of the noise of an IMU: numbers per axis, and a table in the units of data sheets."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.noise.spectrum import FLICKER, MARKOV_PEAK, Interval
from sigmaswarm.tables import Column, Table

HOUR = 3600.0  # s
DEG_PER_SQRT_HOUR = math.degrees(1) * 60  # factor from rad/s/sqrt(Hz)
DEG_PER_HOUR = math.degrees(1) * HOUR  # factor from rad/s
MPS_PER_SQRT_HOUR = 60.0  # factor from m/s2/sqrt(Hz)
MGAL = 1e5  # factor from m/s2
# Terms of an axis of an accelerometer and of a gyro in data sheets: name, factor from SI units, and unit.
UNITS = {
    "a": (
        ("velocity random walk", MPS_PER_SQRT_HOUR, "m/s/sqrt(h)"),
        ("bias instability", MGAL, "mGal"),
        ("rate random walk", MGAL * 60, "mGal/sqrt(h)"),
    ),
    "g": (
        ("angle random walk", DEG_PER_SQRT_HOUR, "deg/sqrt(h)"),
        ("bias instability", DEG_PER_HOUR, "deg/h"),
        ("rate random walk", DEG_PER_HOUR * 60, "deg/h/sqrt(h)"),
    ),
}
SENSORS = {"accel": ("ax ay az", "m/s2"), "gyro": ("gx gy gz", "rad/s")}


@dataclass(frozen=True, eq=False)
class AxisNoise:
    """The noise of one axis in SI units, with 95% intervals.

    Attributes
    ----------
    axis : {"ax", "ay", "az", "gx", "gy", "gz"}
    white : Interval
        Velocity or angle random walk: density of the white noise, unit/sqrt(Hz).
    instability : Interval
        Bias instability: coefficient of the flicker noise, unit. The floor of the Allan deviation is 0.664 times this
        value.
    walk : Interval
        Rate random walk: coefficient of the random walk of the bias, unit/sqrt(s).
    correlation_time : float
        Correlation time of a Gauss-Markov bias, s; inf if the log does not show that the bias returns to its mean.
    drift : float
        Trend, unit/s; 0 if the other terms explain it.
    tau, deviation : array (n,)
        Overlapping Allan deviation: averaging time, s, and deviation in the unit of the axis.
    """

    axis: str
    white: Interval
    instability: Interval
    walk: Interval
    correlation_time: float
    drift: float
    tau: Array
    deviation: Array

    @property
    def terms(self) -> dict[str, Interval]:
        return {"white": self.white, "instability": self.instability, "walk": self.walk}

    def bias(self, longest: float) -> tuple[float, float]:
        """Return the standard deviation (unit) and correlation time (s) of the bias as a Gauss-Markov process.

        ``longest`` is the length (s) of the longest stretch at rest, which replaces an infinite correlation time.
        Flicker noise adds the variance of a Gauss-Markov process whose largest Allan variance equals that of the
        flicker noise. If the log shows neither flicker noise nor a random walk, the upper end of the interval of
        ``walk`` is used.
        """
        time = self.correlation_time if math.isfinite(self.correlation_time) else longest
        nothing = self.walk.value == 0 and self.instability.value == 0
        walk = self.walk.high if nothing else self.walk.value
        variance = walk**2 * time / 2 + self.instability.value**2 * FLICKER / MARKOV_PEAK
        return math.sqrt(variance), time


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of an IMU.

    Attributes
    ----------
    name : str
    rate : float
        Hz
    axes : tuple of AxisNoise
        The axes that could be measured.
    stretches : tuple of (float, float)
        Start (in the time of the log) and length of each static stretch, s.
    remarks : tuple of str
        Noise terms that the log does not determine, and signs of faults.
    """

    name: str
    rate: float
    axes: tuple[AxisNoise, ...]
    stretches: tuple[tuple[float, float], ...]
    remarks: tuple[str, ...]

    @property
    def longest(self) -> float:
        """Length of the longest stretch at rest, s; an hour if there is no such stretch."""
        return max((length for _, length in self.stretches), default=HOUR)

    def of(self, sensor: str, value: Callable[[AxisNoise], float]) -> list[float]:
        """Return a value for the three axes of a sensor; a missing axis has the RMS of the other axes."""
        known = {a.axis: value(a) for a in self.axes}
        axes = SENSORS[sensor][0].split()
        there = [known[a] for a in axes if a in known]
        usual = math.sqrt(float(np.mean(np.square(there)))) if there else 0.0
        return [known.get(a, usual) for a in axes]

    def mean(self, sensor: str, value: Callable[[AxisNoise], float]) -> float:
        return math.sqrt(float(np.mean(np.square(self.of(sensor, value)))))

    def table(self) -> Table:
        """Return the table of all axes, in the units of data sheets."""
        columns = *map(Column, ("axis", "noise", "value")), Column("95%", joined=True), Column("unit")
        rows = [
            (
                axis.axis,
                name,
                scale * i.value,
                (scale * i.low, scale * i.high) if i.low < i.high else None,
                unit,
            )
            for axis in self.axes
            for i, (name, scale, unit) in zip(axis.terms.values(), UNITS[axis.axis[0]], strict=True)
            if i.high > 0  # the noise of a filter (`filter_noise`) has terms that are 0
        ]
        return Table(f"Noise of the IMU, {self.name}", columns, tuple(rows))

    def to_dict(self) -> dict[str, Any]:
        """Return the record in SI units, for JSON."""
        return {
            "name": self.name,
            "rate_hz": self.rate,
            "stretches_s": [list(stretch) for stretch in self.stretches],
            "axes": {a.axis: _content(a) for a in self.axes},
            "remarks": list(self.remarks),
        }


def _content(axis: AxisNoise) -> dict[str, Any]:
    content: dict[str, Any] = {name: asdict(interval) for name, interval in axis.terms.items()}
    content |= {"correlation_time_s": axis.correlation_time, "drift": axis.drift}
    return content | {"tau_s": axis.tau.tolist(), "allan_deviation": axis.deviation.tolist()}
