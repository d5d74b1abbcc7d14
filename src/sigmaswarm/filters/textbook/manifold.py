"""Filters whose mean is on a manifold; the covariance describes a small error, which ``plus`` adds to the mean.

Sources: J. Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 6. M. Brossard, A. Barrau and
S. Bonnabel, A code for unscented Kalman filtering on manifolds (UKF-M), ICRA 2020.
"""

from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.models import Tilts
from sigmaswarm.filters.textbook.kalman import (
    ExtendedKalmanFilter,
    GaussianFilter,
    Innovation,
    Measurement,
    Process,
    SigmaPoints,
    UnscentedKalmanFilter,
)


class _OnManifold(GaussianFilter):
    tilts: Tilts

    def correct(self, innovation: Innovation) -> None:
        """Update the state: plus(x, K nu), P - K S K^T."""
        mean = self.mean
        super().correct(innovation)
        self.mean = self.tilts.plus(mean, innovation.gain @ innovation.nu)


class ErrorStateKalmanFilter(_OnManifold, ExtendedKalmanFilter):
    """An extended Kalman filter whose covariance describes a small error; ``h.jacobian(state)`` is H, (m, n).

    ``mean`` (n,) and ``covariance`` (n, n) are values at the start.
    """

    def __init__(self, f: Process, h: Any, mean: Array, covariance: Array, tilts: Tilts) -> None:
        super().__init__(f, h, mean, covariance)
        self.tilts = tilts

    def transition(self, mean: Array, dt: float, u: Array) -> Array:
        return self.tilts.transition(mean, dt, u)

    def sensitivity(self, h: Any, mean: Array) -> Array:
        return h.jacobian(mean)


class ManifoldUnscentedKalmanFilter(_OnManifold, UnscentedKalmanFilter):
    """Unscented Kalman filter (UKF-M): its sigma points are errors, which ``tilts.plus`` adds to the mean.

    ``measured``: sigma points of measurements; by default ``points``. For other parameters see `UnscentedKalmanFilter`.
    """

    def __init__(
        self,
        f: Process,
        h: Measurement,
        mean: Array,
        covariance: Array,
        tilts: Tilts,
        points: SigmaPoints,
        *,
        measured: SigmaPoints | None = None,
    ) -> None:
        super().__init__(f, h, mean, covariance, points)
        self.tilts, self.measured = tilts, measured or points

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        """Compute x' = plus(f(x), mean error); P' is the covariance of the errors, plus Q."""
        wm, wc = self.points.weights(len(self.mean))
        center = self.f(self.mean, dt, u)
        drawn = self.points.draw(np.zeros(len(self.mean)), self.covariance)
        moved = [self.f(self.tilts.plus(self.mean, error), dt, u) for error in drawn]
        # An error may exceed half a turn, but not its change in one step.
        pairs = zip(moved, drawn, strict=True)
        errors = np.array([self.tilts.nearest(self.tilts.minus(s, center), e) for s, e in pairs])
        shift = wm @ errors
        spread = errors - shift
        self.mean = self.tilts.plus(center, shift)
        self.covariance = (spread.T * wc) @ spread + process_noise
        self._store_prediction((drawn.T * wc) @ spread)

    def _measured_points(self) -> tuple[SigmaPoints, Array, Array]:
        drawn = self.measured.draw(np.zeros(len(self.mean)), self.covariance)
        return self.measured, np.array([self.tilts.plus(self.mean, error) for error in drawn]), drawn
