"""Report quantities that can't be estimated from the fixes, and measurements that a filter can use."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.checks.receiver import check_heading, velocity_agrees
from sigmaswarm.doctor.clocks import MAX_OFFSET
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding
from sigmaswarm.drives.alignment import REPAIR_FINDINGS, StartFailure, find_start
from sigmaswarm.drives.sensors import (
    FIXES_FOR_FIX_ERROR,
    LASTING_ERRORS,
    has_lasting_errors,
    stated_std_quantiles,
)
from sigmaswarm.drives.split import part_of
from sigmaswarm.wording import count_of

CIRCLE = 2 * np.pi  # rad, smallest range of the course of a car that drives in circles
REMEDY = "use a drive with turns, starts and stops to check for these faults"
# RMS change of the course within windows, in standard deviations, above which the car turns
MIN_TURN_SIGMAS = 3.0
# Assumed error of the velocity due to errors of the fixes that last for seconds: ratio to the scatter of the fixes
# (1/s), and largest value (m/s)
WANDER_RATE, MAX_WANDER = 2.5, 0.25
MIN_DETERMINED_TURN = np.radians(5.0)  # rad, RMS change of the course within windows; swaying causes less


def check_observability(evidence: Evidence) -> Iterator[Finding]:
    span = evidence.span
    start = find_start(evidence.drive)
    if isinstance(start, StartFailure):
        remedy = start.remedy.replace(REPAIR_FINDINGS, "repair the faults of the other findings")
        yield Finding("no-start", "warning", start.what, "gps.csv", span, 0.99, remedy)
    if not evidence.drives:
        shown = "there are too few fixes"
        if evidence.course:
            shown = f"the fixes show no motion above {evidence.course.slowest:.1f} m/s"
        what = f"{shown}, so heading, axes, units and clocks can't be checked"
        remedy = "use a longer or faster drive"
        yield Finding("unseen-motion", "warning", what, "gps.csv", span, 0.99, remedy)
        return
    if not evidence.yaw.known:
        what, remedy = _unseen_yaw(evidence)
        what = f"sign and unit of gz can't be checked. {what}. Errors of heading and gyro bias are hardly visible"
        yield Finding("unseen-yaw", "warning", what, "imu.csv, gz", span, 0.95, remedy)
    known = evidence.mount.known if evidence.mount else (False, False)
    for axis, seen, motion in zip(("ax", "ay"), known, ("changes of speed", "cornering"), strict=True):
        if not seen:
            what = f"the fixes hardly show {motion}, so sign, unit and bias of {axis} can't be checked"
            yield Finding(f"unseen-{axis}", "note", what, f"imu.csv, {axis}", span, 0.95, REMEDY)


def _unseen_yaw(evidence: Evidence) -> tuple[str, str]:
    """Return the reason why the gyro can't be checked with the course, and the remedy."""
    course, fit = evidence.course, evidence.yaw_fit
    assert course is not None
    moving = course.moving
    interval = course.interval
    shown = (
        f"The course is known only while the car is faster than {course.slowest:.1f} m/s: "
        f"during {np.count_nonzero(moving) * interval:.0f} of {np.ptp(course.time):.0f} s"
    )
    if fit is None:
        return f"{shown}. No part is long enough to compare the course with the gyro", REMEDY
    change = np.degrees(fit.course_change)
    wander = max(course.std, min(MAX_WANDER, WANDER_RATE * evidence.scatter))
    explained = MIN_TURN_SIGMAS * wander / float(np.median(np.abs(course.velocity[moving])))
    if fit.course_change > max(MIN_DETERMINED_TURN, explained):
        return (
            f"The RMS change of the course within 20 s is {change:.0f} deg, but no column of the gyro follows it",
            f"check the gyro's unit and the clocks. The doctor finds only clock offsets up to {MAX_OFFSET:.0f} s",
        )
    if fit.course_change > MIN_DETERMINED_TURN:
        what = f"The RMS change of the course within 20 s is {change:.0f} deg"
        return f"{what}. At this speed, errors of the fixes may cause this change", REMEDY
    if np.ptp(course.angle[moving]) > CIRCLE:
        steady = (
            "The car turns at a nearly constant rate, which does not separate the gyro's scale from its bias"
        )
        return f"{shown}. {steady}", REMEDY
    turns = f"In this time, the RMS change of the course within 20 s is {change:.1f} deg"
    return f"{shown}. {turns}. Slower turns can't be distinguished from a gyro bias", REMEDY


def check_use(evidence: Evidence) -> Iterator[Finding]:
    """Report the default filter of `tune`, the reasons for this choice, and possible additions."""
    drive = evidence.drive
    if not evidence.drives or part_of(drive) == "test":
        return
    chosen = evidence.suggestion
    reasons = dict.fromkeys(chosen.use, "")  # "": the default for cars, without a reason in the log
    if drive.odometer is not None:
        reasons["odometer"] = "odometer.csv contains the wheel speed"
    if stated := stated_std_quantiles(drive):
        reasons["accuracy"] = (
            f"the receiver's standard deviations range from {stated[0]:.2g} to {stated[1]:.2g} m"
        )
    if count := int(np.count_nonzero(evidence.outlying)):
        reasons["robust"] = f"{count_of(count, 'fix')} {'lie' if count > 1 else 'lies'} far from the path"
    if chosen.model == "tilted12":
        reasons["model"] = "the IMU has az, gx and gy, which distinguish slopes from acceleration"
    because = ", and ".join(filter(None, reasons.values()))
    may = {"velocity": "speed and course of the receiver"} if velocity_agrees(evidence) else {}
    if drive.gps.heading is not None and not any(check_heading(evidence)):
        may["heading"] = "of the fixes"
    use = chosen.use
    what = f"tune uses {chosen.options}{f', since {because}' if because else ''}"
    # A tuning may use several drives, or a part of this one, so the message contains the required number of fixes.
    if (drive.truth is None or chosen.model == "tilted12") and has_lasting_errors(drive):
        what += f". With {FIXES_FOR_FIX_ERROR} or more training fixes, tune also uses fix-error"
        enough = len(drive.gps) >= FIXES_FOR_FIX_ERROR
        what += f", since {LASTING_ERRORS}" if enough else ""
        use += ("fix-error",) * enough
    if may:
        added = " and ".join(f"{name} ({meaning})" for name, meaning in may.items())
        what += f". To add {added}, write --use {' '.join((*use, *may))}"
    remedy = "see the options of `sigmaswarm tune`"
    yield Finding("use", "note", what, "imu.csv, gps.csv", evidence.span, 0.9, remedy)
