"""Units in the names of columns: their dimensions, and their factors to SI units.

A unit is a product of powers of base units, such as m/s^2, deg/sec, rad s^-1 or mm/s/s, or a word such as knots.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from sigmaswarm.geodesy import STANDARD_GRAVITY

UnitDimension = Literal["time", "acceleration", "rate", "angle", "length", "speed"]

G = STANDARD_GRAVITY
MAX_LENGTH = 40

_DEGREE = math.pi / 180
# Words for units of length, time and angle, by factor to m, s and rad
_BASE_WORDS = {
    "L": {
        **{1.0: "m meter meters metre metres", 1e3: "km", 0.1: "dm", 1e-2: "cm", 1e-3: "mm", 1e-6: "um"},
        **{0.3048: "ft feet foot", 0.0254: "in inch", 0.9144: "yd", 1609.344: "mi mile miles"},
        1852.0: "nmi nm",
    },
    "T": {
        **{
            1.0: "s sec secs sek second seconds",
            1e-3: "ms msec msecs millisec millis millisecond milliseconds",
        },
        1e-6: "us usec usecs microsec micros microsecond microseconds",
        1e-9: "ns nsec nsecs nanosec nanosecs nanos nanosecond nanoseconds",
        **{60.0: "min mins minute minutes", 3600.0: "h hr hrs hour hours", 86400.0: "d day days"},
    },
    "A": {
        **{
            1.0: "rad radian radians",
            1e-3: "mrad",
            1e-6: "urad",
            _DEGREE: "deg degs degree degrees degres grados gradi graus graden",
        },
        **{
            _DEGREE / 1e3: "mdeg",
            _DEGREE / 100: "cdeg",
            _DEGREE / 1e6: "udeg microdeg",
            _DEGREE / 60: "arcmin",
            _DEGREE / 3600: "arcsec",
        },
        **{
            _DEGREE / 3.6e6: "mas",
            2 * math.pi: "rev revolutions turn turns",
            math.pi / 200: "gon gradian gradians",
        },
    },
}
BASES = {
    word: (kind, factor)
    for kind, words in _BASE_WORDS.items()
    for factor, text in words.items()
    for word in text.split()
}
SECONDS = frozenset(_BASE_WORDS["T"][1.0].split())
PARTS_OF_SECONDS = {w: f for w, (kind, f) in BASES.items() if kind == "T" and f < 1}
_DIMENSIONS: dict[tuple[int, int, int], UnitDimension] = {
    (1, 0, 0): "length",
    (0, 1, 0): "time",
    (0, 0, 1): "angle",
    (1, -1, 0): "speed",
    (1, -2, 0): "acceleration",
    (0, -1, 1): "rate",
}
_MORE: tuple[tuple[UnitDimension, float, str], ...] = (
    ("acceleration", G, "g g0 gs g's gee"),
    ("acceleration", G / 1e3, "mg milli-g millig"),
    ("acceleration", G / 1e6, "ug micro-g"),
    ("acceleration", 0.01, "gal gals"),
    ("acceleration", 1e-5, "mgal"),
    ("acceleration", 0.01, "cms2 cmps2 cmss"),
    ("acceleration", 1.0, "mps2 ms2 mpss ms-2 ms^-2 mpersec2"),
    ("acceleration", 0.3048, "fps2"),
    ("rate", _DEGREE, "dps degps degs degsec degpersec"),
    ("rate", _DEGREE / 1e3, "mdps"),
    ("rate", _DEGREE / 100, "cdps"),
    ("rate", _DEGREE / 3600, "dph"),
    ("rate", 1.0, "radps rads radsec radpersec"),
    ("rate", 1e-3, "mradps"),
    ("rate", math.pi / 30, "rpm"),
    ("speed", 1.0, "mps"),
    ("speed", 1 / 3.6, "kmh kmph kph"),
    ("speed", 0.44704, "mph"),
    ("speed", 1852 / 3600, "kn kt kts knot knots"),
    ("speed", 0.3048, "fps"),
    ("speed", 0.01, "cmps"),
    ("speed", 1e-3, "mmps"),
    ("angle", math.pi / 2**31, "semicircle semicircles"),
    ("angle", _DEGREE * 1e-7, "dege7 deg_e7 1e-7deg deg1e-7 1e7deg deg1e7 deg*1e7 deg*1e-7 e7 1e7 1e-7"),
    ("angle", _DEGREE / 60, "' ′ arcminute arcminutes"),
    ("angle", _DEGREE / 3600, "\" ″ '' arcsecond arcseconds"),
)
_WORDS: dict[str, tuple[UnitDimension, float]] = {
    word: (dimension, factor) for dimension, factor, text in _MORE for word in text.split()
}
# Units of latitude and longitude per degree, from the largest
PER_DEGREE = {
    **{"1": " for degrees", "60": " for arcminutes", "3600": " for arcseconds", "1e5": "", "1e6": ""},
    **{"3.6e6": " for milliarcseconds", "1e7": ""},
}
# Words in brackets that are not units
NOT_UNITS = (
    "",
    *("-", "1", "unitless", "dimensionless", "utc", "gps", "gnss", "wgs84", "enu"),
    *("unix", "unix time", "unixtime", "epoch"),
    *("local", "body", "fix", "n", "e", "x", "y", "z", "north", "east", "up", "lat", "lon", "imu"),
)
COUNTS = ("lsb", "lsbs", "counts", "count", "adc", "raw", "ticks", "bits", "digits")
_PLAIN = str.maketrans(
    {"é": "e", "µ": "u", "μ": "u", "²": "2", "°": "deg", "·": " ", "⋅": " ", "−": "-", "⁻": "-", "¹": "1"}
)
# A sign of division, a base unit with its power, or a sign of multiplication
_TOKEN = re.compile(r"(/|per\b)|([a-z]+)\s*((?:\^|\*\*)?\s*-?\s*\d)?|([*.\s])")


@dataclass(frozen=True)
class Unit:
    """A unit as written, its dimension, and its factor to SI units (None and 0 for an unknown unit)."""

    text: str
    dimension: UnitDimension | None
    factor: float

    @property
    def known(self) -> bool:
        return self.dimension is not None


def parse_unit(text: str) -> Unit | None:
    """Parse a unit. Return a `Unit` without dimension for an unknown unit, and None for text that is no unit."""
    plain = text.strip().lower().translate(_PLAIN)
    if plain in NOT_UNITS:
        return None
    if len(plain) > MAX_LENGTH:
        return Unit(text, None, 0.0)
    if (word := _WORDS.get(re.sub(r"[\s^]", "", plain))) is not None:
        return Unit(text, *word)
    if parts := re.fullmatch(r"(\d+(?:\.\d+)?(?:e-?\d+)?) *([^\d.].*)", plain):  # 0.001 s, 10us
        whole, factor = parse_unit(parts[2]), float(parts[1])
        if not 0 < factor < math.inf:
            return Unit(text, None, 0.0)
        if factor < 1 or (whole and whole.dimension == "time"):  # "16 g" is the range of a sensor
            return whole and Unit(text, whole.dimension, factor * whole.factor)
    powers, factor, sign, at = {"L": 0, "T": 0, "A": 0}, 1.0, 1, 0
    while at < len(plain):
        token = _TOKEN.match(plain, at)
        if token is None or (token[2] and token[2] not in BASES):
            return Unit(text, None, 0.0)
        at = token.end()
        if token[1]:
            sign = -1
        elif token[2]:
            kind, base = BASES[token[2]]
            power = sign * int(re.sub(r"[^\d-]", "", token[3] or "1"))
            powers[kind] += power
            factor *= base**power
    dimension = _DIMENSIONS.get((powers["L"], powers["T"], powers["A"]))
    return Unit(text, dimension, factor if dimension else 0.0)


def may_be_gradians(unit: Unit) -> bool:
    """Return True for "grad" and its short forms, which mean degrees in some languages and gradians in others."""
    return re.match(r"gr(?:ad[es]?)?(?![a-z])", unit.text.strip().lower()) is not None


def possible_units(lat: float, lon: float) -> list[str]:
    """Return the possible units of latitude and longitude with these magnitudes, as units per degree, largest first."""
    return [k for k in PER_DEGREE if lat <= 90 * float(k) and lon <= 360 * float(k)]


def other_units(role: str, texts: Sequence[str], possible: Sequence[str]) -> str:
    """Return options for latitude and longitude, written as ``texts``, in the largest of the possible units."""
    options: list[str] = []
    for k in possible[:3] or ["1e7"]:
        per = "" if k == "1" else f"/{k}"
        maps = (f'"{role}.{n}={t}{per}"' for n, t in zip(("lat", "lon"), texts, strict=True))
        options.append(" ".join(["--map", *maps]) + PER_DEGREE[k])
    return f"{' or '.join(options)} (or another factor)"


def factor_of(text: str) -> float:
    """Return the factor of a known unit to SI units."""
    unit = parse_unit(text)
    return unit.factor if unit else 1.0


def in_si(unit: Unit, text: str) -> str:
    if unit.dimension in ("rate", "angle") and math.isclose(unit.factor, _DEGREE, rel_tol=1e-12):
        return f"radians({text})"
    if unit.dimension in ("rate", "angle"):
        of_degree = _times("{}", unit.factor / _DEGREE)
        if of_degree and unit.factor < _DEGREE:
            return f"radians({of_degree.format(text)})"
    if unit.dimension == "acceleration" and math.isclose(unit.factor, G):
        return f"{text}*9.80665"
    return scaled(text, unit.factor)


def scaled(text: str, factor: float) -> str:
    """Write an expression times a factor."""
    if math.isclose(factor, 1.0):
        return text
    return _times(text, factor) or f"{text}*{factor!r}"


def _times(text: str, factor: float) -> str:
    """Return ``text`` times ``factor``, as ``*1eN`` or as a division by a short number; "" if this is inexact."""
    power, inverse = round(math.log10(factor)), 1 / factor
    if math.isclose(factor, 10.0**power, rel_tol=1e-12):
        return f"{text}*1e{power}"
    short = inverse > 1 and math.isclose(inverse, float(f"{inverse:.6g}"), rel_tol=1e-12)
    return f"{text}/{inverse:.6g}" if short else ""
