"""Filters whose mean is on a manifold; the covariance describes a small error, which ``plus`` adds to the mean.

Sources: J. Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 6. M. Brossard, A. Barrau and
S. Bonnabel, A code for unscented Kalman filtering on manifolds (UKF-M), ICRA 2020.
"""

from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters import tilted
from sigmaswarm.filters.textbook.kalman import (
    ExtendedKalmanFilter,
    GaussianFilter,
    Measurement,
    SigmaPoints,
    UnscentedKalmanFilter,
)


class _OnManifold(GaussianFilter):
    plus, minus = staticmethod(tilted.plus), staticmethod(tilted.minus)


class ErrorStateKalmanFilter(_OnManifold, ExtendedKalmanFilter):
    """An extended Kalman filter whose covariance describes a small error."""

    def transition(self, mean: Array, dt: float, u: Array) -> Array:
        return tilted.transition(mean, dt, u)

    def sensitivity(self, h: Measurement, mean: Array) -> Array:
        return super().sensitivity(h, mean) @ tilted.angles_by_error(mean)


class ManifoldUnscentedKalmanFilter(_OnManifold, UnscentedKalmanFilter):
    """Unscented Kalman filter (UKF-M): its sigma points are errors, which ``plus`` adds to the mean.

    The attitude is among the first states in the square roots of P. The other first states differ between steps and
    measurements.
    """

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        """Compute x' = plus(f(x), mean error); P' is the covariance of the errors, plus Q."""
        wm, wc = self.points.weights(len(self.mean))
        center = self.f(self.mean, dt, u)
        drawn = self.points.draw(np.zeros(len(self.mean)), self.covariance)
        moved = [self.f(self.plus(self.mean, error), dt, u) for error in drawn]
        # An error may exceed half a turn, but not its change in one step.
        pairs = zip(moved, drawn, strict=True)
        errors = np.array([tilted.nearest(self.minus(s, center), e) for s, e in pairs])
        shift = wm @ errors
        spread = errors - shift
        self.mean = self.plus(center, shift)
        self.covariance = (spread.T * wc) @ spread + process_noise
        self._store_prediction((drawn.T * wc) @ spread)

    def _measured_points(self) -> tuple[SigmaPoints, Array, Array]:
        points = replace(self.points, first=tilted.MEASURED_FIRST if self.points.first else ())
        drawn = points.draw(np.zeros(len(self.mean)), self.covariance)
        return points, np.array([self.plus(self.mean, error) for error in drawn]), drawn
