"""Racing: a candidate that does badly on the first drives is not tried on the others.

Successive halving (K. Jamieson and A. Talwalkar, Non-stochastic best arm identification and hyperparameter
optimization, AISTATS 2016) with drives as the resource: a batch of candidates is tried on one drive, the better half
of it on two, the better half of those on four, and so on, until all drives are reached. Racing candidates over
instances is the idea of M. Birattari, T. Stuetzle, L. Paquete and K. Varrentrapp (A racing algorithm for configuring
metaheuristics, GECCO 2002): their F-race drops a candidate by a test, here a fixed share goes, so that the steps are
known beforehand.

The drives are taken in another order for each batch, so that no drive decides alone. A candidate that went all the way
has its full cost. A dropped one is told the cost on the drives it has seen, and all that were dropped together are
shifted behind the last that went further: they keep their order, and none of them can become the best.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.problem import Landscape


@dataclass(frozen=True, eq=False)
class Raced:
    """What a batch of candidates is told, and what it took.

    Attributes
    ----------
    costs : ndarray, shape (n,)
        Full costs of those that went all the way; behind them, the others'.
    steps : int
        Filter steps spent.
    failures : int
        Candidates that failed on a drive they were tried on.
    """

    costs: Array
    steps: int
    failures: int

    def __add__(self, other: "Raced") -> "Raced":
        """Two batches after another."""
        costs = np.concatenate([self.costs, other.costs])
        return Raced(costs, self.steps + other.steps, self.failures + other.failures)


def rungs(n_candidates: int, n_drives: int) -> list[tuple[int, int]]:
    """How many candidates are tried on how many drives: half as many on twice as many, until it is all drives."""
    found, candidates, drives = [(n_candidates, min(1, n_drives))], n_candidates, 1
    while drives < n_drives:
        candidates, drives = (candidates + 1) // 2, min(2 * drives, n_drives)
        found.append((candidates, drives))
    return found


def race(
    problem: Landscape,
    points: Array,
    order: Sequence[int] | NDArray[np.int64],
    executor: Executor | None,
) -> Raced:
    """Try points, shape (n, d), on the drives in that order, and drop the worse half at each rung."""
    each = np.empty((len(points), 0))
    alive, dropped, steps = np.arange(len(points)), list[NDArray[np.int64]](), 0
    costs = np.full(len(points), np.inf)
    for candidates, drives in rungs(len(points), len(order)):
        ranked = alive[np.argsort(costs[alive], kind="stable")]
        alive, out = np.sort(ranked[:candidates]), ranked[candidates:]
        dropped.append(out)
        fresh = [int(i) for i in order[each.shape[1] : drives]]
        column = np.full((len(points), len(fresh)), np.nan)
        column[alive] = problem.each(points[alive], fresh, executor)
        each = np.hstack([each, column])
        steps += len(alive) * int(problem.steps[fresh].sum())
        costs[alive] = problem.mean(_in_order(each[alive], order[:drives]))
    failures = int(np.isinf(costs).sum())
    return Raced(_behind(costs, alive, dropped), steps, failures)


def _in_order(each: Array, order: Sequence[int] | NDArray[np.int64]) -> Array:
    """The columns in the drives' own order: a sum's last bits depend on it, and a full cost is to have all of them."""
    return np.ascontiguousarray(each[:, np.argsort(order, kind="stable")])  # its layout matters to them, too


def _behind(costs: Array, finished: NDArray[np.int64], dropped: list[NDArray[np.int64]]) -> Array:
    """Shift those that were dropped together, the last ones first, behind the worst of those that went further."""
    told = costs.copy()
    floor = _highest(
        costs[finished], otherwise=np.inf
    )  # if all of them failed, nobody is to win by having seen less
    for group in reversed(dropped):
        best = float(costs[group].min(initial=np.inf))
        shifted = costs[group] + max(floor - best, 0.0) if np.isfinite(best) else costs[group]
        told[group] = np.nextafter(np.maximum(shifted, floor), np.inf)
        floor = _highest(told[group], otherwise=floor)
    return told


def _highest(costs: Array, otherwise: float) -> float:
    """The highest cost of those that did not fail."""
    return float(costs[np.isfinite(costs)].max(initial=-np.inf)) if np.isfinite(costs).any() else otherwise
