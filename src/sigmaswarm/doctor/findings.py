"""The findings of the doctor, with place, confidence, remedy and repair."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from sigmaswarm.drives.checks import Remark

Severity = Literal["note", "warning", "serious"]
# Serious: tuned filters adapt to the fault; warning: tuned filters are less accurate; note: information
SEVERITIES: tuple[Severity, ...] = ("serious", "warning", "note")


@dataclass(frozen=True)
class Repair:
    """The repair of a finding: a key of `sigmaswarm.doctor.repairs.ACTIONS`, and parameters."""

    action: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Finding:
    """One finding of the doctor.

    Attributes
    ----------
    code : str
        A short, stable name for programs, such as "gyro-sign" or "clock-offset"; docs/doctor.md lists them.
    severity : {"note", "warning", "serious"}
    what : str
        The fault in words, with values.
    where : str
        File and columns.
    span : (float, float)
        Start and end on the drive's clock, s.
    confidence : float
        0 to 1.
    remedy : str
    repair : Repair or None
        The repair that ``repair`` applies, if any.
    cut : float or None
        Time at which to cut the log, s; the part after this time does not have the fault.
    """

    code: str
    severity: Severity
    what: str
    where: str
    span: tuple[float, float]
    confidence: float
    remedy: str
    repair: Repair | None = None
    cut: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON."""
        about: dict[str, Any] = {k: v for k, v in vars(self).items() if k not in ("repair", "cut")}
        return about | {"span": list(self.span), "repairable": self.repair is not None}


def finding_of(
    remark: Remark,
    severity: Severity,
    span: tuple[float, float],
    confidence: float,
    repair: Repair | None = None,
) -> Finding:
    where = f"{remark.file}, {remark.columns}"
    return Finding(remark.code, severity, remark.what, where, span, confidence, remark.remedy, repair)


@dataclass(frozen=True)
class Diagnosis:
    """All findings of one drive, the serious ones first.

    Attributes
    ----------
    drive : str
        The drive's name.
    findings : tuple of Finding
    visible_clock_offset : float or None
        Smallest detectable offset between the clocks of IMU and GPS, s; None if no offset is detectable.
    whole : str
        Name of the whole drive, which is repaired instead of this part; "" if the drive is not such a part.
    """

    drive: str
    findings: tuple[Finding, ...]
    visible_clock_offset: float | None = None
    whole: str = ""

    @property
    def serious(self) -> bool:
        """True if a finding is serious."""
        return any(finding.severity == "serious" for finding in self.findings)

    @property
    def codes(self) -> frozenset[str]:
        """The codes of all findings."""
        return frozenset(finding.code for finding in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON."""
        return {
            "drive": self.drive,
            "serious": self.serious,
            "visible_clock_offset_s": self.visible_clock_offset,
            "findings": [finding.to_dict() for finding in self.findings],
        }


_HIGHEST_CONFIDENCE = 0.999  # below 1, since a log may have faults that no check considers


def confidence_of(deviations: float) -> float:
    """Return the confidence, 0 to 1, that a difference of ``deviations`` standard deviations is not zero."""
    return round(min(math.erf(abs(deviations) / math.sqrt(2)), _HIGHEST_CONFIDENCE), 3)


def confidence_by_margin(margin: float) -> float:
    """Return the confidence, 0 to 1, in an interpretation that lowers chi-square by ``margin``."""
    return round(min(1 - math.exp(-max(margin, 0.0) / 2), _HIGHEST_CONFIDENCE), 3)
