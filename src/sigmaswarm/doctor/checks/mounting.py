"""The mounting of an IMU with six axes: one rotation, and one that changes within the log."""

import math
from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.confidence import confidence_of
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.mounting import SERIOUS, angle_of, moved

WHERE = "imu.csv, ax, ay, az, gx, gy, gz"


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about how the IMU sits in the vehicle."""
    if change := moved(evidence.drive):
        time, angle = change
        yield Finding(
            "mounting-changed", "serious",
            f"the IMU was moved at t = {time:.0f} s: gravity stands {math.degrees(angle):.0f} deg elsewhere after it",
            WHERE, (time, evidence.span[1]), 0.99,
            f"cut the log there: sigmaswarm split DRIVE --at {time:.0f}; each part has its own mounting",
        )  # fmt: skip
    mounting = evidence.mounting
    if mounting is None or not mounting.needed or change:
        return
    roll, pitch, yaw = mounting.degrees
    total, angle = float(np.linalg.norm(mounting.std)), angle_of(mounting.repair)
    yield Finding(
        "mounting", "serious" if angle > SERIOUS else "warning",
        f"the IMU is turned against the vehicle: roll {roll:.1f}, pitch {pitch:.1f}, yaw {yaw:.1f} deg "
        f"(standard deviation {math.degrees(total):.1f} deg in all, {mounting.confidence})",
        WHERE, evidence.span, confidence_of(angle / total),
        f"turn all six axes: import with --mount {roll:g},{pitch:g},{yaw:g}",
        Repair("rotate", tuple(mounting.repair.ravel().tolist())),
    )  # fmt: skip
