"""An optimizer that stops when its evaluations are spent, and may keep the last of them for a local search."""

from typing import Any

import numpy as np

from sigmaswarm.tuning.optimizers.asktell import Array, Optimizer
from sigmaswarm.tuning.optimizers.nelder_mead import NelderMead

POLISH_SIZE = 0.05
"""Edge of the first simplex of a polish, in widths of the box."""


class Budgeted:
    """An optimizer with a budget of evaluations.

    Parameters
    ----------
    first : Optimizer
        Searches the whole box.
    low, high : ndarray, shape (d,)
        Bounds of the box, in search coordinates.
    rng : numpy.random.Generator
        The same that ``first`` uses.
    budget : int
        Points that will be asked for, at most.
    polish : int
        How many of them a Nelder-Mead search from the best point may have in the end.
    polish_size : float
        Edge of its first simplex, in widths of the box.
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
        polish_size: float = POLISH_SIZE,
    ) -> None:
        self.low, self.high, self.rng = low, high, rng
        self.first, self.budget, self.polish, self.polish_size = first, budget, polish, polish_size
        self.local: NelderMead | None = None
        self.spent = 0

    @property
    def _now(self) -> Optimizer:
        return self.local or self.first

    @property
    def global_best(self) -> Array:
        """The best point so far, shape (d,)."""
        return self._now.global_best

    @property
    def global_cost(self) -> float:
        """Its cost; ``inf`` until a point had a finite one."""
        return self._now.global_cost

    def ask(self) -> Array:
        """The points whose costs are wanted next, shape (n, d); n = 0 if there is nothing left to try."""
        left = self.budget - self.spent
        batch = self._now.ask()
        if (
            self.local is None
            and self.polish
            and len(batch) > left - self.polish
            and np.isfinite(self.global_cost)
        ):
            self.local = self._local_search()
            batch = self.local.ask()
        return batch[: max(left, 0)]

    def tell(self, costs: Array) -> None:
        """Take the costs of the last points, shape (n,); one that is not finite counts as ``inf``."""
        unpaid = len(self._now.ask()) - len(costs)  # of a last batch that was cut
        self._now.tell(np.concatenate([costs, np.full(unpaid, np.inf)]))
        self.spent += len(costs)

    def settle(self) -> bool:
        """Spend no more on the search of the whole box; whether a polish is left to do, or under way."""
        if self.local is None:
            if not self.polish or not np.isfinite(self.global_cost):
                return False
            self.budget = min(self.budget, self.spent + self.polish)
        return self.spent < self.budget

    def _local_search(self) -> NelderMead:
        return NelderMead(
            self.low,
            self.high,
            1,
            self.rng,
            start=self.first.global_best,
            start_cost=self.first.global_cost,
            size=self.polish_size,
        )

    def state(self) -> dict[str, Any]:
        """All that `restore` needs to go on bit for bit."""
        parts = {"first": self.first, "local": self.local}
        states = {
            f"{part}.{name}": value
            for part, optimizer in parts.items()
            if optimizer
            for name, value in optimizer.state().items()
            if name != "rng"
        }
        return states | {"spent": self.spent, "budget": self.budget, "rng": self.rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a saved `state`, in an optimizer made with the same arguments."""

        def part(name: str) -> dict[str, Any]:
            own = {k.removeprefix(f"{name}."): v for k, v in state.items() if k.startswith(f"{name}.")}
            return own and own | {"rng": state["rng"]}

        self.spent, self.budget = int(state["spent"]), int(state["budget"])
        self.first.restore(part("first"))
        self.local = None
        if local := part("local"):
            self.local = self._local_search()
            self.local.restore(local)
