"""The mounting of an IMU with six axes: one rotation, and one that changes within the log."""

import math
from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_of
from sigmaswarm.doctor.mounting import SERIOUS, angle_of
from sigmaswarm.drives.drive import Array, Drive

MOVED = math.radians(15.0)
STANDS_OUT = 6.0
"""rad, and deviations of the medians: how far gravity must jump where the IMU was moved within a log."""
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


def moved(drive: Drive) -> tuple[float, float] | None:
    """The time, s, at which the IMU was moved within a log, and by how much gravity turned, rad; None where it was not.

    Directions of the specific force over 5 s each are cut in two at the time that leaves the least spread about the
    two medians.
    """
    imu = drive.imu
    if imu.az is None:
        return None
    edges = np.arange(imu.time[0], imu.time[-1], 5.0)
    rows = np.searchsorted(imu.time, edges)
    force = np.array([np.append(0.0, np.cumsum(v)) for v in (imu.ax, imu.ay, imu.az)])
    counts = np.diff(rows)
    mean = (np.diff(force[:, rows], axis=1) / np.maximum(counts, 1))[:, counts > 0].T
    direction = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    least = 4  # windows on each side: 20 s
    if len(direction) < 2 * least:
        return None

    def spread(part: Array) -> float:
        return float(np.abs(part - np.median(part, axis=0)).sum())

    cuts = range(least, len(direction) - least + 1)
    cut = min(cuts, key=lambda k: spread(direction[:k]) + spread(direction[k:]))
    before, after = (np.median(part, axis=0) for part in (direction[:cut], direction[cut:]))
    angle = float(np.arccos(np.clip(before @ after / np.linalg.norm(before) / np.linalg.norm(after), -1, 1)))
    spreads = [
        float(np.median(np.linalg.norm(part - middle, axis=1))) / math.sqrt(len(part))
        for part, middle in ((direction[:cut], before), (direction[cut:], after))
    ]
    at = float(edges[:-1][counts > 0][cut])
    return (at, angle) if angle > max(MOVED, STANDS_OUT * max(spreads)) else None
