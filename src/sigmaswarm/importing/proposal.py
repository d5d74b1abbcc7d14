"""A whole ``--map`` for columns that no guess recognizes: read from their names, tried, and judged by the doctor.

A proposal is shown and never applied, since names are unreliable about signs and units. The doctor checks the drive
that it makes, and its evidence on signs, axes and units corrects the expressions.
"""

import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.doctor.findings import Diagnosis, Repair
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.table_files import LARGEST
from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.importing.source import Role

FORWARD = {
    "fwd": 1,
    "forward": 1,
    "forwards": 1,
    "front": 1,
    "longitudinal": 1,
    "long": 1,
    "x": 1,
    "backward": -1,
    "rear": -1,
}
LEFT = {"left": 1, "lateral": 1, "lat": 1, "port": 1, "y": 1, "right": -1, "starboard": -1}
UP = {"up": 1, "upward": 1, "vertical": 1, "vert": 1, "z": 1, "down": -1, "downward": -1}
TURNING = {"ccw": 1, "anticlockwise": 1, "counterclockwise": 1, "cw": -1, "clockwise": -1}
"""Words for directions, and the sign of what goes there in x forward, y left, z up."""
AXES = (("x", FORWARD), ("y", LEFT), ("z", UP))

FORCE = {"a", "acc", "accel", "acceleration", "accelerometer", "force"}
RATE = {
    "gyro",
    "gyr",
    "gyroscope",
    "omega",
    "w",
    "rate",
    "angular",
    "rot",
    "rotation",
    "angvel",
    "yawrate",
    "yaw",
    "turn",
}
ACCURACY = {"hacc", "accuracy", "eph", "sigma", "std", "stdev"}
NO_PLACE = {
    *RATE,
    *(FORCE - {"a", "acc"}),
    *("v", "vertical", "altitude", "alt", "height", "speed", "vel", "velocity", "time"),
    *("heading", "bearing", "course", "roll", "pitch", "deg", "degrees", "rad", "radians"),
}
"""Of which a receiver states the accuracy, too: that says nothing of the position, by which R goes."""
LENGTHS = {(), ("m",), ("mm",), ("cm",)}
"""Units that the accuracy of a position may have."""
UNITS: tuple[tuple[tuple[str, ...], str], ...] = (
    *(
        (words, "radians({})")
        for words in (("dps",), ("degs",), ("deg", "s"), ("deg", "sec"), ("degps",), ("deg", "per", "s"))
    ),
    *(
        (words, "{}")
        for words in (("rad", "s"), ("radps",), ("rps",), ("mps2",), ("m", "s2"), ("m", "s", "2"), ("ms2",))
    ),
    (("mg",), "{}*0.00980665"),
    (("g",), "{}*9.80665"),
    *((words, "{}/3.6") for words in (("kmh",), ("kph",), ("km", "h"))),
    *((words, "{}") for words in (("mps",), ("m", "s"), ("deg",), ("m",), ("rad",))),
    *((words, "{}*1e-3") for words in (("mm",),)),
    *((words, "{}*1e-2") for words in (("cm",),)),
)
"""The last words of a name that are a unit, and what makes it the drive's."""

CORRECTED = {"rotate", "gyro", "tilt-rates", "accelerometer"}
"""Repairs that are done to a proposal's expressions; the others are of the drive."""
EXCHANGED = 0.2
"""A rotation whose elements are this near to whole numbers exchanges axes or turns their signs."""
DOUBTS = {"gyro-unit", "gyro-tilt", "accelerometer-unit", "accelerometer-up", "gravity-size"}
"""Warnings that deny that signs, axes and units agree."""


@dataclass(frozen=True)
class Meaning:
    """A possible assignment of a column: the column of a role, and its expression."""

    role: Role
    column: str
    expression: str


def meaning_of(name: str) -> Meaning | None:
    """Interpret a column's name word by word; None where it names no column of a drive."""
    words = re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower())
    turn = [TURNING[w] for w in words if w in TURNING]
    words = [w for w in words if w not in TURNING]
    text = name if re.fullmatch(r"[A-Za-z_]\w*", name) else f"`{name}`"
    unit, measured = "{}", ()
    for ending, scale in UNITS:
        if len(words) > len(ending) and tuple(words[-len(ending) :]) == ending:
            words, unit, measured = words[: -len(ending)], scale, ending
            break
    rest, said = set(words), unit.format(text)
    if rest & {"lat", "latitude"} and not rest & FORCE:
        return Meaning("gps", "lat", text)
    if rest & {"lon", "lng", "longitude"} or (rest == {"long"}):
        return Meaning("gps", "lon", text)
    horizontal = rest & {"h", "horizontal", "pos", "position"} and rest & {"acc", "accuracy"}
    if (rest & ACCURACY or horizontal) and measured in LENGTHS and not rest & NO_PLACE:
        return Meaning("gps", "std_x", f"{said}/sqrt(2)")
    if rest & ACCURACY:
        return None
    if rest & RATE and not rest & FORCE:
        for axis, directions in (
            ("z", {**UP, "yaw": 1, "yawrate": 1, "turn": 1}),
            ("x", {**FORWARD, "roll": 1}),
            ("y", {**LEFT, "pitch": 1}),
        ):
            if signs := [directions[w] for w in words if w in directions]:
                return _of_imu(f"g{axis}", said, math.prod(signs) * math.prod(turn))
        return _of_imu("gz", said, math.prod(turn)) if turn else None
    if rest & FORCE:
        for axis, directions in AXES:
            if signs := [directions[w] for w in words if w in directions]:
                return _of_imu(f"a{axis}", said, math.prod(signs))
    return None


def _of_imu(column: str, said: str, sign: int) -> Meaning:
    return Meaning("imu", column, said if sign > 0 else f"-{said}")


@dataclass(frozen=True)
class Proposal:
    """A way to read a log.

    Attributes
    ----------
    tables : mapping of role to the table that is to be chosen, where a log has several
    columns : by role, the expressions of a drive's columns
    """

    tables: Mapping[Role, str]
    columns: Mapping[Role, Mapping[str, str]]

    @property
    def maps(self) -> list[str]:
        """As ``--map`` takes them."""
        return [
            f"{f'{role}.' if column == 't' else ''}{column}={expression}"
            for role, columns in self.columns.items()
            for column, expression in columns.items()
        ]

    @property
    def options(self) -> str:
        """As the command line takes it: a shell must not run what stands in backticks, or in a log's header."""
        tables = [f"--{role}-table {shlex.quote(table)}" for role, table in self.tables.items()]
        return " ".join([*tables, "--map", *map(shlex.quote, self.maps)])


def proposed(
    tables: Mapping[str, Sequence[str]], wanted: Role, known: Mapping[str, str]
) -> tuple[str, dict[str, str]] | None:
    """The table that has most of a role, and the columns that its names say beside those that are ``known``.

    Parameters
    ----------
    tables : by their names, the columns' names
    """
    best: tuple[str, dict[str, str]] | None = None
    for table, columns in tables.items():
        found: dict[str, str] = {}
        for name in columns:
            meaning = meaning_of(name)
            if meaning and meaning.role == wanted and meaning.column not in {**known, **found}:
                found[meaning.column] = meaning.expression
        if found and (best is None or len(found) > len(best[1])):
            best = table, found
    return best


def _plausible(drive: Drive) -> Drive:
    """Refuse numbers that no sensor reports: the doctor's sums would overflow."""
    for table in (drive.imu, drive.gps):
        for name, values in vars(table).items():
            if name != "time" and values is not None and np.abs(values).max(initial=0.0) > LARGEST:
                raise InputError(f"{name} has numbers beyond {LARGEST:g}; delete the damaged rows")
    return drive


def judged(proposal: Proposal, make: Callable[[Proposal], Drive]) -> tuple[Proposal, str]:
    """Return the proposal as corrected by the doctor, and a sentence on the evidence.

    Parameters
    ----------
    make : callable
        Imports the drive; nothing is written.
    """
    try:
        first = diagnose(_plausible(make(proposal)))
        corrected = _corrected(proposal, first)
        last = diagnose(make(corrected)) if corrected != proposal else first
    except SigmaswarmError as error:
        return proposal, f"read from the columns' names alone, and not checked: {error}"
    if corrected != proposal and _faults(last) >= _faults(first):
        corrected, last = proposal, first
    changed = "corrected by" if corrected != proposal else "checked with"
    said = f"read from the columns' names, {changed} how the fixes move"
    warned = [f.code for f in last.findings if f.severity == "warning" and not f.code.startswith("unseen-")]
    if (left := _serious(last)) or DOUBTS & set(warned):
        return corrected, f"{said}; the doctor still finds {', '.join([*left, *warned])}"
    unseen = sorted(code for code in last.codes if code.startswith("unseen-") and code != "unseen-clock")
    blind = f", but this log does not show all ({', '.join(unseen)})" if unseen else ""
    also = f"; the doctor also warns of {', '.join(warned)}" if warned else ""
    return corrected, f"{said}: signs, axes and units agree{blind}{also}"


def _faults(diagnosis: Diagnosis) -> tuple[int, int]:
    """How many findings are serious, and how many could be corrected in the expressions: fewer is better."""
    return len(_serious(diagnosis)), sum(
        f.repair is not None and f.repair.action in CORRECTED for f in diagnosis.findings
    )


def _serious(diagnosis: Diagnosis) -> list[str]:
    return [f.code for f in diagnosis.findings if f.severity == "serious"]


def _corrected(proposal: Proposal, diagnosis: Diagnosis) -> Proposal:
    """Apply the doctor's repairs to the expressions: signs, exchanges, factors."""
    imu = dict(proposal.columns.get("imu", {}))
    repairs = [finding.repair for finding in diagnosis.findings if finding.repair is not None]
    for repair in sorted(repairs, key=lambda r: r.action != "rotate"):  # as `doctor.repairs` orders them
        imu |= dict(_mended(imu, repair))
    return Proposal(proposal.tables, {**proposal.columns, "imu": imu} if imu else proposal.columns)


def _mended(imu: Mapping[str, str], repair: Repair) -> Iterator[tuple[str, str]]:
    """The expressions that a repair changes, as `doctor.repairs` changes the columns."""
    values = repair.values
    if repair.action == "rotate":
        matrix = np.array(values).reshape(3, 3)
        if np.abs(matrix - np.round(matrix)).max() < EXCHANGED:
            for letter in "ag":
                yield from _turned(
                    imu, tuple(f"{letter}{i}" for i in "xyz"), np.round(matrix).ravel().tolist()
                )
    if repair.action == "gyro":
        column, factor = ("gx", "gy", "gz")[int(values[0])], values[1]
        if column == "gz":
            each = {
                "gx": abs(factor),
                "gy": abs(factor),
                "gz": factor,
            }  # a unit's factor applies to all, a sign to one
            yield from ((name, _times(imu[name], k)) for name, k in each.items() if name in imu)
        elif {column, "gz"} <= imu.keys():
            yield from ((column, imu["gz"]), ("gz", imu[column]))
    if repair.action == "tilt-rates":
        yield from _turned(imu, ("gx", "gy"), values)
    if repair.action == "accelerometer":
        yield from _turned(imu, ("ax", "ay"), values[:4])
        if "az" in imu:
            yield "az", _times(imu["az"], values[4])


def _turned(
    imu: Mapping[str, str], columns: tuple[str, ...], values: Sequence[float]
) -> Iterator[tuple[str, str]]:
    """Columns (n,) by a matrix (n, n), row by row, that changes their signs or exchanges them."""
    matrix = np.array(values).reshape(len(columns), len(columns))
    if np.count_nonzero(matrix) != len(columns):
        return
    for row, column in zip(matrix, columns, strict=True):
        k = int(np.flatnonzero(row)[0])
        if {column, columns[k]} <= imu.keys():
            yield column, _times(imu[columns[k]], float(row[k]))


def _times(expression: str, factor: float) -> str:
    """The expression times a factor: a sign, g, or degrees."""
    if factor < 0:
        expression = expression[1:] if expression.startswith("-") else f"-{expression}"
    size = abs(factor)
    if math.isclose(size, math.pi / 180, rel_tol=1e-6):
        return f"radians({expression})"
    return expression if size == 1.0 else f"{expression}*{'9.80665' if size == GRAVITY else f'{size:.9g}'}"
