"""The columns of a table: their numbers without placeholders, and expressions that contain them."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import polars as pl

from sigmaswarm.importing.names import Name
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.units import Unit, UnitDimension, in_si, may_be_gradians, scaled
from sigmaswarm.wording import quoted


@dataclass(frozen=True)
class Conversion:
    """Expression that computes a column of a drive, and its assumption, or the reason not to use the expression."""

    expression: str
    note: str = ""  # an assumption
    fault: str = ""  # reason not to use the expression
    ticks: str = ""  # text of a counter whose unit is guessed from its steps


def refused(fault: str, ticks: str = "") -> Conversion:
    return Conversion("", fault=fault, ticks=ticks)


def scaled_column(text: str) -> tuple[str, float] | None:
    """Return the column of an expression ``column``, ``column*number`` or ``column/number``, and the factor."""
    plain = re.fullmatch(r"\s*(`[^`]+`|[A-Za-z_]\w*)\s*(?:\*\s*([\d.eE+-]+)|/\s*([\d.eE+-]+))?\s*", text)
    try:
        return plain and (plain[1], float(plain[2] or 1.0) / float(plain[3] or 1.0))
    except (ValueError, ZeroDivisionError):
        return None


def quoted_column(column: str) -> str:
    """Return the name of a column as it is written in an expression."""
    return column if re.fullmatch(r"[A-Za-z_]\w*", column) else f"`{column}`"


def column_numbers(values: pl.Series) -> pl.Series:
    """Return the numbers among the values of a column; empty for lists and bytes."""
    if values.dtype.is_nested() or isinstance(values.dtype, pl.Binary | pl.Object):
        return pl.Series([], dtype=pl.Float64)
    if values.dtype == pl.String:
        values = values.str.strip_chars()
    return values.cast(pl.Float64, strict=False).drop_nulls().drop_nans()


def median_of(values: pl.Series) -> float:
    return float(values.median() or 0.0)  # pyright: ignore[reportArgumentType]


def unknown_unit(name: Name, column: str, dimension: str, role: Role, likely: str = "") -> str:
    """Describe an unknown or wrong unit. ``likely`` is the likely expression in SI units, for the remedy."""
    unit, text = name.unit or Unit("", None, 0.0), quoted_column(name.column)
    kind = f"a unit of {unit.dimension}, not of {dimension}" if unit.known else "not known"
    message = f"column {quoted(name.column)}: the unit {quoted(unit.text)} is {kind}"
    if column in ("x", "y") and unit.dimension == "angle" and role != "imu":
        place, called = {"x": ("lon", "longitude"), "y": ("lat", "latitude")}[column]
        degrees = scaled(text, unit.factor * 180 / math.pi)
        return f'{message}; if it is a {called}, write --map "{role}.{place}={degrees}" "{role}.{column}="'
    possible = {"": likely or f"{text}*1.0"}
    if dimension == "rate" and unit.dimension == "angle":
        possible = {"": in_si(unit, text)}
    elif dimension == "rate" and may_be_gradians(unit):
        possible = {
            " if it is degrees per second": f"radians({text})",
            " if it is gradians per second": f"{text}*pi/200",
        }
    options = (f'--map "{role}.{column}={si}"{condition}' for condition, si in possible.items())
    return f"{message}; specify the factor to SI units, for example {', or '.join(options)}"


# Texts for a missing number: without letters and digits (---.---), or written by a C library or a spreadsheet
NO_NUMBER = r"^[^0-9A-Za-z]*$|#(?:IND|QNAN|SNAN|INF|N/A|NUM!|VALUE!|DIV/0!)"
PLACEHOLDERS = (
    *(-999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, 1e10, -1e10),
    *(32767.0, -32768.0, 2147483647.0, -2147483648.0),
)
# Smallest magnitude of placeholders such as 1e38 and the largest numbers of 32 and 64 bits; measurements in any unit
# are smaller
MIN_HUGE = 1e15
NO_VALUE = ("", "nan", "null", "none", "na", "n/a", "-", "\\n", "invalid", *("*" * n for n in range(1, 20)))
DIMENSIONS: dict[str, UnitDimension] = {
    **dict.fromkeys(("ax", "ay", "az"), "acceleration"),
    **dict.fromkeys(("gx", "gy", "gz"), "rate"),
    **dict.fromkeys(("lat", "lon", "course", "bearing", "theta", "std_heading"), "angle"),
    **dict.fromkeys(("alt", "x", "y", "std_x", "std_y"), "length"),
    **dict.fromkeys(("speed", "wheel_speed", "vx", "vy"), "speed"),
}
# Largest fraction of rows that may contradict the form of the other rows; such rows are presumably damaged
MAX_DAMAGED_SHARE = 0.02
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
Numbers = TypeVar("Numbers", pl.Series, pl.Expr)


def is_placeholder(numbers: Numbers) -> Numbers:
    """Mark finite numbers (float64) that usually stand for a missing value."""
    if isinstance(numbers, pl.Series):  # one query is quicker than one for each operation
        return numbers.to_frame().select(is_placeholder(pl.first())).to_series()
    return numbers.is_in(PLACEHOLDERS) | is_huge(numbers)


def is_huge(numbers: Numbers) -> Numbers:
    return numbers.abs().is_between(MIN_HUGE, math.inf, closed="left")


@dataclass
class Columns:
    frame: pl.DataFrame
    names: dict[str, Name] = field(default_factory=dict[str, Name])
    # expressions of latitude and longitude, deg, that are in several columns
    degrees: dict[str, str] = field(default_factory=dict[str, str])
    # Cached numbers, magnitudes and 99th percentiles of columns, since each axis of a sensor needs those of all axes
    _numbers: dict[str, pl.Series] = field(default_factory=dict[str, pl.Series], init=False)
    _norms: dict[tuple[str, ...], pl.Series] = field(
        default_factory=dict[tuple[str, ...], pl.Series], init=False
    )
    _largest: dict[str, float] = field(default_factory=dict[str, float], init=False)
    _wrapped: dict[str, bool] = field(default_factory=dict[str, bool], init=False)

    def __contains__(self, what: str) -> bool:
        return what in self.names

    def has(self, *whats: str) -> bool:
        return self.names.keys() >= set(whats)

    @property
    def located(self) -> bool:
        """True if the table has both coordinates of a position."""
        return self.has("lat", "lon") or self.has("x", "y")

    def numbers(self, what: str) -> pl.Series:
        """Return the numbers of a column, without placeholders."""
        column = self.names[what].column
        if column not in self._numbers:
            values = column_numbers(self._signed(what))
            self._numbers[column] = values.filter(~is_placeholder(values))
        return self._numbers[column]

    def largest(self, what: str) -> float:
        """Return the 99th percentile of a column's absolute values."""
        column = self.names[what].column
        if column not in self._largest:
            self._largest[column] = float(self.numbers(what).abs().quantile(0.99) or 0.0)
        return self._largest[column]

    def norms(self, axes: Sequence[str]) -> pl.Series:
        """Return the magnitudes of a vector, without placeholders and zeros; empty for fewer than three columns."""
        key = (*axes, *(self.names[a].column for a in axes))
        if key not in self._norms:
            self._norms[key] = self._norms_of(axes)
        return self._norms[key]

    def _norms_of(self, axes: Sequence[str]) -> pl.Series:
        series = [self._signed(a) for a in axes]
        if len(axes) < 3 or any(s.dtype.is_nested() for s in series):
            return pl.Series([], dtype=pl.Float64)
        known = [s.cast(pl.Float64, strict=False) for s in series]
        squares = [s.set(is_placeholder(s), None).pow(2) for s in known]
        sizes = sum(squares[1:], squares[0]).sqrt()
        return sizes.filter(sizes > 0)

    def has_unit(self, what: str) -> bool:
        unit = self.names[what].unit
        return unit is not None and unit.dimension == DIMENSIONS[what]

    def text(self, what: str) -> str:
        text = quoted_column(self.names[what].column)
        return f"where({text} > 32767, {text} - 65536, {text})" if self._is_unsigned(what) else text

    def _is_unsigned(self, what: str) -> bool:
        """Return True for signed 16-bit words that were written without a sign (-1 is 65535).

        One axis with values around 0 decides for all axes of a sensor, since an axis along gravity has no values around
        0.
        """
        if what not in AXES or not self._is_word(what):
            return False
        axes = [a for a in AXES if a[0] == what[0] and a in self and self._is_word(a)]
        return any(map(self._wraps, axes))

    def _is_word(self, what: str) -> bool:
        values = self.frame[self.names[what].column]
        if not values.dtype.is_integer():
            return False
        low, high = (float(values.quantile(q) or 0.0) for q in (0.0, 1.0))
        return low >= 0 and high < 65_536

    def _wraps(self, what: str) -> bool:
        """Return True for a column with numbers near 65536, and few numbers around 32768."""
        column = self.names[what].column
        if column not in self._wrapped:
            values = self.frame[column]
            middle = float(values.is_between(23_000, 42_000).mean() or 0)  # pyright: ignore[reportArgumentType]
            high = float(values.quantile(1.0) or 0.0)
            self._wrapped[column] = high > 59_000 and middle < MAX_DAMAGED_SHARE
        return self._wrapped[column]

    def _signed(self, what: str) -> pl.Series:
        values = self.frame[self.names[what].column]
        return (values.cast(pl.Int64) + 32_768) % 65_536 - 32_768 if self._is_unsigned(what) else values
