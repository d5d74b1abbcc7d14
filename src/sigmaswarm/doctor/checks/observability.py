"""What this drive can't show, so that nobody takes silence for health."""

import math
from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding

MORE = "use a drive with turns, starts and stops to check it"
CLOCK_STD = 0.1
"""s."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about what can't be found."""
    span, turning = evidence.span, evidence.turning
    if evidence.course is None or not evidence.course.moving.any():
        yield Finding(
            "unseen-motion", "warning",
            "the car hardly drives: neither heading nor axes, units or clocks can be checked",
            "gps.csv", span, 0.99, "use a longer drive, or one that gets up to speed",
        )  # fmt: skip
        return
    if not evidence.yaw.known:
        turned = (
            f"by {np.degrees(turning.course_change):.1f} deg within 20 s" if turning else "too short a time"
        )
        yield Finding(
            "unseen-yaw", "warning",
            f"the car hardly turns{turned}: sign and unit of gz can't be checked, "
            "and the gyro's bias and heading errors hardly show",
            "imu.csv, gz", span, 0.95, MORE,
        )  # fmt: skip
    known = evidence.mount.known if evidence.mount else (False, False)
    for axis, seen, how in zip(("ax", "ay"), known, ("changes speed", "corners"), strict=True):
        if not seen:
            yield Finding(
                f"unseen-{axis}", "note", f"the car hardly {how}: sign, unit and bias of {axis} can't be checked",
                f"imu.csv, {axis}", span, 0.95, MORE,
            )  # fmt: skip
    if evidence.clock.std > CLOCK_STD:
        how = (
            f"to better than {3 * evidence.clock.std:.1f} s"
            if math.isfinite(evidence.clock.std)
            else "at all"
        )
        what = f"an offset between the clocks of IMU and GPS can't be seen {how}"
        yield Finding("unseen-clock", "note", what, "gps.csv, t", span, 0.95, MORE)
