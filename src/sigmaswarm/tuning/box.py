"""Bounds of the search space, and its coordinates."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array

BoxEnd = Literal["lower", "upper"]


@dataclass(frozen=True)
class TouchedBound:
    """A parameter that ended at a bound: the optimum may lie beyond it.

    Files hold its text: ``q_x at its lower bound (1e-05)``.
    """

    parameter: str
    end: BoxEnd
    value: float

    @property
    def place(self) -> str:
        """The bound, as text."""
        return f"at its {self.end} bound ({self.value:g})"

    def __str__(self) -> str:
        return f"{self.parameter} {self.place}"

    @classmethod
    def read(cls, text: Any) -> "TouchedBound":
        """Parse the text that ``str`` returns."""
        if isinstance(text, cls):
            return text
        found = re.fullmatch(r"(.+) at its (lower|upper) bound \((\S+)\)", str(text))
        if not found:
            raise ValueError(f"{text!r} does not name a parameter and the bound that it touches")
        name, end, value = found.groups()
        return cls(name, cast(BoxEnd, end), float(value))


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds of d parameters, and the coordinates in which they are searched.

    Attributes
    ----------
    names : tuple of str, length d
    lowest, highest : ndarray, shape (d,)
        Bounds of the parameters themselves.
    logarithmic : ndarray of bool, shape (d,)
        Which of them are searched in log10.
    """

    names: tuple[str, ...]
    lowest: Array
    highest: Array
    logarithmic: NDArray[np.bool_]

    @cached_property
    def low(self) -> Array:
        """Lower bounds in search coordinates, shape (d,)."""
        return self._encode(self.lowest)

    @cached_property
    def high(self) -> Array:
        """Upper bounds in search coordinates, shape (d,)."""
        return self._encode(self.highest)

    @property
    def noises(self) -> NDArray[np.bool_]:
        """Which parameters are noise variances, shape (d,); all of them times one factor scale the covariance."""
        return np.zeros(len(self.names), dtype=np.bool_)

    @property
    def inflation(self) -> Array:
        """Decades by which `tuning.inflation` raises each parameter per decade of its factor, shape (d,)."""
        return np.zeros(len(self.names))

    @property
    def least(self) -> Array:
        """Lower limits that `tuning.inflation` applies, in search coordinates, shape (d,)."""
        return self.low

    def values(self, points: Array) -> Array:
        """Convert points in search coordinates to parameters, shape (..., d)."""
        values = np.where(self.logarithmic, 10.0 ** np.where(self.logarithmic, points, 0.0), points)
        # 10**-5.0 differs from 1e-5 in the last bit: clip, so that no point leaves the bounds
        inside = (points >= self.low) & (points <= self.high)
        return np.where(inside, np.minimum(np.maximum(values, self.lowest), self.highest), values)

    def touched(self, point: Array) -> list[TouchedBound]:
        """List the parameters at a bound."""
        margin = 1e-9 * (self.high - self.low)
        ends: tuple[tuple[BoxEnd, Array, Array], ...] = (
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
