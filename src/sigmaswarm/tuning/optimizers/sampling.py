"""Search without memory, the baseline of optimizers.

Random points (J. Bergstra and Y. Bengio, Random search for hyper-parameter optimization, JMLR 13, 281-305, 2012), and
Sobol' points, scrambled, which fill the box more evenly (A. B. Owen, Randomly permuted (t,m,s)-nets and
(t,s)-sequences, 1995).
"""

from typing import Any, ClassVar

import numpy as np

from sigmaswarm.tuning.optimizers.asktell import Array, AskTell


class RandomSearch(AskTell):
    """Points drawn evenly from the box.

    Parameters
    ----------
    low, high, population, rng
        As for every `Optimizer`.
    """

    def __init__(self, low: Array, high: Array, population: int, rng: np.random.Generator) -> None:
        super().__init__(low, high, rng.uniform(low, high, (population, len(low))), rng)

    def _next(self) -> Array:
        return self.rng.uniform(self.low, self.high, self.positions.shape)


class SobolSearch(AskTell):
    """The points of a scrambled Sobol' sequence; most even where their number is a power of two.

    Parameters
    ----------
    low, high, population, rng
        As for every `Optimizer`.
    """

    saved: ClassVar = ("seed", "drawn")

    def __init__(self, low: Array, high: Array, population: int, rng: np.random.Generator) -> None:
        self.low, self.high, self.population = low, high, population
        self.seed, self.drawn = int(rng.integers(2**63)), 0
        self._begin()
        super().__init__(low, high, self._next(), rng)

    def _begin(self) -> None:
        from scipy.stats import qmc  # takes a second to import

        # not the generator itself: scipy would spawn another from its seed, which is no part of its state
        self._sequence = qmc.Sobol(len(self.low), scramble=True, rng=self.seed)
        if self.drawn:
            self._sequence.fast_forward(self.drawn)

    def _next(self) -> Array:
        # one by itself, since scipy warns of a first batch that is no power of two
        even = np.concatenate([self._sequence.random(1), self._sequence.random(self.population - 1)])
        self.drawn += self.population
        return self.low + even * (self.high - self.low)

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a saved `state`, in an optimizer made with the same arguments."""
        super().restore(state)
        self._begin()
