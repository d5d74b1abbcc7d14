"""The box that is searched, and the way from a point in it to filter parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import STATE_NAMES, FilterParameters, ModelName

Scale = Literal["log10", "linear"]

# The paper's box.
ALPHA_RANGE = (1e-3, 1.0)
BETA_RANGE = (0.0, 3.0)
KAPPA_RANGE = (0.0, 5.0)
VARIANCE_RANGE = (1e-5, 10.0)
"""Of every variance in Q (per nominal IMU step, SI units) and R (m2)."""


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """A box of filter parameters.

    Attributes
    ----------
    model : str
    names : tuple of str
        alpha, beta, kappa, one q per state, one r per measurement.
    low, high : ndarray, shape (d,)
        Bounds in search coordinates: log10 of the value where ``logarithmic``.
    logarithmic : ndarray of bool, shape (d,)
    nominal_interval : float or None
        s: the interval that Q refers to, passed on to the parameters.
    """

    model: ModelName
    names: tuple[str, ...]
    low: Array
    high: Array
    logarithmic: np.ndarray[tuple[int], np.dtype[np.bool_]]
    nominal_interval: float | None = None

    def decode(self, points: Array) -> list[FilterParameters]:
        """Parameters of points in the box, shape (n, d)."""
        n = len(STATE_NAMES[self.model])
        values = self._values(points)
        return [
            FilterParameters(
                float(v[0]),
                float(v[1]),
                float(v[2]),
                tuple(v[3 : 3 + n].tolist()),
                tuple(v[3 + n :].tolist()),
                self.model,
                nominal_interval=self.nominal_interval,
            )
            for v in values
        ]

    def touched(self, point: Array) -> list[str]:
        """Which parameters lie on a bound of the box, as ``name at its lower bound (value)``."""
        margin = 1e-9 * (self.high - self.low)
        found: list[str] = []
        for side, bound in (("lower", self.low), ("upper", self.high)):
            for i in np.flatnonzero(np.abs(point - bound) <= margin):
                found.append(f"{self.names[i]} at its {side} bound ({self._values(bound)[i]:g})")
        return found

    def _values(self, points: Array) -> Array:
        """Search coordinates to values; ten digits of log10 lose the last bit, so 10**-5 becomes 1e-5 again."""
        powers = 10.0 ** np.where(self.logarithmic, points, 0.0)
        return np.where(self.logarithmic, np.where(points == np.round(points), _tidy(powers), powers), points)


def search_space(model: ModelName, scale: Scale, nominal_interval: float | None = None) -> SearchSpace:
    """The paper's box for a model; ``scale`` says how variances are searched.

    Raises
    ------
    InputError
        If the scale is unknown.
    """
    if scale not in ("log10", "linear"):
        raise InputError(f"scale must be log10 or linear, not {scale!r}")
    states = STATE_NAMES[model]
    names = ("alpha", "beta", "kappa", *(f"q_{s}" for s in states), "r_x", "r_y")
    ranges: Sequence[tuple[float, float]] = [
        ALPHA_RANGE,
        BETA_RANGE,
        KAPPA_RANGE,
        *[VARIANCE_RANGE] * (len(states) + 2),
    ]
    low, high = np.array(ranges).T
    logarithmic = np.array([False] * 3 + [scale == "log10"] * (len(states) + 2))
    low[logarithmic], high[logarithmic] = np.log10(low[logarithmic]), np.log10(high[logarithmic])
    return SearchSpace(model, names, low, high, logarithmic, nominal_interval)
