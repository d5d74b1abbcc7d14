"""Odometer measurements of a filter: readings averaged over at least a tenth of a second.

Errors of readings are not white (scale, quantization, tires). So this mean contains as much information as readings at
83 Hz, with less quantization error. At low speed there are few pulses, and the odometer may read zero while the car
moves.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Array, Odometer

INTERVAL = 0.1  # s, shortest time between measurements, and largest age of a reading in a measurement
SLOW = 0.5
"""Speed below which the odometer may read too low, m/s; its square is added to the variance of lower readings."""
LARGEST_AGE = 1.0  # s; an older reading does not show whether the wheels turn

SPEED, AGE, MORE = range(3)
"""Columns of a measurement: mean of the readings, m/s, their mean age, s, and additional variance in R, m2/s2."""


@dataclass(frozen=True, eq=False)
class Wheels:
    """Odometer measurements of the steps of a time line.

    ``updates`` (k,) marks steps that end with one of the measurements ``rows`` (o, 3): see SPEED ... MORE. ``turn``
    (k,) marks steps at whose end the wheels turn, so that the car does not stand.
    """

    updates: NDArray[np.bool_]
    rows: Array
    turn: NDArray[np.bool_]


def measurements_of(odometer: Odometer, start: float, end: Array, sampled: NDArray[np.bool_]) -> Wheels:
    """Compute the measurements; steps end at ``end`` (k,), s, and at an IMU sample where ``sampled`` (k,).

    In each interval with a new reading, the measurement is at the first IMU sample after this reading, and averages the
    readings since the last measurement.
    """
    readings = np.column_stack([odometer.time, odometer.speed])
    updates, turn = np.zeros((2, len(end)), dtype=np.bool_)
    rows = np.empty((np.count_nonzero(sampled), 3))
    n = _measure_all(readings, start, end, sampled, updates, turn, rows)
    return Wheels(updates, rows[:n].copy(), turn)


@cached
def _measure_all(
    readings: Array,
    start: float,
    end: Array,
    sampled: NDArray[np.bool_],
    updates: NDArray[np.bool_],
    turn: NDArray[np.bool_],
    rows: Array,
) -> int:
    n, r, last_slot, taken, before = 0, 0, -1.0, start, start
    for k in range(len(end)):
        if sampled[k]:
            now = end[k]
            while r < len(readings) and readings[r, 0] <= now:
                r += 1
            turn[k] = wheels_turn(readings, r, now)
            slot = slot_of(now, start, INTERVAL)
            if slot != last_slot and mean_reading(readings, r, now, before, taken, rows[n]):
                updates[k] = True
                n, last_slot, taken = n + 1, slot, now
            before = now
    return n


@register_jitable
def slot_of(t: Any, start: float, interval: float) -> Any:
    """Return the number of the interval that contains a time; each constraint is used once per interval."""
    return np.floor((t - start) / interval + 1e-6)


@cached
def wheels_turn(readings: Array, end: int, now: float) -> bool:
    """Return True if the wheels turn.

    The first ``end`` rows of ``readings``, time and speed, are up to now.
    """
    return end > 0 and readings[end - 1, 0] > now - LARGEST_AGE and abs(readings[end - 1, 1]) >= SLOW


@cached
def mean_reading(readings: Array, end: int, now: float, before: float, taken: float, wheels: Array) -> bool:
    """Average the readings since the last measurement; return False if there is no new reading.

    ``taken`` is the time of the last measurement, and a new reading is later than ``before``. The result is stored in
    ``wheels`` (3,): see SPEED ... MORE.
    """
    oldest = now - INTERVAL
    if end == 0 or readings[end - 1, 0] <= max(before, oldest):
        return False
    first = end
    while first > 0 and readings[first - 1, 0] > max(taken, oldest):
        first -= 1
    total, age, n = 0.0, 0.0, float(end - first)
    for r in range(first, end):
        total += readings[r, 1]
        age += now - readings[r, 0]
    wheels[SPEED] = total / n
    wheels[AGE] = age / n
    wheels[MORE] = SLOW * SLOW if abs(wheels[SPEED]) < SLOW else 0.0
    return True
