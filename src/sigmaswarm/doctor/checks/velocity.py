"""The receiver's own speed and course against its positions: units, convention, delay."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.verdicts import FAMILIAR
from sigmaswarm.doctor.yaw_fit import smoothed
from sigmaswarm.drives.drive import Array
from sigmaswarm.geodesy import wrap_angle

UNITS = {"km/h": 1 / 3.6, "knots": 0.514444, "mph": 0.44704}
CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "deg clockwise from north": lambda c: math.pi / 2 - np.radians(c),
    "rad clockwise from north": lambda c: math.pi / 2 - c,
    "deg counter-clockwise from east": np.radians,
}
"""Other conventions of a course than rad counter-clockwise from east."""
ALIKE = math.radians(15)
LATE = 0.2
"""s of delay worth a warning."""
FEWEST = 30


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about speed and course."""
    gps, course = evidence.drive.gps, evidence.course
    if gps.speed is None or gps.course is None or course is None:
        return
    told, angle = gps.speed[evidence.used], gps.course[evidence.used]
    seen = course.moving & (told > 0)
    if np.count_nonzero(seen) < FEWEST:
        return
    span = evidence.span
    ratio = float(np.median(np.abs(course.velocity[seen]) / told[seen]))
    for unit, factor in UNITS.items():
        if abs(math.log(ratio / factor)) < 0.07 and not 1 / FAMILIAR < ratio < FAMILIAR:
            yield Finding(
                "speed-unit", "serious", f"speed is in {unit}: the fixes move at {ratio:.2f} times that",
                "gps.csv, speed", span, 0.99, f"multiply speed by {factor:.4g}", Repair("velocity", (factor, 0.0)),
            )  # fmt: skip
    direction = course.angle[seen]
    if _apart(angle[seen], direction) > ALIKE:
        yield from _convention(angle[seen], direction, span)
        return
    yield from _delay(evidence, told * (ratio if not 1 / FAMILIAR < ratio < FAMILIAR else 1.0))


def _apart(angle: Array, direction: Array) -> float:
    return float(np.median(np.abs(wrap_angle(angle - direction))))


def _convention(angle: Array, direction: Array, span: tuple[float, float]) -> Iterator[Finding]:
    for index, (name, read) in enumerate(CONVENTIONS.items(), start=1):
        if _apart(read(angle), direction) < ALIKE:
            yield Finding(
                "course-convention", "serious", f"course is in {name}", "gps.csv, course", span, 0.99,
                "give rad, counter-clockwise from east", Repair("velocity", (1.0, float(index))),
            )  # fmt: skip
            return
    yield Finding(
        "course-convention", "serious", "course does not follow the positions in any known convention",
        "gps.csv, course", span, 0.95, "give rad, counter-clockwise from east, or leave the column out",
    )  # fmt: skip


def agrees(evidence: Evidence) -> bool:
    """Whether the receiver gives a speed and course that fit the positions beside them best, so that both are used."""
    gps = evidence.drive.gps
    if gps.speed is None or gps.course is None or evidence.course is None or any(check(evidence)):
        return False
    late, _ = _delay_of(evidence, gps.speed[evidence.used])
    return abs(late) < LATE


def _delay(evidence: Evidence, speed: Array) -> Iterator[Finding]:
    """A delay of speed and course against the positions of the same rows."""
    best, share = _delay_of(evidence, speed)
    if abs(best) >= LATE and share < 0.8:
        way = "later" if best > 0 else "earlier"
        yield Finding(
            "velocity-delay", "warning", f"speed and course are {abs(best):.2f} s {way} than the positions beside them",
            "gps.csv, speed, course", evidence.span, 0.95,
            "a filter takes them as of one moment: leave speed and course out, or give them a time of their own (in a "
            "recipe a second [[gps]] of the same table, its t moved), and see on another drive what they are worth",
        )  # fmt: skip


def _delay_of(evidence: Evidence, speed: Array) -> tuple[float, float]:
    """The delay, s, that fits best, and the misfit with it over that without."""
    gps, course = evidence.drive.gps, evidence.course
    assert gps.course is not None
    assert course is not None
    velocity = speed * np.exp(1j * gps.course[evidence.used])
    late = np.arange(-1.5, 1.51, 0.05)
    apart = [
        float(np.mean(np.abs(told - course.velocity)[course.moving]))
        for told in (smoothed(course.time, velocity, course.time + d, course.span) for d in late)
    ]
    return float(late[int(np.argmin(apart))]), min(apart) / apart[len(late) // 2]
