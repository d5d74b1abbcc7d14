"""Local search with a simplex (Nelder-Mead) that can move several vertices at a time.

J. A. Nelder and R. Mead, Computer Journal 7, 308-313, 1965. Several vertices: D. Lee and M. Wiswall, Computational
Economics 30, 171-187, 2007. Coefficients: F. Gao and L. Han, Comput. Optim. Appl. 51, 259-277, 2012.
"""

from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import AskTell

MIN_SIZE = 1e-12  # size of the simplex at which the search ends, in widths of the bounds


class NelderMead(AskTell):
    """A simplex that moves according to the costs of its vertices; a batch has at most d + 1 points."""

    name = "nelder-mead"
    saved = ("phase", "simplex", "values", "reflected", "reflected_values", "reach")
    start: Array | None = None
    """First vertex, shape (d,); random by default."""
    start_cost: float = np.inf
    """Cost of the first vertex, if known."""
    size: float = 0.05
    """Edge length of the first simplex, in widths of the bounds."""
    parallel: int = 1
    """Number of vertices, those with the highest costs, that are moved at a time; at most half of all vertices."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        if np.isfinite(self.start_cost):
            self.global_best, self.global_cost = self.simplex[0].copy(), self.start_cost

    def begin_near(self, point: Array) -> None:
        self.start = point
        self.positions = self._begin()

    def _begin(self) -> Array:
        low, high, d = self.low, self.high, len(self.low)
        first = self.rng.uniform(low, high) if self.start is None else self.start
        edges = self.size * (high - low)
        steps = np.where(first + edges > high, -edges, edges)
        self.simplex = np.clip(np.vstack([first, first + np.diag(steps)]), low, high)
        self.values = np.full(d + 1, np.inf)
        self.values[0] = self.start_cost
        self.moved = min(max(self.parallel, 1), (d + 1) // 2)
        n = max(d, 2)  # (Gao and Han 4.1); in two dimensions these are the coefficients of Nelder and Mead
        self.expansion, self.contraction, self.shrinkage = 1 + 2 / n, 0.75 - 1 / (2 * n), 1 - 1 / n
        self.phase, self.reach = "begin", np.empty(0)
        self.reflected, self.reflected_values = np.empty((0, d)), np.empty(0)
        return self.simplex[int(np.isfinite(self.start_cost)) :]

    def _next(self) -> Array:
        if self.phase == "shrink":
            return self.simplex[0] + self.shrinkage * (self.simplex[1:] - self.simplex[0])
        if self.phase == "follow":
            return self._through_the_middle(self.reach)[self.reach != 0]
        if np.all(np.ptp(self.simplex, axis=0) <= MIN_SIZE * (self.high - self.low)):
            return np.empty((0, len(self.low)))
        return self._through_the_middle(np.ones(self.moved))

    def _through_the_middle(self, reach: Array) -> Array:
        """Reflect the worst vertices through the center of the others, to ``reach`` times their distance from it."""
        t, middle = reach[:, np.newaxis], np.mean(self.simplex[: -self.moved], axis=0)
        return (1 + t) * middle - t * self.simplex[-self.moved :]

    def _learn(self, costs: Array) -> None:
        if not len(costs):
            return
        if self.phase == "reflect":
            self._judge_reflections(costs)
        elif self.phase == "follow":
            self._judge_followers(costs)
        else:  # the points are the last vertices of the simplex
            self._settle(len(costs), self.positions, costs)

    def _judge_reflections(self, costs: Array) -> None:
        """Expand points that are the best so far, contract bad points, and keep the others."""
        self.reflected, self.reflected_values = self.positions, costs
        best, kept, own = self.values[0], self.values[-self.moved - 1], self.values[-self.moved :]
        self.reach = np.select(
            [costs < best, costs < kept, costs < own],
            [self.expansion, 0.0, self.contraction],
            -self.contraction,
        )
        if self.reach.any():
            self.phase = "follow"
        else:
            self._settle(self.moved, self.positions, costs)

    def _judge_followers(self, costs: Array) -> None:
        """Keep the expansions and contractions that lower the cost; shrink the simplex if no vertex improves."""
        reach = self.reach[self.reach != 0]
        inside, outside = reach < 0, reach == self.contraction
        followed = np.flatnonzero(self.reach)
        rival = np.where(inside, self.values[-self.moved :][followed], self.reflected_values[followed])
        better = (costs < rival) | (outside & (costs == rival) & np.isfinite(costs))
        if np.all(~better & (reach != self.expansion)) and len(followed) == self.moved:
            self.phase = "shrink"
            return
        points, values = self.reflected.copy(), self.reflected_values.copy()
        stays = followed[inside & ~better]
        points[stays], values[stays] = self.simplex[-self.moved :][stays], self.values[-self.moved :][stays]
        points[followed[better]], values[followed[better]] = self.positions[better], costs[better]
        self._settle(self.moved, points, values)

    def _settle(self, n: int, points: Array, values: Array) -> None:
        self.simplex[-n:], self.values[-n:] = points, values
        order = np.argsort(self.values, kind="stable")
        self.simplex, self.values = self.simplex[order], self.values[order]
        self.phase = "reflect"
