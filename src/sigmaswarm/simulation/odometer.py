"""Simulate an odometer that counts pulses of the rear wheels in a time window, with slip and a wrong tire size."""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Odometer
from sigmaswarm.simulation.dynamics import REAR_SPIN, STEP, Vehicle
from sigmaswarm.simulation.environments import by_name


@dataclass(frozen=True)
class OdometerGrade:
    """A named grade of odometer.

    Attributes
    ----------
    rate : float
        Rate of the readings, Hz.
    window : float
        Length of the counting window before a reading, s. The age of a reading is half of this length.
    teeth : int
        Pulses of both rear wheels together per revolution.
    scale_std : float
        Standard deviation of the scale error (reading / true speed - 1), drawn for each drive.
    resolution : float
        Resolution of the speed on the bus, m/s.
    slowest : float
        Lowest reported speed, m/s; lower speeds are reported as zero.
    """

    name: str
    rate: float
    window: float
    teeth: int
    scale_std: float = 0.01
    resolution: float = 0.0
    slowest: float = 0.0
    source: str = ""


ODOMETER_GRADES = by_name(
    OdometerGrade("ideal", 100.0, 0.002, 1_000_000, 0.0, source="exact wheel speed; the only error is slip"),
    OdometerGrade(
        "pulses",
        50.0,
        0.1,
        96,
        source="a ring of 48 teeth on each rear wheel; from the author's memory, not verified",
    ),
    OdometerGrade(
        *("can", 83.0, 0.05, 10_000),
        resolution=0.01 / 3.6,
        slowest=0.3,
        source="CAN speed as in comma2k19: 83 Hz, fine resolution, from the times between pulses; the lowest speed "
        "is from the author's memory, not verified",
    ),
)
"""Grades by name.

The standard deviation of the scale error (wear and pressure of tires), 1%, is from the author's memory. The odometer of
comma2k19's car reads 0.8% too low.
"""


def measure_odometer(
    record: Array, car: Vehicle, grade: OdometerGrade, rng: np.random.Generator
) -> tuple[Odometer, float]:
    """Measure the wheel speed in a record (n, 21 or more) of the car; return the readings and the drawn scale."""
    scale = 1.0 + grade.scale_std * rng.standard_normal()
    phase, tooth = rng.uniform(0.0, 1.0, 2)
    time = np.arange(grade.window + phase / grade.rate, (len(record) - 1) * STEP, 1 / grade.rate)
    turned = np.concatenate([[0.0], np.cumsum(record[:-1, REAR_SPIN]) * STEP]) * grade.teeth / (2 * np.pi)
    moments = np.arange(len(record)) * STEP
    passed = [np.floor(np.interp(t, moments, turned) + tooth) for t in (time - grade.window, time)]
    length = 2 * np.pi * car.wheel_radius / grade.teeth
    speed = scale * length * (passed[1] - passed[0]) / grade.window
    if grade.resolution > 0:
        speed = grade.resolution * np.round(speed / grade.resolution)
    return Odometer(time, np.where(np.abs(speed) < grade.slowest, 0.0, speed)), scale
