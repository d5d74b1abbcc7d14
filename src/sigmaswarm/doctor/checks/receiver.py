"""Compare speed and course of the receiver with its positions, and headings with course and gyro.

Headings are stated in drive.toml, or measured by two antennas or a compass.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.checks.mounting import BACKWARD, check_reverse
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.windows import integral, smoothed
from sigmaswarm.doctor.yaw_fit import FACTOR_TOLERANCE
from sigmaswarm.drives.alignment import STATED_HEADING_STD, StartFailure, find_start, is_slow
from sigmaswarm.drives.tables import Mask, headings_of
from sigmaswarm.geodesy import wrap_angle

UNITS = {"km/h": 1 / 3.6, "knots": 0.514444, "mph": 0.44704, "cm/s": 0.01, "mm/s": 1e-3}
# Conventions of a course other than rad counter-clockwise from east
CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "deg clockwise from north": lambda c: math.pi / 2 - np.radians(c),
    "rad clockwise from north": lambda c: math.pi / 2 - c,
    "deg counter-clockwise from east": np.radians,
}
# Conventions of a heading; the first is that of a drive
HEADINGS: dict[str, Callable[[Array], Array]] = {
    "rad counter-clockwise from east": np.array,
    **CONVENTIONS,
    "rad clockwise from east": np.negative,
    "deg clockwise from east": lambda angle: -np.radians(angle),
}
MAX_DEVIATION = math.radians(
    15
)  # rad, largest median difference from the course; of a heading, apart from a constant
MIN_FIXES = 30
TRIED_DELAYS = np.arange(-1.5, 1.51, 0.05)  # s
MAX_MISFIT_RATIO = 0.8  # largest ratio of the misfit with a delay to the misfit without it
MIN_VELOCITY_DELAY = 0.2  # s, smallest reported delay of speed and course
MIN_HEADING_DELAY = 0.15  # s, smallest reported delay of headings
OWN_TIMES = (
    "map them with their own times: add a second [[gps]] for the same table to the recipe, with a shifted t{}. A "
    "filter assumes one time for each row"
)

# rad, smallest constant difference of a heading from the course for a warning and for a serious finding
ROTATION_LIMITS = (math.radians(2), math.radians(10))
WINDOW = 5.0  # s, over which turns of the heading and of the gyro are compared
HEADING = "gps.csv, heading"

# A stated heading contradicts the course if they differ by more than MIN_STATED_OFFSET rad and STATED_SIGMAS standard
# deviations.
MIN_STATED_OFFSET, STATED_SIGMAS = math.radians(20), 3.0
GYRO_BIAS_STD = math.radians(0.5)  # rad/s, assumed gyro bias from the first IMU sample to the course
# rad, added for slow vehicles: errors of fixes that last for a minute change the course, but its computed standard
# deviation does not include them
SLOW_COURSE_STD = math.radians(20)


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
            repair, remedy = Repair("velocity", (factor, 0.0)), f"multiply speed by {factor:.4g}"
            yield Finding("speed-unit", "serious", what, "gps.csv, speed", span, 0.99, remedy, repair)
    angle, direction = gps.course[evidence.used][seen], course.angle[seen]

    def alike(angle: Array) -> bool:
        return float(np.median(np.abs(wrap_angle(angle - direction)))) <= MAX_DEVIATION

    if not alike(angle):
        fitting = [(k, name) for k, (name, read) in enumerate(CONVENTIONS.items(), 1) if alike(read(angle))]
        what, confidence = "the course agrees with the direction of travel in no known convention", 0.95
        remedy, repair = "convert the course to rad, counter-clockwise from east", None
        if fitting:
            what, confidence = f"course is in {fitting[0][1]}", 0.99
            repair = Repair("velocity", (1.0, float(fitting[0][0])))
        else:
            remedy = f"{remedy}, or omit the column"
        where = "gps.csv, course"
        yield Finding("course-convention", "serious", what, where, span, confidence, remedy, repair)
        return
    delay, share = _velocity_delay(evidence, gps.course, speed * (1.0 if usual else ratio))
    if abs(delay) >= MIN_VELOCITY_DELAY and share < MAX_MISFIT_RATIO:
        way = "lag" if delay > 0 else "lead"
        what = f"speed and course {way} the positions in the same rows by {abs(delay):.2f} s. The default filter does "
        what += "not use speed and course, so this matters only with --use velocity"
        remedy = f"omit speed and course, or {OWN_TIMES.format(', and test this on another drive')}"
        yield Finding("velocity-delay", "note", what, "gps.csv, speed, course", span, 0.95, remedy)


def velocity_agrees(evidence: Evidence) -> bool:
    """Return True if the receiver's speed and course agree with the positions in units, convention and time."""
    gps = evidence.drive.gps
    if gps.speed is None or gps.course is None or evidence.course is None or any(check_velocity(evidence)):
        return False
    return abs(_velocity_delay(evidence, gps.course, gps.speed[evidence.used])[0]) < MIN_VELOCITY_DELAY


def _velocity_delay(evidence: Evidence, angle: Array, speed: Array) -> tuple[float, float]:
    """Find the velocity's delay relative to the positions, s, and the ratio of misfits with and without this delay."""
    course = evidence.course
    assert course is not None
    velocity = speed * np.exp(1j * angle[evidence.used])
    shifted = (smoothed(course.time, velocity, course.time + d, course.span) for d in TRIED_DELAYS)
    apart = [float(np.mean(np.abs(moved - course.velocity)[course.moving])) for moved in shifted]
    return float(TRIED_DELAYS[int(np.argmin(apart))]), min(apart) / apart[len(TRIED_DELAYS) // 2]


def check_heading(evidence: Evidence) -> Iterator[Finding]:
    gps, course = evidence.drive.gps, evidence.course
    if gps.heading is None or course is None:
        return
    known = np.isfinite(headings_of(gps)[1])[evidence.used]
    theta, seen = gps.heading[evidence.used], course.moving & known
    best = 0
    if np.count_nonzero(seen) >= MIN_FIXES:
        offsets = [_offset(read(theta[seen]) - course.angle[seen]) for read in HEADINGS.values()]
        best = _fitting(offsets)
        yield from _of_convention(evidence, best, *offsets[best])
    if np.count_nonzero(known) >= MIN_FIXES and (delay := _heading_delay(evidence, theta, known, best)):
        way = "lags" if delay > 0 else "leads"
        what = f"the heading {way} the positions in the same rows by {abs(delay):.2f} s"
        remedy = f"omit the headings, or {OWN_TIMES.format('')}"
        yield Finding("heading-delay", "warning", what, HEADING, evidence.span, 0.95, remedy)


def _offset(off: Array) -> tuple[float, float]:
    """Return the median of angles, and the median magnitude of their deviations from it, rad."""
    mean = float(np.angle(np.mean(np.exp(1j * off))))
    mean += float(np.median(wrap_angle(off - mean)))
    return wrap_angle(mean), float(np.median(np.abs(wrap_angle(off - mean))))


def _fitting(offsets: list[tuple[float, float]]) -> int:
    """Of the conventions that follow the course well, return the index of that with the smallest constant offset."""
    limit = min(MAX_DEVIATION, min(rest for _, rest in offsets) + ROTATION_LIMITS[0])
    fitting = [k for k, (_, rest) in enumerate(offsets) if rest <= limit]
    return min(fitting, key=lambda k: abs(offsets[k][0]), default=0)


def _of_convention(evidence: Evidence, best: int, offset: float, rest: float) -> Iterator[Finding]:
    span, remedy = evidence.span, "convert the heading to rad, counter-clockwise from east"
    turned = offset if abs(offset) >= ROTATION_LIMITS[0] else 0.0
    repair = Repair("heading", (float(best), turned))
    if rest > MAX_DEVIATION:
        what = "the heading agrees with the direction of travel in no known convention"
        remedy = f"{remedy}, or omit the column"
        yield Finding("heading-convention", "serious", what, HEADING, span, 0.95, remedy)
    elif best:
        what = f"heading is in {[*HEADINGS][best]}"
        yield Finding("heading-convention", "serious", what, HEADING, span, 0.99, remedy, repair)
    elif turned:
        degrees, serious = math.degrees(offset), abs(offset) >= ROTATION_LIMITS[1]
        what = f"heading differs from the course by {degrees:+.1f} deg, as if the antennas were mounted at that angle"
        remedy = f"subtract {math.radians(degrees):.4f} rad, if the car does not drive sideways or in reverse"
        severity = "serious" if serious else "warning"
        yield Finding("heading-offset", severity, what, HEADING, span, 0.95, remedy, repair)


def _heading_delay(evidence: Evidence, theta: Array, known: Mask, best: int) -> float:
    """Estimate the heading's delay relative to the positions, s, with the gyro; 0 if the delay is not significant."""
    course, imu, yaw = evidence.course, evidence.drive.imu, evidence.yaw
    assert course is not None
    if not yaw.known:
        return 0.0
    time, angle = course.time[known], np.unwrap([*HEADINGS.values()][best](theta[known]))
    turned = integral(imu.time, evidence.yaw_rate)
    end = np.searchsorted(time, time + WINDOW)
    begin = np.flatnonzero(end < len(time))
    end = end[begin]

    def misfit(delay: float) -> float:
        seen = np.interp(time - delay, imu.time, turned)
        off = (angle[end] - angle[begin]) - (seen[end] - seen[begin])
        return float(np.mean(np.abs(off - np.median(off)))) if len(off) else 0.0

    misfits = [misfit(float(delay)) for delay in TRIED_DELAYS]
    own = evidence.delay if evidence.clock.visible else 0.0
    delay = float(TRIED_DELAYS[int(np.argmin(misfits))]) - own
    return delay if abs(delay) >= MIN_HEADING_DELAY and min(misfits) < MAX_MISFIT_RATIO * misfit(own) else 0.0


def check_stated_heading(evidence: Evidence) -> Iterator[Finding]:
    """Compare ``heading_deg`` of drive.toml with the course of the first meters."""
    drive, yaw = evidence.drive, evidence.yaw
    wrong_axis = (yaw.column, yaw.factor) != ("gz", 1.0)
    if drive.heading is None or evidence.moved or evidence.mirrored or wrong_axis:
        return
    unstated = {name: value for name, value in drive.metadata.items() if name != "heading_deg"}
    plain = replace(drive, metadata=unstated, gps=replace(drive.gps, heading=None, std_heading=None))
    start, imu = find_start(plain), drive.imu
    if isinstance(start, StartFailure):
        return
    turned = float(np.interp(start.time, imu.time, integral(imu.time, imu.gz)))
    seen = float(wrap_angle(float(start.mean[4]) - turned))
    offset = float(wrap_angle(drive.heading - seen))
    std = math.hypot(
        math.sqrt(start.covariance[4, 4]),
        STATED_HEADING_STD,
        GYRO_BIAS_STD * (start.time - float(imu.time[0])),
        SLOW_COURSE_STD if is_slow(drive) else 0.0,
    )
    if abs(offset) <= max(MIN_STATED_OFFSET, STATED_SIGMAS * std):
        return
    backward = abs(offset) > BACKWARD
    if backward and any(check_reverse(replace(evidence, drive=plain))):
        return
    stated, right = math.degrees(drive.heading), math.degrees(seen) % 360.0
    what = (
        f"heading_deg = {stated:g} differs by {math.degrees(offset):+.0f} deg from the initial heading computed "
        f"from the gyro and the course of the fixes until t = {start.time:.0f} s"
    )
    if abs(wrap_angle(math.pi / 2 - drive.heading - seen)) < max(MIN_STATED_OFFSET, std):
        what += ", as if heading_deg were clockwise from north"
    remedy = (
        f"write heading_deg = {right:.0f} at the top of drive.toml, or import with --heading-from-north "
        f"{(90.0 - right) % 360.0:.0f}"
    )
    if backward:
        remedy = f"keep this heading if the vehicle drives backward at first; otherwise {remedy}"
    span = float(imu.time[0]), start.time
    severity = "warning" if backward else "serious"
    yield Finding("heading-offset", severity, what, "drive.toml, heading_deg", span, 0.99, remedy)
