"""Diagnose one drive with all checks."""

from dataclasses import replace

from sigmaswarm.doctor.checks import (
    accelerometer,
    gyro,
    mounting,
    noise,
    observability,
    odometer,
    receiver,
    timing,
)
from sigmaswarm.doctor.checks.mounting import OR_BACKWARD
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.doctor.findings import NO_ACTION, SEVERITIES, Diagnosis, Finding, finding_of
from sigmaswarm.doctor.repairs import AXIS_ACTIONS, VERIFIED_ACTIONS, leave_different_axes
from sigmaswarm.drives.checks import invalid_times, shortage_of
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.split import name_of_whole
from sigmaswarm.errors import DriveError
from sigmaswarm.wording import printable

# Findings of equal severity have the order of these checks
CHECKS = (
    mounting.check_mirrored,
    mounting.check_reverse,
    mounting.check_mounting,
    mounting.check_handled,
    gyro.check_gyro,
    accelerometer.check_accelerometer,
    gyro.check_tilt,
    timing.check_clock,
    timing.check_truth,
    receiver.check_velocity,
    receiver.check_heading,
    receiver.check_stated_heading,
    odometer.check_odometer,
    noise.check_noise,
    timing.check_sampling,
    observability.check_observability,
    observability.check_use,
)
CACHE_SIZE = 32  # number of cached diagnoses; commands and pages need a diagnosis several times
_cache: dict[tuple[str, str], Diagnosis] = {}


def diagnose(drive: Drive) -> Diagnosis:
    """Find the faults in a drive. The truth is used only to check its clock, and the delay and errors of the fixes.

    Parameters
    ----------
    drive : Drive
        The drive, which is not changed.

    Returns
    -------
    Diagnosis
        The findings, the serious ones first.

    Raises
    ------
    DriveError
        If the drive is too short, or IMU and GPS do not overlap.
    """
    if shortage := shortage_of(drive.imu, drive.gps):
        raise DriveError(f"{drive.name}/{shortage}")
    about = repr(sorted(drive.metadata.items()))  # drive.toml may contain the noise of the fixes
    key = drive.name, fingerprint(drive) + about
    found = _cache.get(key) or _diagnosed(drive)
    for old in list(_cache)[: max(len(_cache) + 1 - CACHE_SIZE, 0)]:
        _cache.pop(old, None)
    return _cache.setdefault(key, found)


def _diagnosed(drive: Drive) -> Diagnosis:
    if spoiled := invalid_times(drive.imu, drive.gps):  # such a log allows no other check
        ends = float(drive.imu.time[0]), float(drive.imu.time[-1])
        return Diagnosis(drive.name, tuple(finding_of(wrong, "serious", ends, 0.999) for wrong in spoiled))
    evidence = gather(drive)
    found = [finding for check in CHECKS for finding in check(evidence)]
    codes = {finding.code for finding in found}
    if codes & {"mounting-changed", "reverse-start"}:  # the parts have, or seem to have, different axes
        found = [f for f in found if f.repair is None or f.repair.action not in AXIS_ACTIONS]
    if "reverse-start" in codes:  # it explains this change of the axes
        found = [f for f in found if f.code != "mounting-changed" or OR_BACKWARD not in f.what]
    of_axes = {f: f.repair for f in found if f.repair and f.repair.action in AXIS_ACTIONS}
    if leave_different_axes(drive, [*of_axes.values()]):
        found = [_of_one_sensor(f) if f in of_axes else _after_the_axes(f) for f in found]
    withheld = drive.metadata.get("withheld", ())
    found = [_contradicted(finding) if finding.code in withheld else finding for finding in found]
    found.sort(key=lambda finding: SEVERITIES.index(finding.severity))
    if whole := name_of_whole(drive):
        found = [_of_part(finding, whole) if finding.repair else finding for finding in found]
    return Diagnosis(drive.name, tuple(found), evidence.clock.visible, whole)


def _contradicted(finding: Finding) -> Finding:
    """Convert a finding whose repair made predictions worse to a finding without repair, at most a warning."""
    remedy = (
        f"{NO_ACTION}: the repair was tried, but with it a filter predicts the fixes less accurately. If you know "
        f"that this fault exists, repair it yourself: {finding.remedy}"
    )
    severity = "warning" if finding.severity == "serious" else finding.severity
    return replace(finding, severity=severity, remedy=remedy, repair=None, needs_action=False)


def _of_one_sensor(finding: Finding) -> Finding:
    """Withhold the repair of a finding if all repairs together would give accelerometers and gyro different axes."""
    first, stop, more = finding.remedy.partition(". ")
    remedy = (
        f"if you know that this fault exists, {first}, and check again; or split the drive if it begins in reverse. "
        "All repairs together would give accelerometers and gyro different axes, so one finding may be "
        f"a consequence of another fault{stop}{more}"
    )
    return replace(finding, remedy=remedy, repair=None)


def _after_the_axes(finding: Finding) -> Finding:
    """Withhold a repair that a filter verifies, since the filter's predictions are useless with wrong axes."""
    if finding.repair is None or finding.repair.action not in VERIFIED_ACTIONS:
        return finding
    remedy = f"correct the IMU's axes and check again; then {finding.remedy}"
    return replace(finding, remedy=remedy, repair=None)


def _of_part(finding: Finding, whole: str) -> Finding:
    """Replace the remedy of a part's repairable fault, since a repaired part would differ from the other part."""
    remedy = f"if the whole drive {printable(whole)} has this fault, repair that drive and split it again"
    return replace(finding, remedy=f"{remedy} ({finding.remedy})")


def finding_sentences(drive: Drive) -> tuple[str, ...]:
    """Return serious findings and warnings as sentences; empty for a drive that is too short."""
    try:
        found = diagnose(drive).findings
    except DriveError:
        return ()
    named = {"serious": "finds a SERIOUS fault in", "warning": "gives a warning about"}
    return tuple(
        f"the doctor {named[f.severity]} {drive.name} [{f.code}]: {f.what}. Consequence: {f.consequence}. Remedy: "
        f"{f.remedy}"
        for f in found
        if f.severity in named
    )
