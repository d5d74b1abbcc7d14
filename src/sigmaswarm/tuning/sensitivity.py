"""The range of each parameter in which the cost increases by less than 1%.

Only one parameter changes at a time, so trade-offs between parameters are not visible. The exception is a common factor
on all noise variances, which is varied like a parameter. For costs in nats, see `Objective.relative_increase`.
"""

from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.problem import Problem

MAX_INCREASE = 0.01
NOISE_SCALE = "all noise variances times"


@dataclass(frozen=True)
class Sensitivity:
    """Range of one parameter in which the cost increases by less than 1%.

    Attributes
    ----------
    name : str
    value : float
        Value in the tuned filter; 1 for the factor on all noise variances.
    lowest, highest : float or None
        Values at which the cost has increased by 1%; None if the range reaches the bound.
    lowest_rise : float
        Lowest relative change of the cost at the tried values; negative if the search had not converged.
    """

    name: str
    value: float
    lowest: float | None
    highest: float | None
    lowest_rise: float = 0.0

    @property
    def identified(self) -> bool:
        return self.lowest is not None or self.highest is not None


def sensitivities(
    problem: Problem[Any], point: Array, cost: float, executor: Executor | None
) -> tuple[Sensitivity, ...]:
    """Move each parameter in both directions from the best point, shape (d,), until the cost has increased by 1%."""
    space, names, axes = problem.space, [*problem.space.names], np.eye(len(point))
    down, up = ((bound - point)[:, np.newaxis] * axes for bound in (space.low, space.high))
    noises = space.logarithmic & space.noises
    if noises.any():
        # Two decades each way, also beyond the bounds; otherwise a variance at its bound would keep the factor at 1.
        together = np.where(noises, 2.0, 0.0)
        down, up = np.vstack([down, -together]), np.vstack([up, together])
        names.append(NOISE_SCALE)

    def value(k: int, at: Array) -> float:
        first = int(np.argmax(noises))
        return float(space.values(at)[k] if k < len(point) else 10 ** (at[first] - point[first]))

    shares = np.array([0.5**k for k in range(10, -1, -1)])  # fractions of the distance to the bound
    steps = np.stack([down, up], axis=1)
    points = (point + shares[:, np.newaxis] * steps[:, :, np.newaxis]).reshape(-1, len(point))
    # The points of a parameter at a bound repeat in this direction.
    tried, inverse = np.unique(points, axis=0, return_inverse=True)
    rises = problem.relative_increase(problem.costs(tried, executor)[inverse], cost)
    rises = rises.reshape(len(names), 2, len(shares))
    result: list[Sensitivity] = []
    for k, name in enumerate(names):
        reached = zip([_crossing(shares, rise) for rise in rises[k]], steps[k], strict=True)
        ends = [None if s is None else value(k, point + s * step) for s, step in reached]
        result.append(Sensitivity(name, value(k, point), *ends, lowest_rise=float(min(rises[k].min(), 0.0))))
    return tuple(result)


def _crossing(shares: Array, rise: Array) -> float | None:
    """Return the interpolated fraction of the distance at which the cost has increased by 1%; None if it has not."""
    above = np.flatnonzero(~(rise < MAX_INCREASE))
    if not len(above):
        return None
    k = int(above[0])
    share, before = (0.0, 0.0) if k == 0 else (float(shares[k - 1]), float(rise[k - 1]))
    if not np.isfinite(rise[k]):
        return share
    return share + (float(shares[k]) - share) * (MAX_INCREASE - before) / (float(rise[k]) - before)
