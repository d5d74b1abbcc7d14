"""Racing: a candidate with a high cost on the first drives is not tried on the others.

Successive halving (K. Jamieson and A. Talwalkar, Non-stochastic best arm identification and hyperparameter
optimization, AISTATS 2016) with drives as the resource: a batch of candidates is tried on one drive, the better half of
it on two, the better half of those on four, and so on, until all drives are reached. Racing candidates over instances
is the idea of M. Birattari, T. Stuetzle, L. Paquete and K. Varrentrapp (A racing algorithm for configuring
metaheuristics, GECCO 2002): their F-race drops candidates by a test; here a fixed share is dropped, so that the number
of steps is known in advance.

With many drives (`MANY`), halving alone saves little: filters run in parallel, and a single remaining one takes as long
as eight on all drives. Then a batch also races against the best so far, whose cost on each drive is known. It begins
with a twelfth of the drives. Of the better half only those continue that are better than the best on the same drives by
more than a standard error of the mean difference. Without any, the race ends. The costs of the best on these drives and
on all measure their difficulty, so that a dropped candidate's cost is extrapolated to all drives (a control variate).
Beginning with a 32nd of the drives is faster, but the costs of the dropped candidates then mislead the search.

The drives are taken in another order for each batch, so that no drive decides alone. A candidate that reaches all
drives has its full cost. A dropped one gets the cost on its drives so far, and all that were dropped together are
raised above the last that continued: they keep their order, and none of them can become the best.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.problem import Problem

FIRST = 12
"""A race against the best point so far begins with this part of the drives."""
MANY = 96
"""Least number of drives of such a race; with fewer, a part is too small for a test."""
Order = Sequence[int] | NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Leader:
    """The best candidate so far: its cost, and its cost on each drive, (m,)."""

    cost: float
    each: Array


@dataclass(frozen=True, eq=False)
class Raced:
    """Costs (n,) of a batch of candidates, and the work they took.

    Costs of those that reached all drives are full. ``steps`` were spent, ``failures`` failed on a drive that they were
    tried on. ``leader`` is the best so far, after this batch; None as long as all failed.
    """

    costs: Array
    steps: int
    failures: int
    leader: Leader | None = None

    def __add__(self, other: "Raced") -> "Raced":
        """Join two consecutive batches."""
        costs = np.concatenate([self.costs, other.costs])
        return Raced(costs, self.steps + other.steps, self.failures + other.failures, other.leader)


def rungs(n_candidates: int, n_drives: int) -> list[tuple[int, int]]:
    """Return the rungs (candidates, drives): half as many on twice as many, up to all drives."""
    found = [(n_candidates, n_drives // FIRST if n_drives >= MANY else min(1, n_drives))]
    while (drives := found[-1][1]) < n_drives:
        found.append(((found[-1][0] + 1) // 2, min(2 * drives, n_drives)))
    return found


def leader_at(problem: Problem[Any], point: Array, executor: Executor | None) -> Leader:
    """Run the best point so far, shape (d,), again: a resumed search does not know its costs on each drive."""
    each = problem.each(point[np.newaxis], range(len(problem.steps)), executor)
    return Leader(float(problem.mean(each)[0]), each[0])


def race(
    problem: Problem[Any],
    points: Array,
    order: Order,
    executor: Executor | None,
    leader: Leader | None = None,
) -> Raced:
    """Try points, shape (n, d), on the drives in that order, and drop the worse half at each rung.

    With many drives they race against ``leader``; without one, or with a single point, all are tried on all drives.
    """
    order = np.asarray(order)
    many, n, m = len(order) >= MANY, len(points), len(order)
    rival = leader if many and n > 1 else None
    each, costs = np.empty((n, 0)), np.full(n, np.inf)
    alive, dropped, steps = np.arange(n), list[NDArray[np.int64]](), 0
    for candidates, drives in [(n, m)] if many and not rival else rungs(n, m):
        seen, fresh = order[: each.shape[1]], order[each.shape[1] : drives]
        ranked = alive[np.argsort(costs[alive], kind="stable")]
        kept = ranked[:candidates]
        if rival and len(seen):
            kept = kept[_ahead(each[kept], costs[kept], rival, seen)]
        alive = np.sort(kept)
        dropped.append(ranked[~np.isin(ranked, kept)])
        if not len(alive):
            break
        column = np.full((n, len(fresh)), np.nan)
        column[alive] = problem.each(points[alive], fresh.tolist(), executor)
        each = np.hstack([each, column])
        steps += len(alive) * int(problem.steps[fresh].sum())
        costs[alive] = problem.mean(_in_order(each[alive], order[:drives]))
        if rival and drives < m:  # how much harder or easier these drives are than all
            costs[alive] += rival.cost - problem.mean(rival.each[np.newaxis, np.sort(order[:drives])])[0]
    failures = int(np.isinf(costs).sum())
    costs = _behind(costs, alive, dropped, rival.cost if rival else np.inf)
    if not many:
        return Raced(costs, steps, failures)
    if len(alive):
        best = int(alive[np.argmin(costs[alive])])
        if costs[best] < (leader.cost if leader else np.inf):  # at equal costs the leader stays
            leader = Leader(float(costs[best]), _in_order(each, order)[best])
    return Raced(costs, steps, failures, leader)


def _ahead(each: Array, costs: Array, rival: Leader, seen: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Select those better than the best one on the same drives by more than a standard error of the mean difference."""
    with np.errstate(invalid="ignore"):  # a failed candidate's
        spread = (each - rival.each[seen]).std(axis=1, ddof=1)
    return costs + spread / np.sqrt(len(seen)) < rival.cost


def _in_order(each: Array, order: NDArray[np.int64]) -> Array:
    """Sort the columns into the drives' own order, since a sum's last bits depend on it and on the layout."""
    return np.ascontiguousarray(each[:, np.argsort(order[: each.shape[1]], kind="stable")])


def _behind(
    costs: Array, finished: NDArray[np.int64], dropped: list[NDArray[np.int64]], otherwise: float
) -> Array:
    """Raise the costs of dropped candidates, the last group first, above the worst of those that continued.

    Without a finished candidate they are raised above ``otherwise``: the best so far, or infinity if all failed, since
    no candidate may win on fewer drives.
    """
    shifted, floor = costs.copy(), _highest(costs[finished], otherwise)
    for group in reversed(dropped):
        best = float(costs[group].min(initial=np.inf))
        raised = costs[group] + max(floor - best, 0.0) if np.isfinite(best) else costs[group]
        shifted[group] = np.nextafter(np.maximum(raised, floor), np.inf)
        floor = _highest(shifted[group], otherwise=floor)
    return shifted


def _highest(costs: Array, otherwise: float) -> float:
    """Return the highest finite cost."""
    finite = costs[np.isfinite(costs)]
    return float(finite.max()) if len(finite) else otherwise
