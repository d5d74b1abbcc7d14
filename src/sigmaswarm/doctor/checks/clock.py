"""The offset between the clocks of IMU and GPS."""

from collections.abc import Iterator

from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.findings import Finding, Repair, confidence_of
from sigmaswarm.doctor.mounting import LEAST_SHARE, LEAST_TURN
from sigmaswarm.doctor.verdicts import CLEAR_OFFSET

GRAVE = 0.3
"""s: more is worth meters."""


def check(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the clocks' offset, or the smallest one that would be visible."""
    late, std = evidence.clock.late, evidence.clock.std
    if evidence.moved:
        yield Finding(
            "clock-offset", "serious",
            f"the fixes are {abs(late):.1f} s {'late' if late > 0 else 'early'} against the IMU: "
            "only then do the gyro's turns match the course",
            "gps.csv, t", evidence.span, 0.999,
            f"{'take' if late > 0 else 'add'} {abs(late):.2f} s {'off' if late > 0 else 'to'} the fixes' times"
            + ("; GPS time is 18 s ahead of UTC" if abs(abs(late) - 18) < 1 else ""),
            Repair("shift-clock", (-evidence.moved,)),
        )  # fmt: skip
        return
    if abs(late) < evidence.clock.least:
        if evidence.drives:
            yield _unseen(evidence)
        return
    clear = _turns(evidence) and abs(late) > CLEAR_OFFSET[1] * std
    severity = "warning" if clear else "note"
    if clear and abs(late) > max(GRAVE, CLEAR_OFFSET[2] * std):
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
        confidence_of(late / std),
        move.format(size)
        + " the fixes' times"
        + ("" if clear else " if other drives say so too")
        + ", or let the tuning find it anew (--use latency): its figure makes the filter forecast best, this one fits "
        "turns and accelerations best; they may differ by a few deviations",
        Repair("shift-fixes", (-late,)) if clear else None,
    )


def _turns(evidence: Evidence) -> bool:
    """True where turns show the offset: changes of speed alone, as on a motorway, are no evidence for a repair."""
    fit = evidence.yaw_fit
    return fit is not None and fit.course_change > LEAST_TURN and fit.share > LEAST_SHARE


def _unseen(evidence: Evidence) -> Finding:
    visible = evidence.clock.visible
    how = (
        "of any size could hide here"
        if visible is None
        else f"below {visible:.2f} s would not have been seen"
    )
    return Finding(
        "unseen-clock", "note", f"an offset between the clocks of IMU and GPS {how}", "gps.csv, t",
        evidence.span, 0.95,
        "use a drive with turns, starts and stops to see less, or let the tuning find it (--use latency)",
    )  # fmt: skip
