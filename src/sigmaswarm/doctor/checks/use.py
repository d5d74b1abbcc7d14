"""Measurements of a log other than positions that a filter can use."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.checks import velocity
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding
from sigmaswarm.drives.sensors import stated_spread, suggest_filter


def check(evidence: Evidence) -> Iterator[Finding]:
    """Report the default filter of `tune` with its reasons, and possible additions."""
    if not evidence.drives:
        return
    drive = evidence.drive
    chosen = suggest_filter([drive])
    reasons = dict.fromkeys(chosen.use, "")  # of every car, unless the log gives a reason
    if drive.odometer is not None:
        reasons["odometer"] = "odometer.csv has the wheels' speed"
    if stated := stated_spread(drive):
        reasons["accuracy"] = f"the stated deviations run from {stated[0]:.2g} to {stated[1]:.2g} m"
    if count := int(np.count_nonzero(evidence.outlying)):
        reasons["robust"] = f"{count} fix{'es lie' if count > 1 else ' lies'} far off the path"
    if chosen.model == "tilted12":
        reasons["model"] = "az, gx and gy are there, which tell hills from motion"
    because = "; ".join(filter(None, reasons.values()))
    may = (
        "; you may add velocity to --use: the receiver gives speed and course"
        if velocity.agrees(evidence)
        else ""
    )
    yield Finding(
        "use", "note", f"tune takes {chosen.options}{f': {because}' if because else ''}{may}",
        "imu.csv, gps.csv", evidence.span, 0.9, "see the options of `sigmaswarm tune`",
    )  # fmt: skip
