"""Race candidates: evaluate all candidates on a few drives, and only the better candidates on more drives.

This is successive halving (K. Jamieson and A. Talwalkar, AISTATS 2016) with drives as the resource: each rung drops the
worse half of the candidates. In F-race (M. Birattari et al., GECCO 2002), a statistical test decides how many
candidates are dropped.

One filter takes as long as eight filters that run in one vector, so the last candidate of a race is expensive. With
many drives, a candidate must therefore also be better than the leader, the best candidate so far. The leader's costs
are a control variate for the costs of dropped candidates. A race that starts with 1/32 instead of 1/12 of the drives is
faster, but its costs mislead the search.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Mask
from sigmaswarm.tuning.problem import Problem

FIRST_DIVISOR = 12  # a race on MIN_RACED_DRIVES or more drives starts with 1 / FIRST_DIVISOR of them
MIN_RACED_DRIVES = 96
"""Smallest number of drives for a race against the leader; 1/12 of fewer drives is too small a sample for a test."""
Order = Sequence[int] | NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Leader:
    """Total cost of the best candidate so far, and its cost on each drive, shape (m,)."""

    cost: float
    each: Array


@dataclass(frozen=True, eq=False)
class RaceResult:
    """Costs of a batch, shape (n,), number of filter steps, and number of failures.

    Costs are exact for candidates that were evaluated on all drives.
    """

    costs: Array
    steps: int
    failures: int
    leader: Leader | None = None

    def __add__(self, other: "RaceResult") -> "RaceResult":
        costs = np.concatenate([self.costs, other.costs])
        return RaceResult(costs, self.steps + other.steps, self.failures + other.failures, other.leader)


def rungs(n_candidates: int, n_drives: int) -> list[tuple[int, int]]:
    """Return numbers of candidates and drives per rung; each rung halves the candidates and doubles the drives."""
    rungs = [(n_candidates, n_drives // FIRST_DIVISOR if n_drives >= MIN_RACED_DRIVES else min(1, n_drives))]
    while (drives := rungs[-1][1]) < n_drives:
        rungs.append(((rungs[-1][0] + 1) // 2, min(2 * drives, n_drives)))
    return rungs


def leader_at(problem: Problem[Any], point: Array, executor: Executor | None) -> Leader:
    """Evaluate the best point, shape (d,), again, since checkpoints lack its cost on each drive."""
    each = problem.each(point[np.newaxis], range(len(problem.steps)), executor)
    return Leader(float(problem.mean(each)[0]), each[0])


def race(
    problem: Problem[Any],
    points: Array,
    order: Order,
    executor: Executor | None,
    leader: Leader | None = None,
) -> RaceResult:
    """Evaluate points, shape (n, d), on the drives in the given order, and drop the worse half at each rung.

    With `MIN_RACED_DRIVES` or more drives, points that are not better than ``leader`` by one standard error are also
    dropped; if there is no leader or only one point, no point is dropped.
    """
    order = np.asarray(order)
    many, n, m = len(order) >= MIN_RACED_DRIVES, len(points), len(order)
    rival = leader if many and n > 1 else None
    each, costs = np.empty((n, 0)), np.full(n, np.inf)
    alive, dropped, steps = np.arange(n), list[NDArray[np.int64]](), 0
    for candidates, drives in [(n, m)] if many and not rival else rungs(n, m):
        compared, fresh = order[: each.shape[1]], order[each.shape[1] : drives]
        ranked = alive[np.argsort(costs[alive], kind="stable")]
        kept = ranked[:candidates]
        if rival and len(compared):
            kept = kept[_ahead(each[kept], costs[kept], rival, compared)]
        alive = np.sort(kept)
        dropped.append(ranked[~np.isin(ranked, kept)])
        if not len(alive):
            break
        column = np.full((n, len(fresh)), np.nan)
        column[alive] = problem.each(points[alive], fresh.tolist(), executor)
        each = np.hstack([each, column])
        steps += len(alive) * int(problem.steps[fresh].sum())
        costs[alive] = problem.mean(_in_order(each[alive], order[:drives]))
        if rival and drives < m:  # the drives so far may be harder or easier than average
            costs[alive] += rival.cost - problem.mean(rival.each[np.newaxis, np.sort(order[:drives])])[0]
    failures = int(np.isinf(costs).sum())
    costs = _behind(costs, alive, dropped, rival.cost if rival else np.inf)
    if not many:
        return RaceResult(costs, steps, failures)
    if len(alive):
        best = int(alive[np.argmin(costs[alive])])
        if costs[best] < (leader.cost if leader else np.inf):  # at equal costs the leader stays
            leader = Leader(float(costs[best]), _in_order(each, order)[best])
    return RaceResult(costs, steps, failures, leader)


def _ahead(each: Array, costs: Array, rival: Leader, drives: NDArray[np.int64]) -> Mask:
    """Select candidates that are better than the leader by more than one standard error of the difference."""
    with np.errstate(invalid="ignore"):  # a failed candidate has infinite costs
        std = (each - rival.each[drives]).std(axis=1, ddof=1)
    return costs + std / np.sqrt(len(drives)) < rival.cost


def _in_order(each: Array, order: NDArray[np.int64]) -> Array:
    """Sort columns by drive into a C-contiguous array: the rounding of sums depends on order and memory layout."""
    return np.ascontiguousarray(each[:, np.argsort(order[: each.shape[1]], kind="stable")])


def _behind(
    costs: Array, finished: NDArray[np.int64], dropped: list[NDArray[np.int64]], otherwise: float
) -> Array:
    """Raise the costs of dropped candidates above those of finished candidates, or above ``otherwise``."""
    shifted, floor = costs.copy(), _highest(costs[finished], otherwise)
    for group in reversed(dropped):
        best = float(costs[group].min(initial=np.inf))
        raised = costs[group] + max(floor - best, 0.0) if np.isfinite(best) else costs[group]
        shifted[group] = np.nextafter(np.maximum(raised, floor), np.inf)
        floor = _highest(shifted[group], otherwise=floor)
    return shifted


def _highest(costs: Array, otherwise: float) -> float:
    finite = costs[np.isfinite(costs)]
    return float(finite.max()) if len(finite) else otherwise
