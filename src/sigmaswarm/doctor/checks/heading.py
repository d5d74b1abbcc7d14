"""Check stated headings, and headings of two antennas or a compass, against course and gyro."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.checks.mounting import BACKWARD, check_reverse
from sigmaswarm.doctor.checks.velocity import CONVENTIONS
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.fixes import Mask
from sigmaswarm.doctor.windows import integral
from sigmaswarm.drives.alignment import STATED_HEADING_STD, StartFailure, find_start, is_slow
from sigmaswarm.drives.tables import headings_of
from sigmaswarm.geodesy import wrap_angle

# Conventions of a heading; the first is that of a drive
HEADINGS: dict[str, Callable[[Array], Array]] = {
    "rad counter-clockwise from east": np.array,
    **CONVENTIONS,
    "rad clockwise from east": np.negative,
    "deg clockwise from east": lambda angle: -np.radians(angle),
}
MAX_DEVIATION = math.radians(15)  # rad, largest median difference from the course, apart from a constant
# rad, smallest constant difference from the course for a warning and for a serious finding
ROTATION_LIMITS = (math.radians(2), math.radians(10))
MIN_DELAY = 0.15  # s, smallest delay for a warning
MAX_MISFIT_RATIO = 0.8  # largest ratio of the misfit with the delay to the misfit without it
WINDOW = 5.0  # s, over which turns of the heading and of the gyro are compared
MIN_FIXES = 30
WHERE = "gps.csv, heading"

# A stated heading contradicts the course if they differ by more than MIN_STATED_OFFSET rad and STATED_SIGMAS standard
# deviations.
MIN_STATED_OFFSET, STATED_SIGMAS = math.radians(20), 3.0
GYRO_BIAS_STD = math.radians(0.5)  # rad/s, assumed gyro bias from the first IMU sample to the course
# rad, added for slow vehicles: errors of fixes that last for a minute change the course, but its computed standard
# deviation does not include them
SLOW_COURSE_STD = math.radians(20)


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
    if np.count_nonzero(known) >= MIN_FIXES and (delay := _delay(evidence, theta, known, best)):
        way = "lags" if delay > 0 else "leads"
        what = f"the heading {way} the positions in the same rows by {abs(delay):.2f} s"
        remedy = (
            "leave the headings out, or map them with their own times: add a second [[gps]] for the same table to the "
            "recipe, with a shifted t. A filter assumes one time for each row"
        )
        yield Finding("heading-delay", "warning", what, WHERE, evidence.span, 0.95, remedy)


def check_stated_heading(evidence: Evidence) -> Iterator[Finding]:
    """Compare ``heading_deg`` of drive.toml with the course of the first meters."""
    drive, yaw = evidence.drive, evidence.yaw
    if (
        drive.heading is None
        or evidence.moved
        or evidence.mirrored
        or (yaw.column, yaw.factor) != ("gz", 1.0)
    ):
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


def _offset(off: Array) -> tuple[float, float]:
    """Return the median of angles, and the median magnitude of their deviations from it, rad."""
    mean = float(np.angle(np.mean(np.exp(1j * off))))
    mean += float(np.median(wrap_angle(off - mean)))
    return wrap_angle(mean), float(np.median(np.abs(wrap_angle(off - mean))))


def _fitting(offsets: list[tuple[float, float]]) -> int:
    """Return the index of the convention with the smallest constant offset among those that follow the course well."""
    limit = min(MAX_DEVIATION, min(rest for _, rest in offsets) + ROTATION_LIMITS[0])
    fitting = [k for k, (_, rest) in enumerate(offsets) if rest <= limit]
    return min(fitting, key=lambda k: abs(offsets[k][0]), default=0)


def _of_convention(evidence: Evidence, best: int, offset: float, rest: float) -> Iterator[Finding]:
    span = evidence.span
    if rest > MAX_DEVIATION:
        what = "the heading agrees with the direction of travel in no known convention"
        remedy = "convert the heading to rad, counter-clockwise from east, or leave the column out"
        yield Finding("heading-convention", "serious", what, WHERE, span, 0.95, remedy)
        return
    turned = offset if abs(offset) >= ROTATION_LIMITS[0] else 0.0
    repair = Repair("heading", (float(best), turned))
    if best:
        what, remedy = (
            f"heading is in {[*HEADINGS][best]}",
            "convert the heading to rad, counter-clockwise from east",
        )
        yield Finding("heading-convention", "serious", what, WHERE, span, 0.99, remedy, repair)
    elif turned:
        degrees, serious = math.degrees(offset), abs(offset) >= ROTATION_LIMITS[1]
        what = f"heading differs from the course by {degrees:+.1f} deg, as if the antennas were mounted at that angle"
        remedy = f"subtract {math.radians(degrees):.4f} rad, if the car does not drive sideways or in reverse"
        severity = "serious" if serious else "warning"
        yield Finding("heading-offset", severity, what, WHERE, span, 0.95, remedy, repair)


def _delay(evidence: Evidence, theta: Array, known: Mask, best: int) -> float:
    """Estimate the heading's delay relative to the positions, s, with the gyro; 0 if the delay is not significant."""
    course, imu, yaw = evidence.course, evidence.drive.imu, evidence.yaw
    assert course is not None
    if not yaw.known:
        return 0.0
    time, angle = course.time[known], np.unwrap([*HEADINGS.values()][best](theta[known]))
    turned = integral(imu.time, yaw.factor * getattr(imu, yaw.column))
    end = np.searchsorted(time, time + WINDOW)
    begin = np.flatnonzero(end < len(time))
    end = end[begin]

    def misfit(delay: float) -> float:
        seen = np.interp(time - delay, imu.time, turned)
        off = (angle[end] - angle[begin]) - (seen[end] - seen[begin])
        return float(np.mean(np.abs(off - np.median(off)))) if len(off) else 0.0

    tried = np.arange(-1.5, 1.51, 0.05)
    misfits = [misfit(float(delay)) for delay in tried]
    own = evidence.delay if evidence.clock.visible else 0.0
    delay = float(tried[int(np.argmin(misfits))]) - own
    return delay if abs(delay) >= MIN_DELAY and min(misfits) < MAX_MISFIT_RATIO * misfit(own) else 0.0
