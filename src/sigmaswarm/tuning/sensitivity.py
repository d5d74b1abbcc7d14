"""Sensitivity of the cost: how far each parameter can move before the cost rises by 1%.

One parameter moves at a time, so a parameter that looks well determined may still be traded for another. One such trade
is known and tried as well: all noise variances times one factor, which changes the covariance but hardly the estimates.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.box import Box
from sigmaswarm.tuning.problem import Problem

RISE = 0.01
"""Relative increase of the cost."""
HALVINGS = 10
"""The first step is the distance to the bound, halved so often; it is doubled until the bound is reached."""
NOISE_SCALE = "all noise variances times"


@dataclass(frozen=True)
class Sensitivity:
    """How far one parameter can move.

    Attributes
    ----------
    name : str
    value : float
        In the tuned filter; 1 for the factor of all noise variances.
    lowest, highest : float or None
        Where the cost has risen by 1%; None if it has not at the bound.
    lowest_rise : float
        Lowest relative change of the cost on the way; below 0 the search had not converged.
    """

    name: str
    value: float
    lowest: float | None
    highest: float | None
    lowest_rise: float = 0.0

    @property
    def identified(self) -> bool:
        """False if any value within the bounds does as well."""
        return self.lowest is not None or self.highest is not None


def sensitivities(
    problem: Problem[Any], point: Array, cost: float, executor: Executor | None
) -> tuple[Sensitivity, ...]:
    """Move each parameter of a tuned filter away from its value, both ways, until the cost has risen by 1%.

    Parameters
    ----------
    problem : Problem
    point : ndarray, shape (d,)
        The optimum, in search coordinates.
    cost : float
        There.
    executor : concurrent.futures.Executor or None
    """
    ways = list(_ways(problem.space, point))
    shares = np.array([0.5**k for k in range(HALVINGS, -1, -1)])
    points = np.concatenate([point + shares[:, None] * step for way in ways for step in (way.down, way.up)])
    tried, of = np.unique(points, axis=0, return_inverse=True)  # no way leads from a bound
    rises = problem.rise(problem.costs(tried, executor)[of], cost).reshape(len(ways), 2, len(shares))
    found = []
    for way, (falling, rising) in zip(ways, rises, strict=True):
        reached = (_crossing(shares, falling), way.down), (_crossing(shares, rising), way.up)
        lowest, highest = (None if s is None else way.value(point + s * step) for s, step in reached)
        least = float(min(falling.min(), rising.min(), 0.0))
        found.append(Sensitivity(way.name, way.value(point), lowest, highest, least))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Way:
    """A direction: the steps to its two bounds, and the parameter's value at a point."""

    name: str
    down: Array
    up: Array
    value: Callable[[Array], float]


def _ways(space: Box, point: Array) -> Iterator[_Way]:
    for i, name in enumerate(space.names):
        axis = np.where(np.arange(len(point)) == i, 1.0, 0.0)
        yield _Way(
            name,
            (space.low[i] - point[i]) * axis,
            (space.high[i] - point[i]) * axis,
            lambda p, i=i: float(space.values(p)[i]),
        )
    noises = space.logarithmic & space.noises
    if noises.any():
        # two decades each way, out of the box if need be: a variance at its bound would else hide the trade
        first = int(np.argmax(noises))
        together = np.where(noises, 2.0, 0.0)
        yield _Way(NOISE_SCALE, -together, together, lambda p: float(10 ** (p[first] - point[first])))


def _crossing(shares: Array, rise: Array) -> float | None:
    """Return the share of the way at which the cost has risen by 1%, linear between the steps, or None."""
    above = np.flatnonzero(~(rise < RISE))
    if not len(above):
        return None
    k = int(above[0])
    left, before = (0.0, 0.0) if k == 0 else (float(shares[k - 1]), float(rise[k - 1]))
    if not np.isfinite(rise[k]):
        return left
    return left + (float(shares[k]) - left) * (RISE - before) / (float(rise[k]) - before)
