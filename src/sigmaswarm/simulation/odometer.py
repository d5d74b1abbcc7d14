"""The odometer: what counting pulses of the rear wheels makes of their turning, slip included.

The wheels are those that drive and brake the car (`dynamics`), so that they spin and lock as it does. A pulse comes
each time that a tooth passes; the speed is that of the pulses in a window before the reading. The control unit takes
the tires for larger or smaller than they are.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Odometer
from sigmaswarm.errors import InputError
from sigmaswarm.simulation.dynamics import REAR_SPIN, STEP, Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OdometerGrade:
    """A named quality of odometer.

    Attributes
    ----------
    rate : float
        Hz
    window : float
        s before a reading whose pulses it tells: it is half of that old.
    teeth : int
        Pulses of a turn of the wheels.
    scale_std : float
        Of the scale, drawn for each drive: reading over true speed, less 1.
    resolution : float
        m/s: of the number on the bus.
    slowest : float
        m/s: what is slower reads zero.
    """

    name: str
    rate: float
    window: float
    teeth: int
    scale_std: float = 0.01
    resolution: float = 0.0
    slowest: float = 0.0
    source: str = ""


ODOMETER_GRADES = {
    grade.name: grade
    for grade in (
        OdometerGrade("ideal", 100.0, 0.002, 1_000_000, 0.0, source="the wheels themselves: slip is left"),
        OdometerGrade(
            "pulses", 50.0, 0.1, 96, source="a ring of 48 teeth on each rear wheel, counted; recalled"
        ),
        OdometerGrade(
            *("can", 83.0, 0.05, 10_000),
            resolution=0.01 / 3.6,
            slowest=0.3,
            source="comma2k19's CAN: 83 Hz, fine; the times between pulses are measured. Its cutoff is recalled",
        ),
    )
}
"""By name. A scale of 1%: tires' wear and pressure, recalled; comma2k19's car is 0.8% low."""


def find_odometer(odometer: str | OdometerGrade) -> OdometerGrade:
    """A grade by its name.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if isinstance(odometer, OdometerGrade):
        return odometer
    if odometer not in ODOMETER_GRADES:
        raise InputError(f"unknown odometer {odometer!r}; choose from {', '.join(ODOMETER_GRADES)}")
    return ODOMETER_GRADES[odometer]


def measure_odometer(
    record: Array, car: Vehicle, grade: OdometerGrade, rng: np.random.Generator
) -> tuple[Odometer, float]:
    """Readings of a recorded drive (n, `RECORDED` or more), and the scale that was drawn."""
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
