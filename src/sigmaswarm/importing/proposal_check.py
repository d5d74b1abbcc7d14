"""Check a proposal with the doctor, whose findings on the resulting drive correct signs, axes and units."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.doctor.findings import Diagnosis
from sigmaswarm.doctor.repairs import ACTIONS
from sigmaswarm.drives.drive import Drive, Imu
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.table_files import MAX_VALUE
from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.importing.imu_units import unit_of_rates
from sigmaswarm.importing.names import plain_words, unit_of
from sigmaswarm.importing.proposal import Proposal
from sigmaswarm.importing.source import Part, texts_of
from sigmaswarm.importing.table_columns import AXES

# Actions of repairs that can be written as expressions, in the order of application
CORRECTED = ("rotate", "gyro", "tilt-rates", "accelerometer")
# Largest difference from integers of the elements of a rotation that counts as a signed permutation of the axes
EXCHANGE_TOLERANCE = 0.2
# Warnings of contradictory signs, axes or units
CONTRADICTIONS = {"gyro-unit", "gyro-tilt", "accelerometer-unit", "accelerometer-up", "gravity-size"}
UNKNOWN_UNITS = {"gyro-unit", "accelerometer-unit"}
CHECKED_TIME = 900.0  # s, the longest part of a drive that is checked


def check_proposal(proposal: Proposal, make: Callable[[Proposal], Drive]) -> tuple[Proposal, str, bool]:
    """Correct a proposal with the doctor's findings. Return the proposal, the evidence, and True if it can be imported.

    ``make`` makes the drive. A proposal with unknown units counts as a proposal that cannot be imported.
    """

    def made(proposal: Proposal) -> Drive:
        return _busiest_part(make(proposal))

    places = proposal.columns.get("gps", {})
    column = places.get("std_x", "").partition("/")[0].strip("`")
    unit = unit_of(plain_words(column)[-1:] or [""])
    stated = not column or (unit is not None and unit.known)  # hAcc may be in mm
    try:
        drive = _plausible(made(proposal))
        named = proposal
        if (scaled := _with_shown_unit(proposal, drive)) != proposal:
            proposal, drive = scaled, made(scaled)
        first = diagnose(drive)
        corrected = _corrected(proposal, drive, first)
        if "mirrored-fixes" in first.codes and {"lat", "lon"} <= places.keys():
            exchanged = {**places, "lat": places["lon"], "lon": places["lat"]}
            corrected = replace(proposal, columns={**proposal.columns, "gps": exchanged})
        last = diagnose(made(corrected)) if corrected != proposal else first
    except SigmaswarmError as error:
        return (
            proposal if stated else _without_accuracy(proposal),
            f"the mapping follows from the columns' names and values alone and could not be checked: {error}",
            False,
        )
    if corrected != proposal and _faults(last) >= _faults(first):
        corrected, last = proposal, first
    if column and not stated and "gps-noise" in last.codes:
        corrected = _without_accuracy(corrected)
        last = replace(last, findings=tuple(f for f in last.findings if f.code != "gps-noise"))
    changed = "corrected with" if corrected != named else "checked with"
    basis = (
        f"the mapping follows from the columns' names and values, and was {changed} the motion of the fixes"
    )
    serious = [f.code for f in last.findings if f.severity == "serious"]
    warned = [f.code for f in last.findings if f.severity == "warning" and not f.code.startswith("unseen-")]
    if serious or CONTRADICTIONS & {*warned}:
        left = [*serious, *warned]
        return corrected, f"{basis}; the doctor still finds {', '.join(left)}", UNKNOWN_UNITS.isdisjoint(left)
    unseen = sorted(code for code in last.codes if code.startswith("unseen-") and code != "unseen-clock")
    blind = f", but this log does not show all of them ({', '.join(unseen)})" if unseen else ""
    also = f"; the doctor also warns of {', '.join(warned)}" if warned else ""
    return corrected, f"{basis}: signs, axes and units agree{blind}{also}", True


def _without_accuracy(proposal: Proposal) -> Proposal:
    columns = {r: {n: t for n, t in texts.items() if n != "std_x"} for r, texts in proposal.columns.items()}
    return replace(proposal, columns={role: texts for role, texts in columns.items() if texts})


def _busiest_part(drive: Drive) -> Drive:
    """Return the part of at most `CHECKED_TIME`, s, with the longest path along every tenth fix."""
    imu = drive.imu.time
    fixes = drive.gps.select((drive.gps.time >= imu[0]) & (drive.gps.time <= imu[-1]))
    position, time = fixes.x + 1j * fixes.y, fixes.time
    if drive.duration <= CHECKED_TIME or len(time) < 20:
        return drive
    path = np.append(0.0, np.cumsum(np.abs(np.diff(position[::10]))))
    ends = np.interp(time[::10] + CHECKED_TIME, time[::10], path)
    start = float(time[::10][np.argmax(ends - path)])
    return clip(drive, start, start + CHECKED_TIME)


def _with_shown_unit(proposal: Proposal, drive: Drive) -> Proposal:
    imu = proposal.columns.get("imu", {})
    rates = {name: imu[name] for name in AXES[3:] if name in imu}
    columns = {name: re.sub(r"^radians\((.+)\)$", r"\1", text) for name, text in rates.items()}
    shown = unit_of_rates(drive, {"imu": [Part("", rates)]}, columns).expressions
    return replace(proposal, columns={**proposal.columns, "imu": {**imu, **shown}}) if shown else proposal


def _plausible(drive: Drive) -> Drive:
    """Refuse numbers that no sensor reports, since they would overflow the doctor's sums."""
    for table in (drive.imu, drive.gps):
        for name, values in vars(table).items():
            if name != "time" and values is not None and np.abs(values).max(initial=0.0) > MAX_VALUE:
                raise InputError(f"{name} has numbers beyond {MAX_VALUE:g}; delete the damaged rows")
    return drive


def _faults(diagnosis: Diagnosis) -> tuple[int, int]:
    """Count serious findings, and findings that other expressions can correct."""
    left = [f for f in diagnosis.findings if f.repair is not None and f.repair.action in CORRECTED]
    return sum(f.severity == "serious" for f in diagnosis.findings), len(left)


def _corrected(proposal: Proposal, drive: Drive, diagnosis: Diagnosis) -> Proposal:
    """Apply the doctor's repairs of signs, exchanged axes and factors to the expressions.

    The repairs are first applied to an IMU whose columns are unit vectors, which shows their effect on each column.
    """
    units = dict(zip(AXES, np.eye(len(AXES)), strict=True))
    probe = replace(drive, imu=Imu(np.arange(len(AXES), dtype=np.float64), **units))
    repairs = [f.repair for f in diagnosis.findings if f.repair is not None and f.repair.action in CORRECTED]
    for repair in sorted(repairs, key=lambda r: CORRECTED.index(r.action)):
        values = np.array(repair.values)
        if repair.action == "rotate":
            if np.abs(values - np.round(values)).max() >= EXCHANGE_TOLERANCE:
                continue
            values = np.round(values)
        probe = ACTIONS[repair.action](probe, *values.tolist())
    imu = proposal.columns.get("imu", {})
    corrected: dict[str, str] = {}
    for name in AXES:
        row = np.asarray(getattr(probe.imu, name))
        k = int(np.argmax(np.abs(row)))
        if np.count_nonzero(row) == 1 and {name, AXES[k]} <= imu.keys():
            corrected[name] = _times(imu[AXES[k]], float(row[k]))
    return replace(proposal, columns={**proposal.columns, "imu": {**imu, **corrected}}) if imu else proposal


def reversed_forces(parts: Sequence[Part], make: Callable[[Proposal], Drive]) -> Proposal | None:
    """Propose the opposite sign for the accelerations if the doctor finds this fault; otherwise return None.

    Phones with iOS report accelerations with the sign of gravity, which no rotation corrects.
    """
    texts = {name: text for name, text in texts_of(parts).items() if name in AXES}  # a rotation turns all
    named = Proposal({}, {"imu": texts})
    try:
        codes = diagnose(_busiest_part(_plausible(make(named)))).codes
    except SigmaswarmError:
        return None
    other = {name: _times(text, -1.0) if name in AXES[:3] else text for name, text in texts.items()}
    return Proposal({}, {"imu": other}) if "accelerometer-sign" in codes else None


def _times(expression: str, factor: float) -> str:
    if factor < 0:
        return _times(expression[1:] if expression.startswith("-") else f"-{expression}", -factor)
    if math.isclose(factor, math.pi / 180, rel_tol=1e-6):
        return f"radians({expression})"
    return expression if factor == 1.0 else f"{expression}*{factor:.9g}"
