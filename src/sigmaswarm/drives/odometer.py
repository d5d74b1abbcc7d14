"""What the wheels tell a filter, and when: readings put together, ten times a second at most.

A reading's error is not white (the scale, the quantization, the tires), so readings of 83 Hz tell no more than their
mean over a tenth of a second; the mean takes off what quantization adds. It is absorbed at an IMU sample, as that of a
moment between: its age counts like a latency. Slow wheels give few pulses and read zero while the car still creeps.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Odometer

INTERVAL = 0.1
"""s: between two looks at the odometer, at least, and the age of the oldest reading that one takes."""
SLOW = 0.5
"""m/s: at a mean reading below it the car may be as fast as that, whatever the wheels say."""
STALE = 1.0
"""s: an older reading says nothing of whether the wheels turn."""

SPEED, AGE, MORE = range(3)
"""Columns of what is absorbed: the mean of the readings, m/s, their mean age, s, and what is added to R, m2/s2."""


@dataclass(frozen=True, eq=False)
class Wheels:
    """What the steps of a time line take of an odometer.

    Attributes
    ----------
    absorbs : (k,) bool: the wheels' speed is absorbed at the step's end
    rows : (o, 3) in the order in which steps absorb them: see SPEED ... MORE
    turn : (k,) bool: at the step's end the wheels turn, so the car does not stand
    """

    absorbs: NDArray[np.bool_]
    rows: Array
    turn: NDArray[np.bool_]


def put_together(odometer: Odometer, start: float, end: Array, sampled: NDArray[np.bool_]) -> Wheels:
    """What each step absorbs; ``end`` (k,) s says when it ends, ``sampled`` (k,) where that is at an IMU sample.

    A look is taken at the first sample of each interval with a new reading; it takes the readings since the last look.
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
