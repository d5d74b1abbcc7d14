"""Filters whose mean is on a manifold, with the covariance of a small error that ``plus`` adds to the mean.

J. Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 6. M. Brossard, A. Barrau and S.
Bonnabel, A code for unscented Kalman filtering on manifolds (UKF-M), ICRA 2020.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.filters.textbook.gaussian import Array, GaussianFilter, Innovation, Measurement, Process
from sigmaswarm.filters.textbook.ukf import SigmaPoints

Retraction = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Manifold:
    """A manifold on which the mean of a filter lies.

    Attributes
    ----------
    plus : callable
        ``plus(state, error) -> state``
    minus : callable
        ``minus(state, other) -> error``, such that plus(other, error) is the state.
    nearest : callable
        ``nearest(error, near) -> error``: of all errors that lead to the same state, the nearest to ``near``.
    """

    plus: Retraction
    minus: Retraction
    nearest: Retraction


class _OnManifold(GaussianFilter):
    def __init__(
        self, f: Process, h: Measurement, mean: Array, covariance: Array, manifold: Manifold
    ) -> None:
        self.f, self.h, self.manifold = f, h, manifold
        self.mean, self.covariance = mean.astype(np.float64), covariance.astype(np.float64)

    def correct(self, innovation: Innovation) -> None:
        """Update the state: x plus K nu, P - K S K^T."""
        mean = self.mean
        super().correct(innovation)
        self.mean = self.manifold.plus(mean, innovation.gain @ innovation.nu)


class ErrorStateKalmanFilter(_OnManifold):
    """An extended Kalman filter whose covariance is that of a small error.

    ``transition(state, dt, u)`` is the Jacobian F of ``f`` for a small error, (n, n); ``h.jacobian(state)`` is the
    Jacobian of ``h``, (m, n). ``mean`` (n,) and ``covariance`` (n, n) are values at the start.
    """

    def __init__(
        self,
        f: Process,
        transition: Process,
        h: Any,
        mean: Array,
        covariance: Array,
        manifold: Manifold,
    ) -> None:
        super().__init__(f, h, mean, covariance, manifold)
        self.transition = transition

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        """Compute x' = f(x), P' = F P F^T + Q."""
        f = self.transition(self.mean, dt, u)
        self.mean = self.f(self.mean, dt, u)
        cross = self.covariance @ f.T
        self.covariance = f @ self.covariance @ f.T + process_noise
        self._expect(cross)

    def measure(self, measurement: Array, measurement_noise: Array, h: Any = None) -> Innovation:
        """Compute nu = z - h(x), S = H P H^T + R, C = P H^T."""
        h = h or self.h
        jacobian = h.jacobian(self.mean)
        cross = self.covariance @ jacobian.T
        nu = measurement - h(self.mean)
        return Innovation(nu, jacobian @ cross + measurement_noise, cross, measurement_noise)


class ManifoldUnscentedKalmanFilter(_OnManifold):
    """UKF-M: sigma points are errors, added to the mean; parameters as in `ErrorStateKalmanFilter`.

    ``measured``: sigma points of measurements, if they differ from those of the process.
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
        super().__init__(f, h, mean, covariance, manifold)
        self.points, self.measured = points, measured or points

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        """Compute x' = f(x) plus the mean error; P' is the covariance of the errors, plus Q."""
        wm, wc = self.points.weights(len(self.mean))
        centre = self.f(self.mean, dt, u)
        drawn = self.points.draw(np.zeros(len(self.mean)), self.covariance)
        moved = [self.f(self.manifold.plus(self.mean, error), dt, u) for error in drawn]
        # An error may be a rotation by more than half a turn; its change in one step may not.
        each = zip(moved, drawn, strict=True)
        errors = np.array([self.manifold.nearest(self.manifold.minus(s, centre), e) for s, e in each])
        shift = wm @ errors
        spread = errors - shift
        self.mean = self.manifold.plus(centre, shift)
        self.covariance = (spread.T * wc) @ spread + process_noise
        self._expect((drawn.T * wc) @ spread)

    def measure(
        self, measurement: Array, measurement_noise: Array, h: Measurement | None = None
    ) -> Innovation:
        """Compute nu, S and C from the sigma points."""
        h = h or self.h
        wm, wc = self.measured.weights(len(self.mean))
        drawn = self.measured.draw(np.zeros(len(self.mean)), self.covariance)
        predicted = np.array([h(self.manifold.plus(self.mean, error)) for error in drawn])
        centre = wm @ (predicted - predicted[0]) + predicted[0]
        spread = predicted - centre
        s = (spread.T * wc) @ spread + measurement_noise
        return Innovation(measurement - centre, s, (drawn.T * wc) @ spread, measurement_noise)
