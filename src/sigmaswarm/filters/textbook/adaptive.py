"""Parts of adaptive filters: adapted noise, fuzzy rules, the fading factor of strong tracking, Student's t."""

from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.constants import ITERATIONS, LARGEST_RATIO, OUTLIERS, OUTLIERS_SPAN, OUTLYING, SLOWER
from sigmaswarm.filters.textbook.kalman import GaussianFilter, Innovation


@dataclass
class SageHusa:
    """Adapt Q and R to the innovations of the fixes.

    A. P. Sage and G. W. Husa, Adaptive filtering with unknown prior statistics, JACC 1969. The weight of a fix is 1 -
    b, the limit of their weight (1 - b) / (1 - b^(k+1)) for a large number k of fixes. R is computed from the residual
    after the update, so it is positive by construction. A fix reduces an element of Q at most to b times its previous
    value.
    """

    process_noise: Array  # (n,), diagonal of Q per nominal step
    measurement_noise: Array  # (2,), diagonal of R
    forgetting: float  # b

    def adapt(self, innovation: Innovation, since: float) -> None:
        """Adapt to a fix. ``since`` is the number of nominal steps since the last fix.

        If it is 0, Q does not change.
        """
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
class FuzzyNoise:
    """Scale Q and R by fuzzy rules on the innovations of the fixes.

    The ratio d of the actual to the theoretical innovation covariance is NIS / 2, on average 1 for a consistent
    filter. The rules use two moving averages of d over the fixes, quick and slow; the time constant of the slow
    average is `SLOWER` times that of the quick average. The averages give two inputs in (-1, 1), ``ratio = (quick -
    1) / (quick + 1)`` and ``trend = (quick - slow) / (quick + slow)``. Piecewise linear functions of ratio and
    trend, with the widths ``fuzzy_widths``, give the memberships "small", "right", "large" and "rises" between 0
    and 1. The rules, with the gains g_R and g_Q (``fuzzy_gains``), are

        ratio is small                       R / g_R    Q / g_Q     the covariance is too large
        ratio is right                       R          Q
        ratio is large, and rises            R g_R      Q           first R grows,
        ratio is large, and does not rise    R g_R      Q g_Q       later also Q

    The factors of R and Q are the means of the consequents, weighted by the memberships of the rules, which sum to
    1. This is the inference of T. Takagi and M. Sugeno (Fuzzy identification of systems and its applications to
    modeling and control, IEEE Trans. SMC 15(1), 1985) of order zero, with the product for "and". The ratio follows
    P. J. Escamilla-Ambrosio and N. Mort, Hybrid Kalman filter-fuzzy logic adaptive multisensor data fusion
    architectures, CDC 2003. The rules, the membership functions and the two averages are our own.

    The ratio is computed from S before the update. The update uses the new R, and the next predictions use the new
    Q. With gains of 1 the filter equals the unscented filter.
    """

    tuned_process_noise: Array  # (n,), diagonal of Q per nominal step at a ratio of 1
    tuned_measurement_noise: Array  # (2,), diagonal of R at a ratio of 1
    memory: float  # weight of the previous value in the quick average
    widths: tuple[float, float]  # ratio and trend at which a membership reaches 1
    gains: tuple[float, float]  # largest factors of R and Q
    quick: float = 1.0  # quick, slow: moving averages of NIS / 2
    slow: float = 1.0
    times_r: float = 1.0  # times_r, times_q: current factors of R and Q
    times_q: float = 1.0

    @property
    def process_noise(self) -> Array:
        return self.times_q * self.tuned_process_noise

    @property
    def measurement_noise(self) -> Array:
        return self.times_r * self.tuned_measurement_noise

    def weigh(self, innovation: Innovation) -> Innovation:
        """Adapt to a fix. Return its innovation with the new R."""
        ratio = min(innovation.nis / len(innovation.nu), LARGEST_RATIO)
        self.quick = self.memory * self.quick + (1 - self.memory) * ratio
        self.slow += (1 - self.memory) / SLOWER * (ratio - self.slow)
        before = self.times_r
        self.times_r, self.times_q = self.factors()
        noise = innovation.noise * (self.times_r / before)
        return replace(innovation, variance=innovation.variance - innovation.noise + noise, noise=noise)

    def factors(self) -> tuple[float, float]:
        """Return the factors of R and Q: the means of the rules' factors, weighted by the memberships."""
        ratio = (self.quick - 1) / (self.quick + 1) / self.widths[0]
        trend = (self.quick - self.slow) / (self.quick + self.slow) / self.widths[1]
        small, large = np.clip(-ratio, 0, 1), np.clip(ratio, 0, 1)
        rises = np.clip(trend, 0, 1)
        gain_r, gain_q = self.gains
        rules = (
            (small, 1 / gain_r, 1 / gain_q),
            (1 - small - large, 1.0, 1.0),
            (large * rises, gain_r, 1.0),
            (large * (1 - rises), gain_r, gain_q),
        )
        membership, r, q = np.array(rules).T
        return float(membership @ r), float(membership @ q)


@dataclass
class StrongTracking:
    """Inflate P before the update with a fix until the trace of S is at least the recent mean of nu^T nu.

    D. H. Zhou and P. M. Frank, Int. J. Control 65(2), 1996, changed as in `compiled.adaptive.strong_tracking`.
    ``forgetting`` is rho, ``recent`` the weighted mean of nu^T nu.
    """

    forgetting: float
    recent: float | None = None

    def inflate(self, filter: GaussianFilter, innovation: Innovation) -> Innovation:
        size = float(innovation.nu @ innovation.nu)
        rho = self.forgetting
        self.recent = size if self.recent is None else rho * self.recent + (1 - rho) * size
        return inflate_observed(filter, innovation, self.recent)


@dataclass
class StudentT:
    """Weight fixes by Student's t: R of each fix is divided by the weight of the fix.

    R. Piche, S. Sarkka and J. Hartikainen, Recursive outlier-robust filtering and smoothing for nonlinear systems using
    the multivariate Student-t distribution, MLSP 2012. A filter with a wrong state would treat all fixes as outliers.
    Therefore, if `OUTLIERS` or more consecutive fixes over at least `OUTLIERS_SPAN` seconds are outliers, the last of
    these fixes has weight 1, and P is inflated before its update.
    """

    dof: float  # degrees of freedom
    outliers: int = 0  # current number of consecutive outliers
    since: float = 0.0  # s, time of the first of these outliers

    def weigh(self, filter: GaussianFilter, innovation: Innovation, time: float) -> Innovation:
        weight = self.weight(innovation)
        if not weight < OUTLYING:
            self.outliers = 0
        else:
            self.since = self.since if self.outliers else time
            self.outliers += 1
            if self.outliers >= OUTLIERS and time - self.since >= OUTLIERS_SPAN - 1e-6:
                self.outliers = 0
                return inflate_observed(filter, innovation, float(innovation.nu @ innovation.nu))
        noise = innovation.noise / weight
        return replace(innovation, variance=innovation.variance - innovation.noise + noise, noise=noise)

    def weight(self, innovation: Innovation) -> float:
        """Return the expected weight of a fix; state and weight are estimated alternately."""
        weight, r, nu = 1.0, innovation.noise, innovation.nu
        for _ in range(ITERATIONS):
            variance = innovation.variance - r + r / weight
            residual = r / weight @ np.linalg.solve(variance, nu)  # after the update
            remaining = r / weight - r / weight @ np.linalg.solve(variance, r / weight)  # H P+ H^T
            gamma = residual @ np.linalg.solve(r, residual) + np.trace(np.linalg.solve(r, remaining))
            weight = (self.dof + len(nu)) / (self.dof + gamma)
        return float(weight)


def inflate_observed(filter: GaussianFilter, innovation: Innovation, size: float) -> Innovation:
    """Inflate the part of P that a fix observes until tr S is at least ``size``, m2. Return the new innovation."""
    cross = innovation.cross
    observed = cross.T @ np.linalg.solve(filter.covariance, cross)  # H P H^T, with H = C^T P^-1
    factor = max(1.0, (size - np.trace(innovation.noise)) / np.trace(observed))
    filter.inflate((factor - 1) * cross @ np.linalg.solve(observed, cross.T))
    variance = innovation.variance + (factor - 1) * observed
    return Innovation(innovation.nu, variance, factor * cross, innovation.noise)
