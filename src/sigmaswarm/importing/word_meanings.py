"""Propose mappings for unrecognized columns by the words in their names."""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from sigmaswarm.importing.names import plain_words, read_name, split_words, unit_of
from sigmaswarm.importing.positions import RADIUS_68
from sigmaswarm.importing.quantities import gravity_columns
from sigmaswarm.importing.source import Role
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
ANGLES, FREE = {"attitude", "euler", "orientation", "angle", "angles"}, {"user", "linear", "lin"}
# Words in the names of vectors in the axes of the earth; the free accelerations of Xsens are among them
EARTH = {"world", "earth", "global", "free", "freeacc"}
_ESTIMATES = {
    *("est", "estimate", "estimated", "kf", "ekf", "ukf", "filter", "filtered", "fused", "pred", "cmd"),
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
_DOWN, _SIDE = {"down", "downward"}, {"left", "right", "port", "starboard"}
_AXIS = r"\W*[xyzXYZ012]\W*(?:[(\[].*)?$"  # axis and unit at the end of a name


@dataclass(frozen=True)
class Meaning:
    role: Role
    column: str
    expression: str
    # True if a column of angles or of accelerations without gravity may have this name
    weak: bool = field(default=False, compare=False)


def is_of_earth(name: str) -> bool:
    """Return True if a name states the axes of the earth; names of topics or devices before the sensor do not."""
    *_, sensor, axis = ["", *re.split(r"[/.]", name)]
    return not EARTH.isdisjoint(split_words(f"{sensor} {axis}" if len(axis) < 2 else axis))


def meaning_of(name: str) -> Meaning | None:
    """Interpret the name of a column word by word. Return None if it means no column of a drive."""
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
    if rest & ACCURACY or is_of_earth(name) or not rest & (rates | FORCE) or "gps" in rest:
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


def propose_columns(
    tables: Mapping[str, Sequence[str]], wanted: Role, known: Mapping[str, str]
) -> tuple[str, dict[str, str]] | None:
    """Return the table with the most columns of a role that are not ``known``, and these columns as expressions.

    ``tables`` contains the names of columns by table.
    """
    best: tuple[str, dict[str, str]] | None = None
    for table, names in tables.items():
        read = ((re.sub(_AXIS, "", name), meaning_of(name)) for name in names)
        meant = [(stem, m) for stem, m in read if m and m.role == wanted and m.column not in known]
        if {read_name(name).plain for name in names} >= _ATTITUDE:  # three angles, not rates
            meant = [(stem, m) for stem, m in meant if not (m.weak and m.column in AXES[3:])]
        down = {m.column[0] for _, m in meant if m.column[1:] == "z" and _DOWN & {*split_words(m.expression)}}
        # next to an axis down, a lateral axis without a stated side points to the right
        rightward = [
            m.column[1:] == "y" and m.column[0] in down and not _SIDE & {*split_words(m.expression)}
            for _, m in meant
        ]
        meant = [
            (stem, replace(m, expression=f"-{m.expression}") if right else m)
            for right, (stem, m) in zip(rightward, meant, strict=True)
        ]
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
