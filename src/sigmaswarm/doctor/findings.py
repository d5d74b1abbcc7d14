"""The findings of the doctor, with place, confidence, remedy and repair."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from sigmaswarm.drives.checks import Remark

Severity = Literal["note", "warning", "serious"]
# Serious: tuned filters adapt to the fault; warning: tuned filters are less accurate; note: information
SEVERITIES: tuple[Severity, ...] = ("serious", "warning", "note")

NO_ACTION = "no action is needed"
_WRONG_TIME = "a filter compares each fix with its estimate at another time; at 20 m/s, 0.1 s are 2 m"
_WRONG_AXES = (
    "a filter mistakes gravity and turns for other motion, so heading and position drift between fixes"
)
_WRONG_HEADING = "a filter starts with a wrong heading, or follows a wrong heading with --use heading"
CONSEQUENCES = {
    "accelerometer-axes": _WRONG_AXES,
    "accelerometer-scale": "the filter's speed and position drift when the car accelerates or turns",
    "accelerometer-sign": "a filter's speed and position drift in the wrong direction between fixes",
    "accelerometer-unit": "a filter receives a tenth of the acceleration, so its position drifts between fixes",
    "accelerometer-up": "tune chooses a filter without roll and pitch, which is less accurate on hills",
    "clock-drift": "the offset between the clocks grows along the drive, so the error of the filter also grows",
    "clock-jump": "after the jump a filter predicts motion for time that did not pass",
    "clock-offset": _WRONG_TIME,
    "course-convention": "a filter with --use velocity follows a wrong velocity",
    "gps-disturbed": "the filter is less accurate during this time",
    "gps-noise": "without truth, tune takes the accuracy of the fixes from the stated value",
    "gps-outliers": "these fixes pull a filter away from the path",
    "gps-outside": "these fixes improve neither the tuning nor an evaluation",
    "gps-repeats": "the position of such a fix is older than its time stamp",
    "gravity": "a filter mistakes the offsets for acceleration, so its position drifts between fixes",
    "gravity-axis": "a filter mistakes gravity for acceleration, so its position is wrong within seconds",
    "gravity-size": "a filter with roll and pitch is less accurate",
    "gyro-axis": "a filter does not follow the turns of the car",
    "gyro-bias": "the heading drifts until the filter has estimated the bias",
    "gyro-scale": "a filter's heading is wrong after each turn",
    "gyro-sign": "a filter turns left where the car turns right",
    "gyro-tilt": "a filter with roll and pitch has wrong angles, so it mistakes gravity for acceleration",
    "gyro-unit": "a filter's turns are 57 times those of the car",
    "heading-convention": _WRONG_HEADING,
    "heading-delay": "in turns, a filter with --use heading follows a wrong heading",
    "heading-offset": _WRONG_HEADING,
    "imu-gap": "a filter does not know the motion within a gap, so its error grows there",
    "imu-rate": "a filter misses motion between the samples",
    "imu-repeats": "the noise appears correlated, so the tuned noise is wrong",
    "mirrored-fixes": "a filter turns left where the fixes turn right",
    "mounting": _WRONG_AXES,
    "mounting-changed": "no filter suits both parts of the drive",
    "mounting-handled": "a filter mistakes this motion for motion of the vehicle",
    "mounting-slips": "one rotation does not describe the whole drive",
    "no-start": "no filter can be tuned or evaluated on this drive",
    "odometer-clock": "when the speed changes, a filter with --use odometer follows a wrong speed",
    "odometer-scale": "between fixes, a filter with --use odometer drives too far or not far enough",
    "odometer-sign": "a filter with --use odometer drives backward",
    "odometer-slip": "a filter with --use odometer follows a wrong speed during this time",
    "odometer-stuck": "a filter with --use odometer follows a wrong speed during this time",
    "odometer-unit": "a filter with --use odometer follows a wrong speed",
    "reverse-start": "a filter starts with a heading that is wrong by 180 deg",
    "speed-unit": "a filter with --use velocity follows a wrong speed",
    "time-jump": "a filter predicts the motion for more than an hour for which there are no IMU samples, or no fixes",
    "time-unit": "the time steps of a filter are wrong by this factor",
    "truth-clock": "errors relative to this truth, and filters that are tuned with it, are wrong",
    "unseen-motion": "a fault of axes, units or clocks, which would make the filter useless, cannot be seen",
    "unseen-yaw": "a wrong sign or unit, which would make the filter useless, cannot be seen",
}
"""Consequences of faults, by the code of the finding. Codes that are always notes have no consequence."""


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
        The fault in words, with values. The first sentence states the fault; further sentences give the evidence.
    where : str
        File and columns.
    span : (float, float)
        Start and end on the drive's clock, s.
    confidence : float
        Confidence in the fault, 0 to 1.
    remedy : str
        The first sentence states the remedy; further sentences give alternatives and details.
    repair : Repair or None
        The repair that ``repair`` applies, if any.
    cut : float or None
        Time at which to split the log, s. The part after this time does not have the fault.
    command : str
        Command in ``remedy`` with the placeholders DRIVE and parts, or "".
    needs_action : bool
        False if ``remedy`` states that no action is needed.
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
    command: str = ""
    needs_action: bool = True

    @property
    def consequence(self) -> str:
        """The consequence for a filter; empty for notes."""
        return "" if self.severity == "note" else CONSEQUENCES.get(self.code, "")

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON."""
        left_out = ("repair", "cut", "command", "needs_action")
        about: dict[str, Any] = {k: v for k, v in vars(self).items() if k not in left_out}
        about |= {"consequence": self.consequence, "repairable": self.repair is not None}
        return about | {"span": list(self.span)}


def split_command(*times: float) -> str:
    """Return the command that splits a drive at one time (s), or leaves out the part between two times."""
    return f"sigmaswarm split DRIVE --at {' '.join(f'{time:.0f}' for time in times)} --out parts"


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
