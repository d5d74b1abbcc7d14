"""The protocol of an optimizer, and the parts that the built-in ones share."""

from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Optimizer(Protocol):
    """A search algorithm with an ask-and-tell interface; the lowest cost wins.

    The class is called as ``Own(low, high, population, rng)``: the bounds in search coordinates, shape (d,); the points
    per batch; and a `numpy.random.Generator`, the only source of random numbers. Points outside the bounds are clipped.
    """

    def ask(self) -> Array:
        """Return the points to try next, shape (n, d); n = 0 if there is nothing left to try."""
        ...

    def tell(self, costs: Array) -> None:
        """Take the costs of the last points, shape (n,); a failed filter costs ``inf``."""
        ...

    def state(self) -> dict[str, Any]:
        """Return all that `restore` needs to continue bit for bit: arrays, numbers and strings by name.

        The state of ``rng`` is saved with it and need not be in it.
        """
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a saved `state`, in an optimizer made with the same arguments."""
        ...


class AskTell:
    """Base of the built-in optimizers; a child implements `_next` and `_learn`.

    Parameters
    ----------
    low, high : ndarray, shape (d,)
        Bounds, in search coordinates.
    positions : ndarray, shape (n, d)
        The first points.
    rng : numpy.random.Generator
        The only source of random numbers.

    Attributes
    ----------
    positions : ndarray, shape (n, d)
        The last points.
    global_best : ndarray, shape (d,)
        The best point so far.
    global_cost : float
        Its cost; ``inf`` until a point had a finite one.
    """

    saved: ClassVar[tuple[str, ...]] = ()
    """Attributes of the child that are part of the state: arrays, numbers or strings."""

    def __init__(self, low: Array, high: Array, positions: Array, rng: np.random.Generator) -> None:
        self.low, self.high, self.rng = low, high, rng
        self.positions = np.clip(positions, low, high)
        self.global_best = self.positions[0].copy()
        self.global_cost = np.inf
        self.told = False

    def ask(self) -> Array:
        """Return the points to try next, shape (n, d); the same ones until `tell` is called."""
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
        """Return the next points; `ask` clips them to the bounds."""
        raise NotImplementedError

    def _learn(self, costs: Array) -> None:
        """Update the state from the costs of `positions`."""

    def _names(self) -> tuple[str, ...]:
        return ("positions", "global_best", "global_cost", "told", *self.saved)

    def state(self) -> dict[str, Any]:
        """Return all that `restore` needs to continue bit for bit."""
        state = {name: getattr(self, name) for name in self._names()}
        return state | {"rng": self.rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a saved `state`, in an optimizer made with the same arguments."""
        for name in self._names():
            now, value = getattr(self, name), state[name]
            if isinstance(now, np.ndarray):
                array = np.array(value)
                if array.dtype != now.dtype or array.ndim != now.ndim or array.shape[1:] != now.shape[1:]:
                    raise ValueError(f"{name} has another type or shape")
                setattr(self, name, array)
            else:
                setattr(self, name, type(now)(value))
        self.rng.bit_generator.state = state["rng"]
