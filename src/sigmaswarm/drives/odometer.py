"""Odometer measurements of a filter: readings averaged over at least a tenth of a second.

Errors of readings are not white (scale, quantization, tires), so readings of 83 Hz contain no more than their mean over
a tenth of a second, which reduces the quantization error. The mean is used at an IMU sample with its age as latency.
Slow wheels give few pulses and read zero while the car still creeps.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Odometer

INTERVAL = 0.1
"""s: shortest time between two measurements, and age of the oldest reading in one."""
SLOW = 0.5
"""m/s: at lower mean readings the car may be as fast as this."""
STALE = 1.0
"""s: readings older than this do not show if the wheels turn."""

SPEED, AGE, MORE = range(3)
"""Columns of a measurement: mean of the readings, m/s, their mean age, s, and additional variance in R, m2/s2."""


@dataclass(frozen=True, eq=False)
class Wheels:
    """Odometer measurements of the steps of a time line.

    Each step of ``absorbs`` (k,) ends with one of ``rows`` (o, 3): see SPEED ... MORE. At the end of steps of ``turn``
    (k,) the wheels turn, so the car does not stand.
    """

    absorbs: NDArray[np.bool_]
    rows: Array
    turn: NDArray[np.bool_]


def measurements_of(odometer: Odometer, start: float, end: Array, sampled: NDArray[np.bool_]) -> Wheels:
    """Compute the measurements; steps end at ``end`` (k,) s, at an IMU sample where ``sampled`` (k,).

    The first sample of each interval with a new reading uses the readings since the last measurement.
    """
    time, speed = odometer.time, odometer.speed
    steps = np.flatnonzero(sampled)
    samples = end[steps]
    oldest = np.maximum(np.append(start, samples[:-1]), samples - INTERVAL)
    fresh = np.searchsorted(time, samples, "right") > np.searchsorted(time, oldest, "right")
    slots = np.floor((samples[fresh] - start) / INTERVAL + 1e-6)  # as the live filter's `_slot`
    chosen = steps[fresh][np.unique(slots, return_index=True)[1]]
    looks = end[chosen]
    look = np.searchsorted(looks, time, "left")
    inside = (time > start) & (look < len(looks))
    inside[inside] = time[inside] > looks[look[inside]] - INTERVAL
    look = look[inside]
    counts = np.bincount(look, minlength=len(looks))
    mean = np.bincount(look, speed[inside], len(looks)) / counts  # added up in order, as the live filter does
    age = np.bincount(look, looks[look] - time[inside], len(looks)) / counts
    absorbs = np.zeros(len(end), dtype=np.bool_)
    absorbs[chosen] = True
    last = np.searchsorted(time, end, "right") - 1
    known = (last >= 0) & (time[last] > end - STALE)
    return Wheels(
        absorbs,
        np.column_stack([mean, age, np.where(np.abs(mean) < SLOW, SLOW**2, 0.0)]),
        known & (np.abs(speed[last]) >= SLOW),
    )
