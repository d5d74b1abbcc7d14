"""Compare the vehicles and the sensors of drives."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from operator import attrgetter

import numpy as np

from sigmaswarm.drives.mounting import NO_ROTATION
from sigmaswarm.drives.sensors import LogProperties
from sigmaswarm.geodesy import rotation_of

MAX_RATE_RATIO = 1.5  # largest ratio of the sampling rates of two drives with the same sensors
MAX_ANGLE = 10.0  # deg, largest angle between the mountings of two drives with the same mounting


def describe_vehicles(logs: Sequence[LogProperties]) -> str:
    """Return a warning if drives are clearly from different vehicles or sensors, else ""."""
    found = "; ".join(differences(logs))
    return found and (
        f"the training drives seem to be from different vehicles or sensors: {found}. A filter fits one vehicle and "
        "its sensors; tune one filter for each vehicle"
    )


def differences(logs: Sequence[LogProperties]) -> Iterator[str]:
    """Yield a clause for each property that clearly differs between the drives."""
    for sensor, interval in (("IMU", attrgetter("interval")), ("receiver", attrgetter("fix_interval"))):
        fast, slow = min(logs, key=interval), max(logs, key=interval)
        high, low = 1 / interval(fast), 1 / interval(slow)
        if high > MAX_RATE_RATIO * low:
            yield f"the {sensor} of {fast.name} has {high:.3g} Hz, and the {sensor} of {slow.name} {low:.3g} Hz"
    pairs = [*combinations((log for log in logs if log.mounting), 2)]
    for one, other in sorted(pairs, key=lambda pair: -_angle(*pair))[:1]:
        if (angle := _angle(one, other)) > MAX_ANGLE:
            yield f"the mountings of the IMU in {one.name} and {other.name} differ by {angle:.0f} deg"


def _angle(one: LogProperties, other: LogProperties) -> float:
    """Return the angle between two mountings, deg."""
    first, second = (rotation_of(*(log.mounting or NO_ROTATION)) for log in (one, other))
    return float(np.degrees(np.arccos(np.clip((np.trace(first.T @ second) - 1) / 2, -1.0, 1.0))))
