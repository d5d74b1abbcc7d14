"""The bounds and the coordinates of a search space."""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, cast

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Mask
from sigmaswarm.filters.parameters import NOISES
from sigmaswarm.tuning.config import Scale

BoundSide = Literal["lower", "upper"]


@dataclass(frozen=True)
class TouchedBound:
    """A parameter whose value is at a bound. ``str`` gives the text in files: ``q_x at its lower bound (1e-05)``."""

    parameter: str
    end: BoundSide
    value: float

    @property
    def place(self) -> str:
        return f"at its {self.end} bound ({self.value:g})"

    def __str__(self) -> str:
        return f"{self.parameter} {self.place}"

    @classmethod
    def read(cls, text: Any) -> "TouchedBound":
        """Parse the text of a `TouchedBound`. Return a `TouchedBound` unchanged."""
        if isinstance(text, cls):
            return text
        match = re.fullmatch(r"(.+) at its (lower|upper) bound \((\S+)\)", str(text))
        if not match:
            raise ValueError(
                f"{text!r} is not a parameter at a bound, such as 'q_x at its lower bound (1e-05)'"
            )
        name, end, value = match.groups()
        return cls(name, cast(BoundSide, end), float(value))


@dataclass(frozen=True)
class Dimension:
    """One tuned parameter: its field of `FilterParameters`, and its range.

    - ``entries``: number of entries to which the parameter applies, if the field is a tuple; 0 if the field is a
      number.
    - ``logarithmic``: True if the range spans powers of ten.
    - ``inflation``: decades by which the parameter increases per decade of the inflation factor (`tuning.inflation`).
    - ``least``: lower limit after inflation.
    - ``typical``: mean and standard deviation of the prior (in decades, if ``logarithmic``); None without a prior.
    """

    name: str
    field: str
    entries: int
    lowest: float
    highest: float
    logarithmic: bool = True
    inflation: float = 0.0
    least: float = -math.inf
    typical: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of d parameters, in the parameters' units and in search coordinates; arrays have shape (d,)."""

    dimensions: tuple[Dimension, ...]
    scale: Scale

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(d.name for d in self.dimensions)

    @cached_property
    def lowest(self) -> Array:
        """Lower bounds in units of the parameters."""
        return np.array([d.lowest for d in self.dimensions], dtype=np.float64)

    @cached_property
    def highest(self) -> Array:
        return np.array([d.highest for d in self.dimensions], dtype=np.float64)

    @cached_property
    def _spans_decades(self) -> Mask:
        return np.array([d.logarithmic for d in self.dimensions])

    @cached_property
    def logarithmic(self) -> Mask:
        return self._spans_decades & (self.scale == "log10")

    @cached_property
    def low(self) -> Array:
        """Lower bounds in search coordinates."""
        return self._encode(self.lowest)

    @cached_property
    def high(self) -> Array:
        return self._encode(self.highest)

    @property
    def noises(self) -> Mask:
        return np.array([d.field in NOISES for d in self.dimensions])

    @property
    def inflation(self) -> Array:
        return np.array([d.inflation for d in self.dimensions])

    @property
    def least(self) -> Array:
        """Lower limits after inflation, in search coordinates."""
        return self._encode(np.maximum([d.least for d in self.dimensions], self.lowest))

    def distance(self, points: Array) -> Array:
        """Return half the squared distances, shape (n,), of points, shape (n, d), from the typical values.

        Each coordinate is divided by its standard deviation. In a linear search, parameters whose range spans powers of
        ten have no prior and are not counted.
        """
        known = np.array([d.typical is not None for d in self.dimensions]) & (
            self.logarithmic | ~self._spans_decades
        )
        typical, std = np.array([d.typical or (1.0, np.inf) for d in self.dimensions]).T
        off = (points - self._encode(typical)) / std
        return 0.5 * np.sum(np.where(known, off, 0.0) ** 2, axis=1)

    def values(self, points: Array) -> Array:
        """Convert points, shape (..., d), from search coordinates to values of the parameters."""
        values = np.where(self.logarithmic, 10.0 ** np.where(self.logarithmic, points, 0.0), points)
        # 10**-5.0 differs from 1e-5 in the last bit, so values of points within the bounds are clipped
        inside = (points >= self.low) & (points <= self.high)
        return np.where(inside, np.minimum(np.maximum(values, self.lowest), self.highest), values)

    def touched(self, point: Array) -> list[TouchedBound]:
        margin = 1e-9 * (self.high - self.low)
        ends: tuple[tuple[BoundSide, Array, Array], ...] = (
            ("lower", self.low, self.lowest),
            ("upper", self.high, self.highest),
        )
        return [
            TouchedBound(self.names[i], end, float(value[i]))
            for end, bound, value in ends
            for i in np.flatnonzero(np.abs(point - bound) <= margin)
        ]

    def _encode(self, values: Array) -> Array:
        return np.where(self.logarithmic, np.log10(np.where(self.logarithmic, values, 1.0)), values)
