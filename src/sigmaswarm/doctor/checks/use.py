"""What a filter can take from this log beside the fixes' positions."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.checks import velocity
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding

VARIES = 1.5
"""95% quantile of the stated deviations over the 5% quantile, from which on they tell good fixes from bad ones."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """The options of ``--use`` that the log speaks for, each with its reason."""
    if not evidence.drives:
        return
    gps = evidence.drive.gps
    reasons = {"lateral": "", "standstill": ""}  # of every car
    if gps.std_x is not None and gps.std_y is not None:
        low, high = np.quantile(np.concatenate([gps.std_x, gps.std_y]), [0.05, 0.95])
        if high > VARIES * low:
            reasons["accuracy"] = f"the stated deviations run from {low:.2g} to {high:.2g} m"
    if gps.speed is not None and gps.course is not None and not any(velocity.check(evidence)):
        reasons["velocity"] = "the receiver gives speed and course"
    if count := int(np.count_nonzero(evidence.outlying)):
        reasons["robust"] = f"{count} fix{'es lie' if count > 1 else ' lies'} far off the path"
    because = "; ".join(filter(None, reasons.values()))
    yield Finding(
        "use", "note",
        f"tune with --use {' '.join(reasons)}" + (f": {because}" if because else ""),
        "imu.csv, gps.csv", evidence.span, 0.9, "see the options of `sigmaswarm tune`",
    )  # fmt: skip
