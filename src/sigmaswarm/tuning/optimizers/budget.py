"""Budget of evaluations, and a local search with a simplex (Nelder-Mead), also at the end of another search."""

from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.tuning.optimizers.asktell import AskTell, Optimizer

MIN_SIZE = 1e-12  # size of the simplex at which the search ends, in widths of the bounds


class NelderMead(AskTell):
    """A simplex that moves according to the costs of its vertices; a batch has at most d + 1 points.

    J. A. Nelder and R. Mead, Computer Journal 7, 308-313, 1965. Several vertices at a time: D. Lee and M. Wiswall,
    Computational Economics 30, 171-187, 2007. Coefficients: F. Gao and L. Han, Comput. Optim. Appl. 51, 259-277, 2012.
    """

    name = "nelder-mead"
    saved = ("phase", "simplex", "values", "reflected", "reflected_values", "reach")
    start: Array | None = None
    """First vertex, shape (d,); random by default."""
    start_cost: float = np.inf
    """Cost of the first vertex, if known."""
    size: float = 0.05
    """Edge length of the first simplex, in widths of the bounds."""
    parallel: int = 1
    """Number of vertices that are moved at a time, namely those with the highest costs; at most half of all
    vertices."""

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
        """Keep the expansions and contractions that lower the cost. Shrink the simplex if no vertex improves."""
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


class Budgeted:
    """An optimizer with a budget of evaluations, of which ``polish`` are reserved for a final Nelder-Mead search.

    ``rng`` is the generator of ``first``; its state is saved and restored here.
    """

    def __init__(
        self,
        first: Optimizer,
        low: Array,
        high: Array,
        rng: np.random.Generator,
        *,
        budget: int,
        polish: int = 0,
    ) -> None:
        self.low, self.high, self.rng = low, high, rng
        self.first, self.budget, self.polish = first, budget, polish
        self.local: NelderMead | None = None
        self.spent, self._size, self._points = 0, 0, np.empty((0, len(low)))
        self.global_best, self.global_cost = low.copy(), np.inf

    def begin_near(self, point: Array) -> None:
        """Set the start point, shape (d,), before the first `ask`; only subclasses of `AskTell` use it."""
        if isinstance(self.first, AskTell):
            self.first.begin_near(point)

    def ask(self) -> Array:
        remaining = self.budget - self.spent
        batch = self._batch(self.local or self.first)
        polishes = self.local is None and self.polish and np.isfinite(self.global_cost)
        if polishes and len(batch) > remaining - self.polish:
            self.local = self._local_search()
            batch = self._batch(self.local)
        self._size, self._points = len(batch), batch[: max(remaining, 0)]
        return self._points.copy()

    def _batch(self, optimizer: Optimizer) -> Array:
        batch = np.asarray(optimizer.ask(), dtype=np.float64)
        if batch.ndim != 2 or batch.shape[1] != len(self.low) or not np.isfinite(batch).all():
            name = type(optimizer).__name__
            raise InputError(
                f"{name}.ask returned an array of shape {batch.shape}; it must have shape (n, {len(self.low)}) and "
                "finite numbers"
            )
        return np.clip(batch, self.low, self.high)

    def tell(self, costs: Array) -> None:
        costs = np.where(np.isfinite(costs), costs, np.inf)
        if len(costs) and costs.min() < self.global_cost:
            best = int(np.argmin(costs))
            self.global_best, self.global_cost = self._points[best].copy(), float(costs[best])
        dropped = np.full(self._size - len(costs), np.inf)  # points of a last batch beyond the budget
        (self.local or self.first).tell(np.concatenate([costs, dropped]))
        self.spent += len(costs)

    def end_global_search(self) -> bool:
        """End the global search. Return True if evaluations remain for a local search."""
        if self.local is None:
            if not self.polish or not np.isfinite(self.global_cost):
                return False
            self.budget = min(self.budget, self.spent + self.polish)
        return self.spent < self.budget

    def _local_search(self) -> NelderMead:
        start, cost = self.global_best, self.global_cost
        return NelderMead(self.low, self.high, 1, self.rng, start=start, start_cost=cost)

    def state(self) -> dict[str, Any]:
        parts = {"first": self.first, "local": self.local}
        states = {
            f"{part}.{name}": value
            for part, optimizer in parts.items()
            if optimizer
            for name, value in optimizer.state().items()
            if name != "rng"
        }
        own = {name: getattr(self, name) for name in ("spent", "budget", "global_best", "global_cost")}
        return states | own | {"rng": self.rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        def part(name: str) -> dict[str, Any]:
            own = {k.removeprefix(f"{name}."): v for k, v in state.items() if k.startswith(f"{name}.")}
            return own and own | {"rng": state["rng"]}

        most, self.spent, self.budget = self.budget, int(state["spent"]), int(state["budget"])
        # In checkpoints of version 0.3.0, only the states of the two optimizers have these values.
        where = next(p for p in ("", "local.", "first.") if f"{p}global_cost" in state)
        self.global_best = np.asarray(state[f"{where}global_best"]).astype(np.float64, casting="same_kind")
        self.global_cost = float(state[f"{where}global_cost"])
        if not 0 <= self.spent <= self.budget <= most or np.isnan(self.global_cost):
            raise ValueError("the evaluations or costs do not belong to this search")
        if self.global_best.shape != self.low.shape or not np.isfinite(self.global_best).all():
            raise ValueError("the best point does not belong to this search")
        self.first.restore(part("first"))
        self.local = None
        if local := part("local"):
            self.local = self._local_search()
            self.local.restore(local)
        self.rng.bit_generator.state = state["rng"]
