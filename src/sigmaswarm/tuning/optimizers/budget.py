"""Budget of evaluations, and an optional local search at the end."""

from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.tuning.optimizers.asktell import AskTell, Optimizer
from sigmaswarm.tuning.optimizers.nelder_mead import NelderMead


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
        """End the global search; return True if evaluations remain for a local search."""
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
