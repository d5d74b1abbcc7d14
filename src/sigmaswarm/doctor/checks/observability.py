"""The limits of a drive: quantities that its fixes do not show."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.clock_search import WIDEST
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding
from sigmaswarm.drives.alignment import NoStart, find_start

MORE = "use a drive with turns, starts and stops to check it"
ABOVE_NOISE = 3.0
"""Deviations of the course by which it changes, RMS within windows, where it turns for sure."""
LEAST_TURN = np.radians(5.0)
"""rad: less is the course of a car that sways."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about faults that cannot be detected, by the motion that the fixes show."""
    span = evidence.span
    start = find_start(evidence.drive)
    if isinstance(start, NoStart):
        yield Finding("no-start", "warning", start.what, "gps.csv", span, 0.99, start.remedy)
    if not evidence.drives:
        yield Finding(
            "unseen-motion", "warning",
            "the fixes don't show the car drive: neither heading nor axes, units or clocks can be checked",
            "gps.csv", span, 0.99, "use a longer drive, or one that gets up to speed",
        )  # fmt: skip
        return
    if not evidence.yaw.known:
        yield _unseen_yaw(evidence)
    known = evidence.mount.known if evidence.mount else (False, False)
    for axis, seen, motion in zip(("ax", "ay"), known, ("changes of speed", "cornering"), strict=True):
        if not seen:
            yield Finding(
                f"unseen-{axis}", "note",
                f"the fixes hardly show {motion}: sign, unit and bias of {axis} can't be checked",
                f"imu.csv, {axis}", span, 0.95, MORE,
            )  # fmt: skip


def _unseen_yaw(evidence: Evidence) -> Finding:
    """A gyro that can't be checked: no turn shows, or one shows that no column of the gyro follows."""
    course, fit = evidence.course, evidence.yaw_fit
    assert course is not None
    unchecked = "sign and unit of gz can't be checked, and the gyro's bias and heading errors hardly show"
    place, remedy = "imu.csv, gz", MORE
    moving = course.moving
    interval = float(np.median(np.diff(course.time)))
    shown = (
        f"the course shows for {np.count_nonzero(moving) * interval:.0f} of {np.ptp(course.time):.0f} s, "
        f"where the car is faster than {course.slowest:.1f} m/s"
    )
    if fit is None:
        what = f"{shown}, and nowhere for long enough: {unchecked}"
    elif fit.course_change > max(
        LEAST_TURN, ABOVE_NOISE * course.std / np.median(np.abs(course.velocity[moving]))
    ):
        what = (
            f"the course changes by {np.degrees(fit.course_change):.0f} deg within 20 s, and no column of the gyro "
            f"follows it: {unchecked}"
        )
        remedy = (
            f"look up the gyro's unit, and the clocks, where offsets beyond {WIDEST:.0f} s are not searched"
        )
    else:
        what = (
            f"{shown}, and there it changes by {np.degrees(fit.course_change):.1f} deg within 20 s; "
            f"slower turns don't show: {unchecked}"
        )
    return Finding("unseen-yaw", "warning", what, place, evidence.span, 0.95, remedy)
