"""Odometer measurements of a filter; each is the mean of the readings in a tenth of a second or less.

The errors of readings are correlated (scale, quantization, tires). At a rate of 83 Hz, a mean therefore contains as
much information as the single readings, with a smaller quantization error. At low speed, pulses are rare, and the
odometer may read zero while the car moves.
"""

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached

INTERVAL = 0.1  # s, length of a slot with at most one measurement, and largest age of a reading in it
SLOW = 0.5  # m/s; a lower mean may be too low, so the square of this speed is added to its variance
LARGEST_AGE = 1.0  # s; an older reading does not show whether the wheels turn

WHEEL_SPEED, WHEEL_AGE, WHEEL_NOISE = range(3)
"""Columns of a measurement: mean of the readings (m/s), their mean age (s), and variance added to R (m2/s2)."""


@cached
def wheels_turn(readings: Array, end: int, now: float) -> bool:
    """Return True if the last of the first ``end`` readings (time, speed) is recent and at least `SLOW`."""
    return end > 0 and readings[end - 1, 0] > now - LARGEST_AGE and abs(readings[end - 1, 1]) >= SLOW


@cached
def mean_reading(readings: Array, end: int, now: float, before: float, taken: float, wheels: Array) -> bool:
    """Average the readings since the last measurement, at most `INTERVAL` old. Return False if no reading is new.

    ``taken`` is the time of the last measurement. A reading is new if it is later than ``before``. The result is stored
    in ``wheels`` (3,) (see WHEEL_SPEED ... WHEEL_NOISE).
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
    wheels[WHEEL_SPEED] = total / n
    wheels[WHEEL_AGE] = age / n
    wheels[WHEEL_NOISE] = SLOW * SLOW if abs(wheels[WHEEL_SPEED]) < SLOW else 0.0
    return True
