"""Protocol and base classes of optimizers, and two searches that do not learn from costs, as baselines."""

from collections import ChainMap
from inspect import get_annotations
from typing import Any, ClassVar, Protocol

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError

FIRST_STEP = 0.3
"""Standard deviation of the first points around a start point, in widths of the bounds.

With 0.1, parameters that the cost hardly determines stayed near the start point. After tuning with truth on 30 s of
comma2k19, the position RMSE on the remaining part was 10 to 30% larger than after a uniform first generation. With 0.3,
the RMSE was the same as after a uniform first generation.
"""


class Optimizer(Protocol):
    """A minimizer with ``ask`` and ``tell``.

    The constructor has the arguments ``(low, high, population, rng)``. ``low`` and ``high`` are the bounds in search
    coordinates, shape (d,). ``population`` is the number of points per batch. ``rng`` is a `numpy.random.Generator`,
    the only source of random numbers. Points outside the bounds are clipped.
    """

    def ask(self) -> Array:
        """Return the points to evaluate next, shape (n, d); n = 0 if the search has ended."""
        ...

    def tell(self, costs: Array) -> None:
        """Receive the costs of the last points, shape (n,); ``inf`` for a failed filter."""
        ...

    def state(self) -> dict[str, Any]:
        """Return arrays, numbers and strings by name, so that `restore` continues with identical results.

        The state of ``rng`` is saved separately and is not needed here.
        """
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a saved `state` in an optimizer that was created with the same arguments."""
        ...


class AskTell:
    """Base of the built-in optimizers; a subclass implements `_next` and may implement `_begin` and `_learn`.

    ``options`` are values for annotated class attributes of the subclass. ``positions`` are the last points, shape (n,
    d).
    """

    name: ClassVar[str] = ""
    saved: ClassVar[tuple[str, ...]] = ()
    """Names of the subclass's attributes that belong to the state."""

    def __init__(
        self, low: Array, high: Array, population: int, rng: np.random.Generator, **options: Any
    ) -> None:
        known = dict(ChainMap(*map(get_annotations, type(self).__mro__[:-2])))  # without AskTell and object
        for option, value in options.items():
            if option not in known:
                raise InputError(
                    f"{option} is not an option of the optimizer {self.name}, which has {', '.join(known) or 'none'}"
                )
            setattr(self, option, value)
        self.low, self.high, self.population, self.rng = low, high, population, rng
        self.center: Array | None = None
        self.positions = np.clip(self._begin(), low, high)
        self.global_best, self.global_cost = self.positions[0].copy(), np.inf
        self.told = False

    def begin_near(self, point: Array) -> None:
        """Begin around a point, shape (d,), which is in the first batch. Call this before the first `ask`.

        The other first points of `bo` and `sobol` do not change, since they cover the search space. `cma-es` draws all
        first points around the given point, but does not include the point itself.
        """
        self.center = point
        self.positions = np.clip(self._begin(), self.low, self.high)
        self.positions[0] = point

    def ask(self) -> Array:
        if self.told:
            self.positions = np.clip(self._next(), self.low, self.high)
            self.told = False
        return self.positions.copy()

    def tell(self, costs: Array) -> None:
        if np.shape(costs) != (len(self.positions),):
            raise ValueError(
                f"`ask` returned {len(self.positions)} points, but the costs have shape {np.shape(costs)}; "
                "pass one cost for each point"
            )
        costs = np.where(np.isfinite(costs), costs, np.inf)
        if len(costs) and costs.min() < self.global_cost:
            best = int(np.argmin(costs))
            self.global_best, self.global_cost = self.positions[best].copy(), float(costs[best])
        self._learn(costs)
        self.told = True

    def _begin(self) -> Array:
        """Initialize the subclass's state. Return the first points, by default random points."""
        return self._drawn_first()

    def _drawn_first(self) -> Array:
        """Draw one point per member: uniform within the bounds, or normal around the point of `begin_near`."""
        shape = self.population, len(self.low)
        if self.center is None:
            return self.rng.uniform(self.low, self.high, shape)
        points = self.rng.normal(self.center, FIRST_STEP * (self.high - self.low), shape)
        points[0] = self.center
        return np.clip(points, self.low, self.high)

    def _next(self) -> Array:
        raise NotImplementedError

    def _learn(self, costs: Array) -> None:
        """Update the state from the costs of `positions`."""

    def _redrawn(self, points: Array) -> Array:
        """Replace coordinates outside the bounds by uniform random coordinates."""
        outside = (points < self.low) | (points > self.high)
        return np.where(outside, self.rng.uniform(self.low, self.high, points.shape), points)

    def _names(self) -> tuple[str, ...]:
        return ("positions", "global_best", "global_cost", "told", *self.saved)

    def state(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self._names()} | {"rng": self.rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        for name in self._names():
            now, value = getattr(self, name), state[name]
            if isinstance(now, np.ndarray):
                value = np.array(value)
                if value.dtype != now.dtype or value.ndim != now.ndim or value.shape[1:] != now.shape[1:]:
                    raise ValueError(f"{name} has the wrong type or shape")
            else:
                value = type(now)(value)
            setattr(self, name, value)
        self.rng.bit_generator.state = state["rng"]


class Swarm(AskTell):
    """Particles that remember their best positions."""

    saved = ("personal_best", "personal_cost")

    def _begin(self) -> Array:
        self.personal_best = super()._begin()
        self.personal_cost = np.full(self.population, np.inf)
        return self.personal_best.copy()

    def _learn(self, costs: Array) -> None:
        better = costs < self.personal_cost
        self.personal_best[better] = self.positions[better]
        self.personal_cost[better] = costs[better]


class RandomSearch(AskTell):
    """Uniform random points: J. Bergstra and Y. Bengio, Random search for hyper-parameter optimization, JMLR 2012."""

    name = "random"

    def _next(self) -> Array:
        return self.rng.uniform(self.low, self.high, self.positions.shape)


class SobolSearch(AskTell):
    """Scrambled Sobol' points, which are most uniform if their number is a power of two.

    A. B. Owen, Randomly permuted (t,m,s)-nets and (t,s)-sequences, 1995.
    """

    name = "sobol"
    saved = ("seed", "drawn")

    def _begin(self) -> Array:
        self.seed, self.drawn = int(self.rng.integers(2**63)), 0
        self._open()
        return self._next()

    def _open(self) -> None:
        from scipy.stats import qmc  # takes a second to import

        # A seed instead of our generator: scipy would spawn a generator that the saved state does not contain.
        self._sequence = qmc.Sobol(len(self.low), scramble=True, rng=self.seed)
        if self.drawn:
            self._sequence.fast_forward(self.drawn)

    def _next(self) -> Array:
        # The first point is drawn separately, since scipy warns if the size of the first batch is not a power of two.
        even = np.concatenate([self._sequence.random(1), self._sequence.random(self.population - 1)])
        self.drawn += self.population
        return self.low + even * (self.high - self.low)

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        self._open()
