"""Search without memory, the baseline of optimizers.

Random points (J. Bergstra and Y. Bengio, Random search for hyper-parameter optimization, JMLR 13, 281-305, 2012), and
Sobol' points, scrambled, which fill the space more evenly (A. B. Owen, Randomly permuted (t,m,s)-nets and
(t,s)-sequences, 1995).
"""

from typing import Any

import numpy as np

from sigmaswarm.tuning.optimizers.asktell import Array, AskTell


class RandomSearch(AskTell):
    """Points drawn uniformly within the bounds."""

    name = "random"

    def _next(self) -> Array:
        return self._begin()


class SobolSearch(AskTell):
    """The points of a scrambled Sobol' sequence; most uniform if their number is a power of two."""

    name = "sobol"
    saved = ("seed", "drawn")

    def _begin(self) -> Array:
        self.seed, self.drawn = int(self.rng.integers(2**63)), 0
        self._open()
        return self._next()

    def _open(self) -> None:
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
        """Continue from a saved `state`, in an optimizer made with the same arguments."""
        super().restore(state)
        self._open()
