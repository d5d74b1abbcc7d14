"""Compare the receiver's speed and course with its positions: units, convention, delay."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.verdicts import FACTOR_TOLERANCE
from sigmaswarm.doctor.windows import smoothed
from sigmaswarm.geodesy import wrap_angle

UNITS = {"km/h": 1 / 3.6, "knots": 0.514444, "mph": 0.44704, "cm/s": 0.01, "mm/s": 1e-3}
# Conventions of a course other than rad counter-clockwise from east
CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "deg clockwise from north": lambda c: math.pi / 2 - np.radians(c),
    "rad clockwise from north": lambda c: math.pi / 2 - c,
    "deg counter-clockwise from east": np.radians,
}
MAX_DEVIATION = math.radians(15)
MIN_DELAY = 0.2  # s, smallest reported delay
MIN_FIXES = 30
REMEDY = (
    "leave speed and course out, or map them with their own times: add a second [[gps]] for the same table to the "
    "recipe, with a shifted t, and test this on another drive. A filter assumes one time for each row"
)


def check_velocity(evidence: Evidence) -> Iterator[Finding]:
    gps, course, span = evidence.drive.gps, evidence.course, evidence.span
    if gps.speed is None or gps.course is None or course is None:
        return
    speed = gps.speed[evidence.used]
    seen = course.moving & (speed > 0)
    if np.count_nonzero(seen) < MIN_FIXES:
        return
    ratio = float(np.median(np.abs(course.velocity[seen]) / speed[seen]))
    usual = 1 / FACTOR_TOLERANCE < ratio < FACTOR_TOLERANCE
    for unit, factor in UNITS.items():
        if abs(math.log(ratio / factor)) < 0.07 and not usual:
            what = f"speed is in {unit}: the fixes move at {ratio:.2f} times this speed"
            repair = Repair("velocity", (factor, 0.0))
            remedy = f"multiply speed by {factor:.4g}"
            yield Finding("speed-unit", "serious", what, "gps.csv, speed", span, 0.99, remedy, repair)
    angle, direction = gps.course[evidence.used][seen], course.angle[seen]

    def alike(angle: Array) -> bool:
        return float(np.median(np.abs(wrap_angle(angle - direction)))) <= MAX_DEVIATION

    if not alike(angle):
        fitting = [(k, name) for k, (name, read) in enumerate(CONVENTIONS.items(), 1) if alike(read(angle))]
        what, confidence, repair = (
            "the course agrees with the direction of travel in no known convention",
            0.95,
            None,
        )
        remedy = "convert the course to rad, counter-clockwise from east"
        if fitting:
            what, confidence = f"course is in {fitting[0][1]}", 0.99
            repair = Repair("velocity", (1.0, float(fitting[0][0])))
        else:
            remedy = f"{remedy}, or leave the column out"
        yield Finding(
            "course-convention", "serious", what, "gps.csv, course", span, confidence, remedy, repair
        )
        return
    delay, share = _delay(evidence, gps.course, speed * (1.0 if usual else ratio))
    if abs(delay) >= MIN_DELAY and share < 0.8:
        way = "lag" if delay > 0 else "lead"
        what = f"speed and course {way} the positions in the same rows by {abs(delay):.2f} s. The default filter does "
        what += "not use speed and course, so this matters only with --use velocity"
        yield Finding("velocity-delay", "note", what, "gps.csv, speed, course", span, 0.95, REMEDY)


def velocity_agrees(evidence: Evidence) -> bool:
    """Return True if the receiver's speed and course agree with the positions in units, convention and time."""
    gps = evidence.drive.gps
    if gps.speed is None or gps.course is None or evidence.course is None or any(check_velocity(evidence)):
        return False
    return abs(_delay(evidence, gps.course, gps.speed[evidence.used])[0]) < MIN_DELAY


def _delay(evidence: Evidence, angle: Array, speed: Array) -> tuple[float, float]:
    """Find the velocity's delay relative to the positions, s, and the ratio of misfits with and without this delay."""
    course = evidence.course
    assert course is not None
    velocity = speed * np.exp(1j * angle[evidence.used])
    delay = np.arange(-1.5, 1.51, 0.05)
    shifted = (smoothed(course.time, velocity, course.time + d, course.span) for d in delay)
    apart = [float(np.mean(np.abs(moved - course.velocity)[course.moving])) for moved in shifted]
    return float(delay[int(np.argmin(apart))]), min(apart) / apart[len(delay) // 2]
