"""Filters that change themselves: Sage-Husa's adapted noise, and strong tracking's fading factor."""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.filters.textbook.gaussian import Array, GaussianFilter, Innovation


@dataclass
class SageHusa:
    """Adapt Q and R to the innovations of the fixes.

    A. P. Sage and G. W. Husa, Adaptive filtering with unknown prior statistics, JACC 1969, in the steady state of
    their weights (1 - b) / (1 - b^(k+1)); the maximum-a-posteriori estimate of the noise under exponential
    forgetting. Guarded: R from the residual after the update, which is positive by construction; of Q's change no
    part that would make it negative.

    Attributes
    ----------
    process_noise : ndarray, shape (n,)
        Diagonal of Q per nominal step.
    measurement_noise : ndarray, shape (2,)
        Diagonal of R.
    forgetting : float
        b.
    """

    process_noise: Array
    measurement_noise: Array
    forgetting: float

    def adapt(self, innovation: Innovation, since: float) -> None:
        """Learn from a fix; ``since`` is the number of nominal steps since the last one: 0 says nothing of Q."""
        weight = 1 - self.forgetting
        inverse = np.linalg.inv(innovation.variance)
        r = self.measurement_noise
        residual = r * (inverse @ innovation.nu)
        self.measurement_noise = r + weight * (residual**2 - r**2 * np.diag(inverse))
        moved = innovation.gain @ innovation.nu
        shrunk = np.diag(innovation.gain @ innovation.variance @ innovation.gain.T)
        change = (moved**2 - shrunk) / (since if since > 0 else np.inf)
        self.process_noise = self.process_noise + weight * np.maximum(change, -self.process_noise)


@dataclass
class StrongTracking:
    """Stretch P before a fix so far that the recent size of the innovations is explained.

    After D. H. Zhou and P. M. Frank, Strong tracking filtering of nonlinear time-varying stochastic systems with
    coloured noise, Int. J. Control 65(2), 1996: the single fading factor, from the traces. Two things are not theirs.
    The innovations are averaged with weights rho and 1 - rho; theirs, rho and 1 over 1 + rho, hardly look back. And
    only what the fix sees of P is stretched, P + (factor - 1) C (H P H^T)^-1 C^T: what it can't see would grow on.

    Attributes
    ----------
    forgetting : float
        rho.
    recent : float or None
        Weighted mean of nu^T nu.
    """

    forgetting: float
    recent: float | None = None

    def stretch(self, filter: GaussianFilter, innovation: Innovation) -> Innovation:
        """The innovation as the filter sees it after its covariance is stretched."""
        size = float(innovation.nu @ innovation.nu)
        rho = self.forgetting
        self.recent = size if self.recent is None else rho * self.recent + (1 - rho) * size
        cross, covariance = innovation.cross, filter.covariance
        seen = cross.T @ np.linalg.solve(covariance, cross)  # H P H^T, with H = C^T P^-1
        factor = max(1.0, (self.recent - np.trace(innovation.noise)) / np.trace(seen))
        filter.covariance = covariance + (factor - 1) * cross @ np.linalg.solve(seen, cross.T)
        variance = innovation.variance + (factor - 1) * seen
        return Innovation(innovation.nu, variance, factor * cross, innovation.noise)
