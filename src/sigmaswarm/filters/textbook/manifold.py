"""Filters whose mean is on a manifold; the covariance describes a small error, which ``plus`` adds to the mean.

Sources: J. Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 6. M. Brossard, A. Barrau and
S. Bonnabel, A code for unscented Kalman filtering on manifolds (UKF-M), ICRA 2020.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.filters.textbook.ekf import ExtendedKalmanFilter
from sigmaswarm.filters.textbook.gaussian import Array, GaussianFilter, Innovation, Measurement, Process
from sigmaswarm.filters.textbook.loop import Retraction
from sigmaswarm.filters.textbook.ukf import SigmaPoints, UnscentedKalmanFilter


@dataclass(frozen=True)
class Manifold:
    """Manifold on which the mean of a filter lies.

    Attributes
    ----------
    plus : callable
        ``plus(state, error) -> state``
    minus : callable
        ``minus(state, other) -> error``, such that plus(other, error) is the state.
    nearest : callable
        ``nearest(error, near) -> error``: of all errors equivalent to ``error``, the nearest to ``near``.
    """

    plus: Retraction
    minus: Retraction
    nearest: Retraction


class _OnManifold(GaussianFilter):
    manifold: Manifold

    def correct(self, innovation: Innovation) -> None:
        """Update the state: plus(x, K nu), P - K S K^T."""
        mean = self.mean
        super().correct(innovation)
        self.mean = self.manifold.plus(mean, innovation.gain @ innovation.nu)


class ErrorStateKalmanFilter(_OnManifold, ExtendedKalmanFilter):
    """An extended Kalman filter whose covariance describes a small error.

    ``transition(state, dt, u)`` is the Jacobian F of ``f`` for a small error, (n, n); ``h.jacobian(state)`` is the
    Jacobian of ``h``, (m, n). ``mean`` (n,) and ``covariance`` (n, n) are values at the start.
    """

    def __init__(
        self, f: Process, transition: Process, h: Any, mean: Array, covariance: Array, manifold: Manifold
    ) -> None:
        super().__init__(f, h, mean, covariance)
        self._transition, self.manifold = transition, manifold

    def transition(self, mean: Array, dt: float, u: Array) -> Array:
        return self._transition(mean, dt, u)

    def sensitivity(self, h: Any, mean: Array) -> Array:
        return h.jacobian(mean)


class ManifoldUnscentedKalmanFilter(_OnManifold, UnscentedKalmanFilter):
    """Unscented Kalman filter (UKF-M): its sigma points are errors, which ``manifold.plus`` adds to the mean.

    ``measured``: sigma points of measurements; by default ``points``. For other parameters see `UnscentedKalmanFilter`.
    """

    def __init__(
        self,
        f: Process,
        h: Measurement,
        mean: Array,
        covariance: Array,
        manifold: Manifold,
        points: SigmaPoints,
        *,
        measured: SigmaPoints | None = None,
    ) -> None:
        super().__init__(f, h, mean, covariance, points)
        self.manifold, self.measured = manifold, measured or points

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        """Compute x' = plus(f(x), mean error); P' is the covariance of the errors, plus Q."""
        wm, wc = self.points.weights(len(self.mean))
        center = self.f(self.mean, dt, u)
        drawn = self.points.draw(np.zeros(len(self.mean)), self.covariance)
        moved = [self.f(self.manifold.plus(self.mean, error), dt, u) for error in drawn]
        # An error may exceed half a turn, but not its change in one step.
        pairs = zip(moved, drawn, strict=True)
        errors = np.array([self.manifold.nearest(self.manifold.minus(s, center), e) for s, e in pairs])
        shift = wm @ errors
        spread = errors - shift
        self.mean = self.manifold.plus(center, shift)
        self.covariance = (spread.T * wc) @ spread + process_noise
        self._store_prediction((drawn.T * wc) @ spread)

    def _measured_points(self) -> tuple[SigmaPoints, Array, Array]:
        drawn = self.measured.draw(np.zeros(len(self.mean)), self.covariance)
        return self.measured, np.array([self.manifold.plus(self.mean, error) for error in drawn]), drawn
