"""A log that begins in reverse: the start of a filter takes the course for the heading, 180 degrees off."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding
from sigmaswarm.doctor.yaw_fit import integral, smoothed
from sigmaswarm.drives.drive import Array

STANDS = 1.0
"""m/s: a slower car may change its direction."""
STEP = 2.0
"""s: over which changes of speed are compared with ax."""
CLEAR, LEAST = 3.0, 0.4
"""Deviations and size by which the slope of the changes of speed on ax differs from 0."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the direction of the first motion."""
    until = _reverses_until(evidence)
    if until is not None:
        yield Finding(
            "reverse-start", "serious",
            f"the log seems to begin in reverse, until t = {until:.0f} s: there ax is positive where the speed falls",
            "gps.csv, imu.csv, ax", (evidence.span[0], until), 0.99,
            f"cut that part off: sigmaswarm split DRIVE --at {until + 2:.0f}, and use the second part",
        )  # fmt: skip


def _reverses_until(evidence: Evidence) -> float | None:
    """Return the time, s, of the end of the first motion, if only that is backwards."""
    course, mount = evidence.course, evidence.mount
    if course is None or mount is None or not evidence.drives or mount.axes[0, 0] <= 0:
        return None
    imu = evidence.drive.imu
    gained = smoothed(imu.time, integral(imu.time, imu.ax), course.time - evidence.clock.late, course.span)
    speed = np.abs(course.velocity)
    runs = [(run, _slope(course.time[run], speed[run], gained[run])) for run in _runs(speed > STANDS)]
    shown = [(run, *slope) for run, slope in runs if slope is not None]
    if len(shown) < 2:
        return None
    (first, slope, std), *rest = shown
    backwards = slope < -max(CLEAR * std, LEAST)
    forwards = any(slope > max(CLEAR * std, LEAST) for _, slope, std in rest)
    return float(course.time[first.stop - 1]) if backwards and forwards else None


def _runs(moving: np.ndarray) -> list[slice]:
    """Stretches of five fixes or more between stops."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], moving.astype(int), [0]])))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 5]


def _slope(time: Array, speed: Array, gained: Array) -> tuple[float, float] | None:
    """Slope of the changes of speed on those that ax gives, and its deviation; None where the speed hardly changes."""
    step = max(round(STEP / float(np.median(np.diff(time)))), 1)
    if len(time) < step + 4:
        return None
    y, x = speed[step:] - speed[:-step], gained[step:] - gained[:-step]
    y, x = y - y.mean(), x - x.mean()
    power = float(x @ x)
    if power < 1.0:
        return None
    slope = float(x @ y) / power
    left = y - slope * x
    return slope, float(np.sqrt(step * np.sum((x * left) ** 2)) / power) + 1e-6
