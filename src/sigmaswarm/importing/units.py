"""Units in the names of columns: their dimensions, and their factors to SI.

A unit is a product of powers of base units, as m/s^2, deg/sec, rad s^-1 or mm/s/s, or one of a few words, as knots.
"""

import math
import re
from dataclasses import dataclass
from typing import Literal

Dimension = Literal["time", "acceleration", "rate", "angle", "length", "speed"]

G = 9.80665
"""m/s2."""
LONGEST = 40
"""Characters of a unit."""

_LENGTHS = {
    **{"m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "km": 1e3, "cm": 1e-2},
    **{"mm": 1e-3, "um": 1e-6},
    **{"ft": 0.3048, "feet": 0.3048, "foot": 0.3048, "in": 0.0254, "inch": 0.0254, "yd": 0.9144, "mi": 1609.344},
    **{"mile": 1609.344, "miles": 1609.344, "nmi": 1852.0, "nm": 1852.0, "dm": 0.1},
}  # fmt: skip
_TIMES = {
    **{"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "millis": 1e-3},
    **{"milliseconds": 1e-3, "us": 1e-6, "usec": 1e-6, "micros": 1e-6, "microseconds": 1e-6, "ns": 1e-9, "nsec": 1e-9},
    **{"nanos": 1e-9, "nanoseconds": 1e-9, "nanosec": 1e-9, "nsecs": 1e-9, "secs": 1.0, "min": 60.0, "minutes": 60.0},
    **{"minute": 60.0, "h": 3600.0, "hr": 3600.0, "hour": 3600.0, "hours": 3600.0, "d": 86400.0, "day": 86400.0},
    **{"days": 86400.0, "millisecond": 1e-3, "microsecond": 1e-6, "nanosecond": 1e-9, "mins": 60.0, "hrs": 3600.0},
}  # fmt: skip
_DEGREE = math.pi / 180
_ANGLES = {
    **{"rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": _DEGREE, "degs": _DEGREE},
    **{"degree": _DEGREE, "degrees": _DEGREE, "mdeg": _DEGREE / 1e3, "rev": 2 * math.pi, "turn": 2 * math.pi},
    **{"revolutions": 2 * math.pi, "turns": 2 * math.pi, "gon": math.pi / 200, "arcsec": _DEGREE / 3600},
    **{"arcmin": _DEGREE / 60, "cdeg": _DEGREE / 100},
}  # fmt: skip
_BASES = {
    **{name: ("L", factor) for name, factor in _LENGTHS.items()},
    **{name: ("T", factor) for name, factor in _TIMES.items()},
    **{name: ("A", factor) for name, factor in _ANGLES.items()},
}
_DIMENSIONS: dict[tuple[int, int, int], Dimension] = {
    (1, 0, 0): "length",
    (0, 1, 0): "time",
    (0, 0, 1): "angle",
    (1, -1, 0): "speed",
    (1, -2, 0): "acceleration",
    (0, -1, 1): "rate",
}
"""Powers of length, time and angle."""
_WORDS: dict[str, tuple[Dimension, float]] = {
    **{name: ("acceleration", factor) for name, factor in
       {"g": G, "g0": G, "gs": G, "gee": G, "mg": G / 1e3, "milli-g": G / 1e3, "millig": G / 1e3, "ug": G / 1e6,
        "micro-g": G / 1e6, "gal": 0.01, "gals": 0.01, "mgal": 1e-5, "mps2": 1.0, "ms2": 1.0, "mpss": 1.0, "ms-2": 1.0,
        "ms^-2": 1.0, "fps2": 0.3048}.items()},
    **{name: ("rate", factor) for name, factor in
       {"dps": _DEGREE, "mdps": _DEGREE / 1e3, "degps": _DEGREE, "degs": _DEGREE, "radps": 1.0, "rads": 1.0,
        "mradps": 1e-3, "rpm": math.pi / 30, "dph": _DEGREE / 3600, "cdps": _DEGREE / 100}.items()},
    **{name: ("speed", factor) for name, factor in
       {"mps": 1.0, "kmh": 1 / 3.6, "kmph": 1 / 3.6, "kph": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600,
        "kt": 1852 / 3600, "kts": 1852 / 3600, "knot": 1852 / 3600, "knots": 1852 / 3600, "fps": 0.3048, "cmps": 0.01,
        "mmps": 1e-3}.items()},
    **dict.fromkeys(("dege7", "deg_e7", "1e-7deg", "deg1e-7", "1e7deg", "deg1e7", "deg*1e7", "deg*1e-7", "e7"),
                    ("angle", _DEGREE * 1e-7)),
}  # fmt: skip
NONE = ("", "-", "1", "unitless", "dimensionless", "utc", "gps", "gnss", "wgs84", "enu", "unix", "epoch", "local",
        "body", "fix", "n", "e", "x", "y", "z", "north", "east", "up", "lat", "lon", "imu")  # fmt: skip
"""Words in brackets that are no unit."""
COUNTS = ("lsb", "lsbs", "counts", "count", "adc", "raw", "ticks", "bits", "digits")
"""Units of a sensor's raw counts."""


@dataclass(frozen=True)
class Unit:
    """A unit as it was written, its dimension, and the factor that makes it SI; 0 where the unit is unknown."""

    text: str
    dimension: Dimension | None
    factor: float

    @property
    def known(self) -> bool:
        """True if it can be converted."""
        return self.dimension is not None


def parse_unit(text: str) -> Unit | None:
    """The unit that a text states; None where it states none, an unknown one where it is no unit that is known."""
    plain = text.strip().lower().translate(str.maketrans({"µ": "u", "μ": "u", "²": "2", "°": "deg", "·": " ", "⋅": " ",
                                                          "−": "-", "⁻": "-", "¹": "1"}))  # fmt: skip
    if plain in NONE:
        return None
    if len(plain) > LONGEST:
        return Unit(text, None, 0.0)
    if (word := _WORDS.get(re.sub(r"[\s^]", "", plain))) is not None:
        return Unit(text, *word)
    powers, factor = {"L": 0, "T": 0, "A": 0}, 1.0
    sign = 1
    tokens = re.findall(r"[a-z]+|\d+|\S", plain)
    i = 0
    while i < len(tokens):
        token = tokens[i]
        i += 1
        if token in ("/", "per"):
            sign = -1
        elif token in _BASES:
            power = 1
            rest = "".join(tokens[i : i + 3])
            if exponent := re.match(r"(\^|\*\*)?(-?\d)", rest):
                power = int(exponent[2])
                i += len(re.findall(r"[a-z]+|\d+|\S", exponent[0]))
            kind, base = _BASES[token]
            powers[kind] += sign * power
            factor *= base ** (sign * power)
        elif token not in ("*", "."):
            return Unit(text, None, 0.0)
    dimension = _DIMENSIONS.get((powers["L"], powers["T"], powers["A"]))
    return Unit(text, dimension, factor if dimension else 0.0)


def in_si(unit: Unit, text: str) -> str:
    """The expression that makes a column's expression SI."""
    if math.isclose(unit.factor, 1.0):
        return text
    if unit.dimension in ("rate", "angle") and math.isclose(unit.factor, _DEGREE, rel_tol=1e-12):
        return f"radians({text})"
    if unit.dimension in ("rate", "angle"):
        of_degree = _times("{}", unit.factor / _DEGREE)
        if of_degree and unit.factor < _DEGREE:
            return f"radians({of_degree.format(text)})"
    if unit.dimension == "acceleration" and math.isclose(unit.factor, G):
        return f"{text}*9.80665"
    return _times(text, unit.factor) or f"{text}*{unit.factor!r}"


def _times(text: str, factor: float) -> str:
    """A text times a power of ten, or divided by a short number; empty where it is neither."""
    power, inverse = round(math.log10(factor)), 1 / factor
    if math.isclose(factor, 10.0**power, rel_tol=1e-12):
        return f"{text}*1e{power}"
    return (
        f"{text}/{inverse:.6g}"
        if inverse > 1 and math.isclose(inverse, float(f"{inverse:.6g}"), rel_tol=1e-12)
        else ""
    )
