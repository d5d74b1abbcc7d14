"""Search without memory, as a baseline for optimizers.

J. Bergstra and Y. Bengio, Random search for hyper-parameter optimization, JMLR 13, 281-305, 2012; A. B. Owen, Randomly
permuted (t,m,s)-nets and (t,s)-sequences, 1995.
"""

from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import AskTell


class RandomSearch(AskTell):
    name = "random"

    def _next(self) -> Array:
        return self.rng.uniform(self.low, self.high, self.positions.shape)


class SobolSearch(AskTell):
    """Scrambled Sobol' points, which are most uniform if their number is a power of two."""

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
