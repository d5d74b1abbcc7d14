"""What a filter can take from this log beside the fixes' positions."""

from collections.abc import Iterator

import numpy as np

from sigmaswarm.doctor.checks import velocity
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding
from sigmaswarm.drives.drive import Drive

VARIES = 1.5
"""95% quantile of the stated deviations over the 5% quantile, from which on they tell good fixes from bad ones."""


def suited(drive: Drive) -> tuple[str, ...]:
    """The options of ``--use`` that suit a log by what it states; `check` also looks whether it is sound."""
    wheels = ("odometer",) if drive.odometer is not None else ()
    return ("lateral", "standstill", *wheels, *(("accuracy",) if _spread(drive) else ()), "robust")


def check(evidence: Evidence) -> Iterator[Finding]:
    """The options of ``--use`` that the log speaks for, each with its reason."""
    if not evidence.drives:
        return
    drive = evidence.drive
    reasons = dict.fromkeys(suited(drive), "")  # of every car, unless the log gives a reason
    if drive.odometer is not None:
        reasons["odometer"] = "odometer.csv has the wheels' speed"
    if stated := _spread(drive):
        reasons["accuracy"] = f"the stated deviations run from {stated[0]:.2g} to {stated[1]:.2g} m"
    if count := int(np.count_nonzero(evidence.outlying)):
        reasons["robust"] = f"{count} fix{'es lie' if count > 1 else ' lies'} far off the path"
    if drive.gps.speed is not None and drive.gps.course is not None and not any(velocity.check(evidence)):
        reasons["velocity"] = "the receiver gives speed and course"
    because = "; ".join(filter(None, reasons.values()))
    tilts = all(getattr(drive.imu, axis) is not None for axis in ("az", "gx", "gy"))
    yield Finding(
        "use", "note",
        f"tune with --use {' '.join(reasons)}" + (f": {because}" if because else "")
        + (", and with --model tilted12 where roads are not flat: az, gx and gy are there" if tilts else ""),
        "imu.csv, gps.csv", evidence.span, 0.9, "see the options of `sigmaswarm tune`",
    )  # fmt: skip


def _spread(drive: Drive) -> tuple[float, float] | None:
    """Quantiles of the stated deviations, 5% and 95%, where they tell good fixes from bad ones."""
    gps = drive.gps
    if gps.std_x is None or gps.std_y is None:
        return None
    low, high = np.quantile(np.concatenate([gps.std_x, gps.std_y]), [0.05, 0.95])
    return (float(low), float(high)) if high > VARIES * low else None
