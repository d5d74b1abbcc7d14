"""The box that is searched, and the way from a point in it to filter parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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
    lowest, highest : ndarray, shape (d,)
        Bounds of the parameters themselves.
    logarithmic : ndarray of bool, shape (d,)
        Which of them are searched in log10.
    nominal_interval : float or None
        s: the interval that Q refers to, passed on to the parameters.
    """

    model: ModelName
    names: tuple[str, ...]
    lowest: Array
    highest: Array
    logarithmic: NDArray[np.bool_]
    nominal_interval: float | None = None

    @property
    def low(self) -> Array:
        """Lower bounds in search coordinates, shape (d,)."""
        return self._encode(self.lowest)

    @property
    def high(self) -> Array:
        """Upper bounds in search coordinates, shape (d,)."""
        return self._encode(self.highest)

    def decode(self, points: Array) -> list[FilterParameters]:
        """Parameters of points in the box, shape (n, d), in search coordinates."""
        n = len(STATE_NAMES[self.model])
        powers = 10.0 ** np.where(self.logarithmic, points, 0.0)
        # 10**-5.0 is a last bit away from 1e-5: clip, so that nothing lies outside the box.
        values = np.clip(np.where(self.logarithmic, powers, points), self.lowest, self.highest)
        return [
            FilterParameters(
                *v[:3],
                process_noise=v[3 : 3 + n],
                measurement_noise=v[3 + n :],
                model=self.model,
                nominal_interval=self.nominal_interval,
            )
            for v in values.tolist()
        ]

    def touched(self, point: Array) -> list[str]:
        """Which parameters lie on a bound of the box, as ``name at its lower bound (value)``."""
        margin = 1e-9 * (self.high - self.low)
        sides = (("lower", self.low, self.lowest), ("upper", self.high, self.highest))
        return [
            f"{self.names[i]} at its {side} bound ({value[i]:g})"
            for side, bound, value in sides
            for i in np.flatnonzero(np.abs(point - bound) <= margin)
        ]

    def _encode(self, values: Array) -> Array:
        return np.where(self.logarithmic, np.log10(np.where(self.logarithmic, values, 1.0)), values)


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
    lowest, highest = np.array(ranges).T
    logarithmic = np.array([False] * 3 + [scale == "log10"] * (len(states) + 2))
    return SearchSpace(model, names, lowest, highest, logarithmic, nominal_interval)
