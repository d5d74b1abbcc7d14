"""The gyro: column, sign, unit, scale and bias of the yaw rate."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.acceleration_fit import drift_of
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_of
from sigmaswarm.doctor.verdicts import DEGREE
from sigmaswarm.drives.checks import IMPOSSIBLE_RATE, impossible_rate

WRONG = 0.1
"""Deviation of a gain from 1 that is worth a warning."""
LEAST_TURN = np.radians(1.0)
"""rad within some seconds; less is the course of a car that sways, not turns."""
BIAS = (np.radians(0.1), np.radians(1.0))
"""rad/s: from the first on a bias is worth a note, from the second on a warning."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the gyro."""
    yaw, yaw_fit = evidence.yaw, evidence.yaw_fit
    if yaw_fit is None or not yaw.known:
        yield from _by_size(evidence)
        return
    where, span, confidence = (
        f"imu.csv, {yaw.column}",
        evidence.span,
        confidence_of(yaw_fit.gain / yaw_fit.std / 6 * 3),
    )
    seen = f"course = {yaw_fit.gain:.3g} x integral of {yaw.column}, deviation {yaw_fit.std:.2g}"
    if yaw.column != "gz":
        remedy = f"exchange columns {yaw.column} and gz"
        what = f"column {yaw.column}, not gz, turns as the car does ({seen})"
        index = float("xyz".index(yaw.column[1]))
        yield Finding(
            "gyro-axis", "serious", what, where, span, confidence, remedy, Repair("gyro", (index, 1.0))
        )
    if abs(yaw.factor) != 1:
        what = f"the angular rates are in deg/s ({seen})"
        remedy = "multiply gx, gy, gz by pi/180"
        yield Finding(
            "gyro-unit", "serious", what, where, span, confidence, remedy, Repair("gyro", (2.0, DEGREE))
        )
    if yaw.factor < 0:
        what = f"the yaw rate has the wrong sign: it must be positive in a left turn ({seen})"
        remedy = "change the sign of gz"
        yield Finding(
            "gyro-sign", "serious", what, where, span, confidence, remedy, Repair("gyro", (2.0, -1.0))
        )
    off = yaw_fit.gain / yaw.factor - 1
    turns = yaw_fit.course_change > LEAST_TURN
    if turns and abs(off) > WRONG and abs(off) > 4 * yaw_fit.std / abs(yaw.factor):
        what = f"the car turns {1 + off:.2f} times as far as the gyro says"
        yield Finding(
            "gyro-scale", "warning", what, where, span, confidence_of(4), "check the gyro's range setting"
        )
    yield from _bias(evidence)


def _by_size(evidence: Evidence) -> Iterator[Finding]:
    """Without a usable course, find rates that no car can have."""
    gz = evidence.drive.imu.gz
    if impossible_rate(gz - np.median(gz)):
        what = (
            f"the yaw rate gz is above {IMPOSSIBLE_RATE:g} rad/s, as if in deg/s; the course does not show it"
        )
        yield Finding(
            "gyro-unit", "warning", what, "imu.csv, gz", evidence.span, 0.9,
            "look up the unit; multiply gx, gy, gz by pi/180 if it is deg/s",
        )  # fmt: skip


def _bias(evidence: Evidence) -> Iterator[Finding]:
    imu, yaw = evidence.drive.imu, evidence.yaw
    assert evidence.course is not None
    bias = -drift_of(imu.time, evidence.course, yaw.factor * getattr(imu, yaw.column), evidence.clock.late)
    if abs(bias) > BIAS[0]:
        what = f"the gyro's bias is about {np.degrees(bias):.2f} deg/s"
        yield Finding(
            "gyro-bias", "warning" if abs(bias) > BIAS[1] else "note", what, f"imu.csv, {yaw.column}",
            evidence.span, 0.95, "use a filter that estimates it: --model planar8",
        )  # fmt: skip
