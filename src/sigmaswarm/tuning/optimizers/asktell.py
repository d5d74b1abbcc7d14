"""What all optimizers share: they are asked for points, told their costs, and can be saved in between."""

from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Optimizer(Protocol):
    """An algorithm that is asked for points and told their costs; lower wins."""

    @property
    def global_best(self) -> Array:
        """The best point so far, shape (d,)."""
        ...

    @property
    def global_cost(self) -> float:
        """Its cost; ``inf`` until a point had a finite one."""
        ...

    def ask(self) -> Array:
        """The points whose costs are wanted next, shape (n, d); n = 0 if there is nothing left to try.

        Asked again before it is told, it gives the same points.
        """
        ...

    def tell(self, costs: Array) -> None:
        """Take the costs of the last points, shape (n,); one that is not finite counts as ``inf``."""
        ...

    def state(self) -> dict[str, Any]:
        """All that `restore` needs to go on bit for bit: arrays and numbers, and the generator's state as ``rng``."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a saved `state`, in an optimizer made with the same arguments."""
        ...


class AskTell:
    """The frame of an optimizer; a child says how the next points come about and what costs teach it.

    Parameters
    ----------
    low, high : ndarray, shape (d,)
        Bounds of the box, in search coordinates.
    positions : ndarray, shape (n, d)
        The first points.
    rng : numpy.random.Generator
        The only source of chance.

    Attributes
    ----------
    positions : ndarray, shape (n, d)
        The points last asked for.
    global_best : ndarray, shape (d,)
    global_cost : float
        ``inf`` until a point had a finite cost.
    """

    saved: ClassVar[tuple[str, ...]] = ()
    """The attributes, beside those of the frame, that make up the state: arrays, numbers or words."""

    def __init__(self, low: Array, high: Array, positions: Array, rng: np.random.Generator) -> None:
        self.low, self.high, self.rng = low, high, rng
        self.positions = np.clip(positions, low, high)
        self.global_best = self.positions[0].copy()
        self.global_cost = np.inf
        self.told = False

    def ask(self) -> Array:
        """The points whose costs are wanted next, shape (n, d)."""
        if self.told:
            self.positions = np.clip(self._next(), self.low, self.high)
            self.told = False
        return self.positions.copy()

    def tell(self, costs: Array) -> None:
        """Take the costs of the last points, shape (n,); one that is not finite counts as ``inf``."""
        if np.shape(costs) != (len(self.positions),):
            raise ValueError(
                f"{len(self.positions)} points were asked for, costs have shape {np.shape(costs)}"
            )
        costs = np.where(np.isfinite(costs), costs, np.inf)
        if len(costs) and costs.min() < self.global_cost:
            best = int(np.argmin(costs))
            self.global_best, self.global_cost = self.positions[best].copy(), float(costs[best])
        self._learn(costs)
        self.told = True

    def _next(self) -> Array:
        """The next points; the frame projects them on the box."""
        raise NotImplementedError

    def _learn(self, costs: Array) -> None:
        """Take the cleaned costs of `positions`."""

    def _names(self) -> tuple[str, ...]:
        return ("positions", "global_best", "global_cost", "told", *self.saved)

    def state(self) -> dict[str, Any]:
        """All that `restore` needs to go on bit for bit."""
        state = {name: getattr(self, name) for name in self._names()}
        return state | {"rng": self.rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a saved `state`, in an optimizer made with the same arguments."""
        for name in self._names():
            now, value = getattr(self, name), state[name]
            setattr(
                self,
                name,
                np.array(value, dtype=now.dtype) if isinstance(now, np.ndarray) else type(now)(value),
            )
        self.rng.bit_generator.state = state["rng"]
