"""Compare the vehicles and the sensors of drives."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.mounting import NO_ROTATION, Angles, axes_of
from sigmaswarm.geodesy import rotation_of

MAX_RATE_RATIO = 1.5  # largest ratio of the sampling rates of two drives with the same sensors
MAX_ANGLE = 10.0  # deg, largest angle between the mountings of two drives with the same mounting


@dataclass(frozen=True)
class SensorSetup:
    """Sensors of a drive: rates of IMU and fixes, Hz; ``mounting`` is None if the drive states none."""

    name: str
    imu_rate: float
    fix_rate: float
    mounting: Angles | None


def sensor_setup(drive: Drive) -> SensorSetup:
    # An imported drive states its axes, but not a rotation of zero.
    imported = NO_ROTATION if axes_of(drive.metadata) else None
    imu_rate, fix_rate = (1.0 / float(np.median(np.diff(table.time))) for table in (drive.imu, drive.gps))
    return SensorSetup(drive.name, imu_rate, fix_rate, drive.mounting or imported)


def describe_vehicles(setups: Sequence[SensorSetup]) -> str:
    """Return a warning if drives are clearly from different vehicles or sensors, else ""."""
    found = "; ".join(differences(setups))
    return found and (
        f"the training drives seem to be from different vehicles or sensors: {found}. A filter fits one vehicle and "
        "its sensors; tune one filter for each vehicle"
    )


def differences(setups: Sequence[SensorSetup]) -> Iterator[str]:
    """Yield a clause for each property that clearly differs between the drives."""
    rates: dict[str, Callable[[SensorSetup], float]] = {
        "IMU": lambda setup: setup.imu_rate,
        "receiver": lambda setup: setup.fix_rate,
    }
    for sensor, rate in rates.items():
        slow, fast = min(setups, key=rate), max(setups, key=rate)
        if rate(fast) > MAX_RATE_RATIO * rate(slow):
            yield (
                f"the {sensor} of {fast.name} has {rate(fast):.3g} Hz, and the {sensor} of {slow.name} "
                f"{rate(slow):.3g} Hz"
            )
    pairs = [*combinations((setup for setup in setups if setup.mounting), 2)]
    for one, other in sorted(pairs, key=lambda pair: -_angle(*pair))[:1]:
        if (angle := _angle(one, other)) > MAX_ANGLE:
            yield f"the mountings of the IMU in {one.name} and {other.name} differ by {angle:.0f} deg"


def _angle(one: SensorSetup, other: SensorSetup) -> float:
    """Return the angle between two mountings, deg."""
    first, second = (rotation_of(*(setup.mounting or NO_ROTATION)) for setup in (one, other))
    return float(np.degrees(np.arccos(np.clip((np.trace(first.T @ second) - 1) / 2, -1.0, 1.0))))
