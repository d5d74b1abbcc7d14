"""Determine the events at the ends of a filter's steps. These events depend on the data alone.

`sample_events` determines the events of one IMU sample. `events_of` applies this function to a timeline for
`run_filter`, and `compiled.live` to each new sample. `exports.c_rules` translates the function to C.
"""

from collections.abc import Set
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.odometer import INTERVAL, mean_reading, wheels_turn
from sigmaswarm.drives.tables import Mask
from sigmaswarm.drives.timeline import AY, FIRST_AXIS, FIX_VAR_THETA, Timeline

# Events, as bits.
FIX = 1  # update with a fix
IMU = 2  # time of an IMU sample: estimates are recorded and scored
VELOCITY = 4  # the fix has a velocity
LATERAL = 8  # the car's lateral velocity is constrained
STANDSTILL = 16  # the car is constrained to stand
HIDDEN = 32  # a fix that is hidden from the filter: the prediction of the fix is scored
ODOMETER = 64  # update with the wheels' speed
COMPARED = 128  # the heading is compared with the truth in the interval that ends or begins here
HEADING = 256  # the fix has a heading

CORNERING = 4.0  # m/s2, lateral acceleration above which tires slip too much for the lateral constraint

LATERAL_SLOT, STANDSTILL_SLOT, ODOMETER_SLOT, ODOMETER_TIME = range(4)
"""Indices into ``done`` of `sample_events`: slots (intervals of 0.1 s, numbered from the start) of the last lateral,
standstill and odometer updates, and time of the last odometer update, s.
"""
NO_READINGS = np.empty((0, 2))


class Events(NamedTuple):
    """The events of a timeline.

    ``flags`` (k,) contains the bits FIX to HEADING at the end of each step. ``wheels`` (o, 3) contains odometer
    measurements at the steps with the bit ODOMETER (see `drives.odometer`).
    """

    flags: NDArray[np.uint16]
    wheels: Array


def events_of(line: Timeline, used: Set[str]) -> Events:
    """Return the events of a filter that uses the measurements ``used`` (see `filters.starts.measured_by`).

    With "ay" (robot-localization, which has no standstill update), the bit STANDSTILL marks samples whose lateral
    acceleration is fused.
    """
    flags = np.zeros(len(line.updates), dtype=np.uint16)
    flags[line.updates] |= FIX
    flags[line.hides] |= HIDDEN
    flags[line.sampled] |= IMU
    if "velocity" in used and line.has_velocity:
        flags[line.updates] |= VELOCITY
    if "heading" in used:
        chosen = np.zeros(len(flags), dtype=np.bool_)
        chosen[line.updates | line.hides] = line.fixes[:, FIX_VAR_THETA] < np.inf
        flags[chosen & line.updates] |= HEADING
    if "ay" in used:
        flags[line.sampled] |= STANDSTILL
    bits = bits_of(used)
    if not bits:
        return Events(flags, np.empty((0, 3)))
    stands = line.stands if bits & STANDSTILL else np.zeros(len(flags), dtype=np.bool_)
    readings, odometer = NO_READINGS, line.drive.odometer
    if bits & ODOMETER and odometer is not None:
        readings = np.column_stack([odometer.time, odometer.speed])
    wheels = np.empty((np.count_nonzero(line.sampled) if len(readings) else 0, 3))
    ay = line.driving[:, AY - FIRST_AXIS]
    n = _add_sample_events(
        flags, wheels, bits, line.start, line.end, line.sampled, ay, line.sample, stands, readings
    )
    return Events(flags, wheels[:n].copy())


def bits_of(used: Set[str]) -> int:
    """Return the bits of the constraints and the odometer among the measurements that a filter uses."""
    bits = {"lateral": LATERAL, "standstill": STANDSTILL, "odometer": ODOMETER}
    return sum(bit for name, bit in bits.items() if name in used)


@cached
def _add_sample_events(
    flags: NDArray[np.uint16],
    wheels: Array,
    used: int,
    start: float,
    end: Array,
    sampled: Mask,
    ay: Array,
    sample: NDArray[np.int32],
    stands: Mask,
    readings: Array,
) -> int:
    """Add the events of all IMU samples to ``flags``. Return the number of filled rows of ``wheels``."""
    n, come, before, mean = 0, 0, start, np.empty(3)
    done = np.array([-1.0, -1.0, -1.0, start])
    for k in range(len(end)):
        if not sampled[k]:
            continue
        now = end[k]
        while come < len(readings) and readings[come, 0] <= now:
            come += 1
        slot = slot_of(now, start, INTERVAL)
        events = sample_events(used, slot, now, before, ay[sample[k]], stands[k], readings, come, done, mean)
        flags[k] |= events
        if events & ODOMETER:
            wheels[n] = mean
            n += 1
        before = now
    return n


@register_jitable
def slot_of(t: Any, start: float, interval: float) -> Any:
    return np.floor((t - start) / interval + 1e-6)


@cached
def sample_events(
    used: int,
    slot: float,
    now: float,
    before: float,
    ay: float,
    stands: bool,
    readings: Array,
    come: int,
    done: Array,
    wheels: Array,
) -> int:
    """Return the events at an IMU sample. Each constraint, and the odometer, is used at most once per slot.

    ``used`` contains the bits of the events that the filter uses. For ``slot`` see `slot_of`. ``now`` and ``before``
    are the times of this and of the previous sample, s. ``ay`` is in m/s2. ``stands`` is True if IMU and fixes show a
    standstill. The first ``come`` rows of ``readings`` (time and speed) are the readings up to ``now``. ``done`` (4,)
    is updated (see LATERAL_SLOT). ``wheels`` (3,) receives the odometer's measurement if there is one.
    """
    events = 0
    if used & LATERAL and done[LATERAL_SLOT] != slot and abs(ay) <= CORNERING:
        done[LATERAL_SLOT] = slot
        events |= LATERAL
    if (
        used & ODOMETER
        and done[ODOMETER_SLOT] != slot
        and mean_reading(readings, come, now, before, done[ODOMETER_TIME], wheels)
    ):
        done[ODOMETER_SLOT] = slot
        done[ODOMETER_TIME] = now
        events |= ODOMETER
    if (
        used & STANDSTILL
        and stands
        and done[STANDSTILL_SLOT] != slot
        and not (used & ODOMETER and wheels_turn(readings, come, now))
    ):
        done[STANDSTILL_SLOT] = slot
        events |= STANDSTILL
    return events
