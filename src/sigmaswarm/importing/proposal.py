"""Propose mappings for unrecognized columns by their names, and check them with the doctor.

Names do not state signs and units reliably, so a proposal is shown but never applied. The doctor's findings on the
resulting drive correct signs, axes and units of the expressions.
"""

import math
import re
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.doctor.findings import Diagnosis
from sigmaswarm.doctor.repairs import ACTIONS
from sigmaswarm.drives.drive import Drive, Imu
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.table_files import MAX_VALUE
from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.importing.names import plain_words, read_name, unit_of
from sigmaswarm.importing.positions import RADIUS_68
from sigmaswarm.importing.quantities import gravity_columns
from sigmaswarm.importing.rates import unit_of_rates
from sigmaswarm.importing.source import Part, Role
from sigmaswarm.importing.table_columns import AXES, quoted_column
from sigmaswarm.importing.units import in_si

# Words for directions, with their signs in the axes x forward, y left, z up
FORWARD = {
    **dict.fromkeys(("fwd", "forward", "forwards", "front", "longitudinal", "long", "lon", "inline", "x"), 1),
    **dict.fromkeys(("backward", "rear"), -1),
}
LEFT = {**dict.fromkeys(("left", "lateral", "lat", "port", "y"), 1), "right": -1, "starboard": -1}
UP = {**dict.fromkeys(("up", "upward", "vertical", "vert", "z"), 1), "down": -1, "downward": -1}
CLOCKWISE = {"ccw": 1, "anticlockwise": 1, "counterclockwise": 1, "cw": -1, "clockwise": -1}
TURNING = (
    ("gz", {**UP, "yaw": 1, "yawrate": 1, "turn": 1}),
    ("gx", {**FORWARD, "roll": 1, "rollrate": 1}),
    ("gy", {**LEFT, "pitch": 1, "pitchrate": 1}),
)
MOVING = (("ax", FORWARD), ("ay", LEFT), ("az", UP))
FORCE = {"a", "gforce", "acc", "accl", "accel", "acceleration", "accelerometer", "force"}
RATE = {
    *("gyro", "gyr", "gyroscope", "omega", "w", "pqr", "rate", "angular", "rot", "rotation", "angvel"),
    *("yawrate", "rollrate", "pitchrate", "yaw", "turn"),
}
# Words in the names of angles, and of accelerations without gravity
ANGLES, FREE = {"attitude", "euler", "orientation", "angle", "angles"}, {"user", "linear", "lin", "free"}
_ESTIMATES = {
    "est",
    "estimate",
    "estimated",
    "kf",
    "ekf",
    "ukf",
    "filter",
    "filtered",
    "fused",
    "pred",
    "cmd",
}
_VERSIONS = {"raw", "filt", "lp", "calib", "cal", "corr", "corrected"}  # last words that do not change a name
_GLUED = r"\b(long|lat|vert|fwd|inline)(acc[a-z]*)"
_ATTITUDE = {"roll", "pitch", "yaw"}
ACCURACY = {"hacc", "accuracy", "eph", "sigma", "std", "stdev"}
# Words in the names of positions in which "long" is the longitude
PLACE = {"long", "gps", "gnss", "ins", "pos", "position"}
# Words in the names of accuracies that are not those of the position
NO_PLACE = {
    *RATE,
    *(FORCE - {"a", "acc"}),
    *("v", "vertical", "altitude", "alt", "height", "speed", "vel", "velocity", "time"),
    *("heading", "bearing", "course", "roll", "pitch"),
}
_AXIS = r"\W*[xyzXYZ012]\W*(?:[(\[].*)?$"  # axis and unit at the end of a name
# Actions of repairs that can be written as expressions, in the order of application
CORRECTED = ("rotate", "gyro", "tilt-rates", "accelerometer")
# Largest difference from integers of the elements of a rotation that counts as a signed permutation of the axes
EXCHANGE_TOLERANCE = 0.2
# Warnings of contradictory signs, axes or units
CONTRADICTIONS = {"gyro-unit", "gyro-tilt", "accelerometer-unit", "accelerometer-up", "gravity-size"}
UNKNOWN_UNITS = {"gyro-unit", "accelerometer-unit"}
CHECKED_TIME = 900.0  # s, the longest part of a drive that is checked


@dataclass(frozen=True)
class Meaning:
    role: Role
    column: str
    expression: str
    # True if a column of angles or of accelerations without gravity may have this name
    weak: bool = field(default=False, compare=False)


def meaning_of(name: str) -> Meaning | None:
    """Interpret the name of a column word by word; None if it means no column of a drive."""
    bracketed = re.fullmatch(r"(.+?)\s*[\[(][^\[\]()]*[\])]\s*", name)  # a name and its unit
    unit = read_name(name).unit if bracketed else None
    unit = unit if unit and unit.known else None
    text = bracketed[1] if bracketed and unit else name
    text = re.sub(r"\[([012])\]$", lambda m: f" {'xyz'[int(m[1])]}", text)
    split = re.sub(r"^([XYZ])(?=GYRO|ACC)|(?<=[a-z])(?=[A-Z])", r"\1_", text)
    words = re.findall(r"[a-z]+|\d+", " ".join(plain_words(split)))
    sign = math.prod(CLOCKWISE[w] for w in words if w in CLOCKWISE)
    turns = not CLOCKWISE.keys().isdisjoint(words)
    words = [w for w in words if w not in CLOCKWISE]
    column_text = quoted_column(name)
    for count in () if unit else (3, 2, 1):
        if len(words) > count and words[-1] != "turn" and (found := unit_of(words[-count:])) and found.known:
            words, unit = words[:-count], found
            break
    alone = len(words) < 2  # the import itself recognizes ax
    while len(words) > 1 and words[-1] in _VERSIONS:
        words = words[:-1]
    words = re.sub(_GLUED, r"\1 \2", " ".join(words)).split()  # longacc
    if not alone and re.fullmatch("[agw][xyz]", words[-1]) and _ESTIMATES.isdisjoint(words):  # bosch_ax
        words = [*words[:-1], "acc" if words[-1][0] == "a" else "gyro", words[-1][1]]
    if unit and unit.dimension in ("rate", "acceleration", "length", "angle"):
        column_text = in_si(unit, column_text)
    rest = set(words)
    if not rest & FORCE and (unit is None or unit.dimension == "angle"):
        if rest & {"lat", "latitude", "breite"}:
            return Meaning("gps", "lat", quoted_column(name))
        long = "long" in rest and (unit or {*filter(str.isalpha, rest)} <= PLACE)
        if rest & {"lon", "lng", "longitude", "lange", "laenge"} or long:
            return Meaning("gps", "lon", quoted_column(name))
    horizontal = rest & {"h", "horizontal", "pos", "position"} and rest & {"acc", "accuracy"}
    length = unit is None or unit.dimension == "length"
    if (rest & ACCURACY or horizontal) and length and not rest & NO_PLACE:
        # phones report the radius of a 68% circle as accuracy; receivers report hAcc or eph, for both axes together
        return Meaning("gps", "std_x", f"{column_text}/{RADIUS_68 if 'accuracy' in rest else 'sqrt(2)'}")
    rates = RATE | ({"roll", "pitch"} if unit and unit.dimension == "rate" else set())
    if rest & ACCURACY or not rest & (rates | FORCE) or "gps" in rest:
        return None
    angle = not rest & (FORCE | RATE - {"yaw", "turn"})  # the name may be that of an angle
    dimensions = ("acceleration",) if rest & FORCE else ("rate",) if angle else ("rate", "angle")
    if (unit and unit.dimension not in dimensions) or (angle and rest & ANGLES):
        return None
    for column, directions in MOVING if rest & FORCE else TURNING:
        if signs := [directions[w] for w in words if w in directions]:
            sign = math.prod(signs) * (1 if rest & FORCE else sign)
            weak = angle or not rest.isdisjoint(FREE)
            return Meaning("imu", column, column_text if sign > 0 else f"-{column_text}", weak)
    if rest & FORCE or not turns:
        return None
    return Meaning("imu", "gz", column_text if sign > 0 else f"-{column_text}")


@dataclass(frozen=True)
class Proposal:
    tables: Mapping[Role, str]  # the chosen table, if a log has several
    columns: Mapping[Role, Mapping[str, str]]  # expressions of a drive's columns

    @property
    def maps(self) -> list[str]:
        return [
            f"{f'{role}.' if name == 't' else ''}{name}={text}"
            for role, columns in self.columns.items()
            for name, text in columns.items()
        ]

    @property
    def settings(self) -> dict[str, Mapping[str, str]]:
        """The proposal as settings of `import_log`, with the role of each column."""
        maps = {
            f"{role}.{name}": text for role, texts in self.columns.items() for name, text in texts.items()
        }
        return {"maps": maps, "tables": {**self.tables}}

    @property
    def options(self) -> str:
        """The proposal as options, quoted so that a shell does not run text from a log's header."""
        tables = [f"--{role}-table {shlex.quote(table)}" for role, table in self.tables.items()]
        return " ".join([*tables, "--map", *map(shlex.quote, self.maps)])


def propose_columns(
    tables: Mapping[str, Sequence[str]], wanted: Role, known: Mapping[str, str]
) -> tuple[str, dict[str, str]] | None:
    """Return the table with the most columns of a role that are not ``known``, and these columns as expressions.

    ``tables``: names of columns by table.
    """
    best: tuple[str, dict[str, str]] | None = None
    for table, names in tables.items():
        read = ((re.sub(_AXIS, "", name), meaning_of(name)) for name in names)
        meant = [(stem, m) for stem, m in read if m and m.role == wanted and m.column not in known]
        if {read_name(name).plain for name in names} >= _ATTITUDE:  # three angles, not rates
            meant = [(stem, m) for stem, m in meant if not (m.weak and m.column in AXES[3:])]
        alike = Counter(stem for stem, _ in meant)
        chosen: dict[str, Meaning] = {}
        for _, meaning in sorted(meant, key=lambda pair: (pair[1].weak, -alike[pair[0]])):
            chosen.setdefault(meaning.column, meaning)
        found = {column: meaning.expression for column, meaning in chosen.items()}
        if all(m.weak for column, m in chosen.items() if column in ("ax", "ay", "az")):
            gravity = {c: name for c, name in gravity_columns(names).items() if c in found}
            found |= {c: f"({found[c]} + {_in_si(name)})" for c, name in gravity.items()}
        if found and (best is None or len(found) > len(best[1])):
            best = table, found
    return best


def _in_si(name: str) -> str:
    unit, text = read_name(name).unit, quoted_column(name)
    return in_si(unit, text) if unit and unit.known else text


def check_proposal(proposal: Proposal, make: Callable[[Proposal], Drive]) -> tuple[Proposal, str, bool]:
    """Correct a proposal with the doctor's findings; return the proposal, the evidence, and True if it can be imported.

    ``make`` makes the drive. A proposal with unknown units counts as one that cannot be imported.
    """

    def made(proposal: Proposal) -> Drive:
        return _busiest_part(make(proposal))

    try:
        drive = _plausible(made(proposal))
        named = proposal
        if (scaled := _with_shown_unit(proposal, drive)) != proposal:
            proposal, drive = scaled, made(scaled)
        first = diagnose(drive)
        corrected = _corrected(proposal, drive, first)
        places = proposal.columns.get("gps", {})
        if "mirrored-fixes" in first.codes and {"lat", "lon"} <= places.keys():
            exchanged = {**places, "lat": places["lon"], "lon": places["lat"]}
            corrected = replace(proposal, columns={**proposal.columns, "gps": exchanged})
        last = diagnose(made(corrected)) if corrected != proposal else first
    except SigmaswarmError as error:
        return (
            proposal,
            f"the mapping follows from the columns' names and values alone and could not be checked: {error}",
            False,
        )
    if corrected != proposal and _faults(last) >= _faults(first):
        corrected, last = proposal, first
    column = places.get("std_x", "").partition("/")[0].strip("`")
    stated = (unit := unit_of(plain_words(column)[-1:] or [""])) and unit.known
    if column and not stated and "gps-noise" in last.codes:  # hAcc may be in mm
        fixes = {name: text for name, text in corrected.columns["gps"].items() if name != "std_x"}
        columns = {**corrected.columns, "gps": fixes}
        corrected = replace(corrected, columns={role: texts for role, texts in columns.items() if texts})
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
    """Reject numbers that no sensor reports, since they would overflow the doctor's sums."""
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

    The repairs are applied to an IMU whose columns are unit vectors, which shows their effect on each column.
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
    texts = {name: text for part in parts for name, text in part.columns.items() if name in AXES[:3]}
    named = Proposal({}, {"imu": texts})
    try:
        codes = diagnose(_busiest_part(_plausible(make(named)))).codes
    except SigmaswarmError:
        return None
    other = {name: _times(text, -1.0) for name, text in texts.items()}
    return Proposal({}, {"imu": other}) if "accelerometer-sign" in codes else None


def _times(expression: str, factor: float) -> str:
    if factor < 0:
        return _times(expression[1:] if expression.startswith("-") else f"-{expression}", -factor)
    if math.isclose(factor, math.pi / 180, rel_tol=1e-6):
        return f"radians({expression})"
    return expression if factor == 1.0 else f"{expression}*{factor:.9g}"
