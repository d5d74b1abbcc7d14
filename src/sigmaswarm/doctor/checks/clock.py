"""Whether IMU and GPS share one clock."""

from collections.abc import Iterator

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair
from sigmaswarm.doctor.sureness import sure_of

LEAST = 0.1
"""s: less does not show behind a receiver's noise."""
GRAVE = 0.3
"""s: more is worth meters."""
CLEAR = (2.5, 3.3, 4.5)
"""Deviations: from the first on a note, from the second on a warning and a repair, from the third on serious."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the clocks' offset."""
    late, std = evidence.clock.late, evidence.clock.std
    if abs(late) < max(LEAST, CLEAR[0] * std):
        return
    clear = abs(late) > CLEAR[1] * std
    severity = "warning" if clear else "note"
    if abs(late) > max(GRAVE, CLEAR[2] * std):
        severity = "serious"
    size, way, move = (
        f"{abs(late):.2f} s",
        "late" if late > 0 else "early",
        "take {} off" if late > 0 else "add {} to",
    )
    yield Finding(
        "clock-offset",
        severity,
        f"the fixes {'are' if clear else 'may be'} {size} {way} against the IMU (deviation {std:.2f} s)",
        "gps.csv, t",
        evidence.span,
        sure_of(late / std),
        move.format(size) + " the fixes' times" + ("" if clear else " if other drives say so too"),
        Repair("shift-fixes", (-late,)) if clear else None,
    )
