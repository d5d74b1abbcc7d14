"""The receiver's stated deviation against the fixes' scatter, errors that last, and outliers."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.acceleration_fit import LEAST_NOISE
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_of
from sigmaswarm.drives.sensors import motion_in_noise, stated_std

TOO_SMALL = 2.0
"""Observed noise over the stated one."""
TOO_LARGE = 6.5
"""Stated over observed, where the noise is white; a receiver's slow errors do not show, so that much is usual."""
LASTS = 2.5
"""The stated deviation over the scatter about a path of ten seconds, from which on most of the error outlasts these."""
FAR_FIRST = 1000.0
"""m from the first fix to the next sound one: such a first fix, as the origin, displaces the whole drive."""
WHITE = 0.7
"""Noise from fix to fix over the scatter about a path of ten seconds: 1 for white noise."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the fixes' noise."""
    yield from _stated(evidence)
    yield from _outliers(evidence)


def _stated(evidence: Evidence) -> Iterator[Finding]:
    gps, told = evidence.drive.gps, stated_std(evidence.drive)
    if told is None:
        return
    stated = float(np.mean(told))
    where = "drive.toml, gps_std_m" if gps.std_x is None else "gps.csv, std_x, std_y"
    noise, scatter = evidence.noise, max(evidence.scatter, evidence.noise)
    if not scatter:
        return
    unseen = motion_in_noise(float(np.median(np.diff(gps.time))))
    # A smoothing receiver's errors last: its stated accuracy may be right although the fixes scatter little.
    white = noise > WHITE * scatter and scatter > LEAST_NOISE
    if noise - unseen > TOO_SMALL * stated:
        how = "smaller than"
        confidence = confidence_of(3 + noise / stated / TOO_SMALL)
    elif white and stated > TOO_LARGE * scatter:
        how = "larger than"
        confidence = confidence_of(2 * stated / TOO_LARGE / scatter)
    else:
        if stated > LASTS * max(scatter, LEAST_NOISE):
            yield _lasting(evidence, stated, scatter, where)
        return
    factor = max(stated / scatter, scatter / stated)
    yield Finding(
        "gps-noise",
        "warning",
        f"the stated deviation, {stated:.2g} m, is {factor:.0f} times {how} the fixes' scatter, "
        f"{scatter:.2g} m per axis",
        where,
        evidence.span,
        confidence,
        f"state {scatter:.2g} m, or more where slow errors are known, which a log without truth does not show",
        Repair("state-noise", (scatter,)),
    )


def _lasting(evidence: Evidence, stated: float, scatter: float, where: str) -> Finding:
    return Finding(
        "gps-correlated",
        "note",
        f"the fixes scatter by {scatter:.2g} m per axis about a path of ten seconds, and the receiver states "
        f"{stated:.2g} m: their errors last, so that many fixes tell hardly more than one, and a filter without truth "
        "can't know how far off it is",
        where,
        evidence.span,
        confidence_of(stated / scatter),
        "take what a filter says of its own position for the scatter alone",
    )


def _outliers(evidence: Evidence) -> Iterator[Finding]:
    time = evidence.drive.gps.time[evidence.outlying]
    if not len(time):
        return
    first = ", ".join(f"{t:.1f}" for t in time[:4]) + (" ..." if len(time) > 4 else "")
    share = 100 * len(time) / len(evidence.drive.gps)
    far = evidence.outlying[0] and _first_jump(evidence) > FAR_FIRST
    yield Finding(
        "gps-outliers",
        "serious" if far else "warning",
        f"{len(time)} fix{'es' if len(time) > 1 else ''} ({share:.1f}%) far off the path, at t = {first} s"
        + (f"; the first fix lies {_first_jump(evidence) / 1e3:.3g} km from the others" if far else ""),
        "gps.csv, positions",
        (float(time[0]), float(time[-1])),
        0.99,
        "leave them out, or let the filter do it: --use robust",
        Repair("drop-fixes", tuple(time.tolist())),
    )


def _first_jump(evidence: Evidence) -> float:
    """Distance from the first fix to the next one that is used, m."""
    gps, then = evidence.drive.gps, int(evidence.used[0])
    return float(np.hypot(gps.x[then] - gps.x[0], gps.y[then] - gps.y[0]))
