"""The unscented Kalman filter in textbook form, in NumPy.

Sigma points, weights, predict and update are as in FilterPy 2.0.0.

References
----------
S. J. Julier and J. K. Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92(3), 2004.
R. van der Merwe, Sigma-point Kalman filters for probabilistic inference in dynamic state-space models, 2004.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm.filters.textbook.gaussian import (
    GaussianFilter,
    Innovation,
    Measurement,
    Process,
    wrapped_differences,
)


class NotPositiveDefiniteError(SigmaswarmError):
    """The covariance has no square root, so the filter has failed."""


@dataclass(frozen=True)
class SigmaPoints:
    """Merwe's scaled sigma points.

    Attributes
    ----------
    alpha, beta, kappa : float
        Scaling (dimensionless).
    first : sequence of int
        States that come first in the Cholesky factorization of P. Every square root of P is valid, and each gives
        different sigma points. If empty, the order is that of the states, as in FilterPy.
    """

    alpha: float
    beta: float
    kappa: float
    first: Sequence[int] = ()

    def weights(self, n: int) -> tuple[Array, Array]:
        """Return the weights for the mean and for the covariance, each of shape (2n + 1,)."""
        gamma2 = self.alpha**2 * (n + self.kappa)  # n + lambda; computing lambda alone would lose digits
        wm = np.full(2 * n + 1, 0.5 / gamma2)
        wc = wm.copy()
        wm[0] = 1 - n / gamma2
        wc[0] = wm[0] + 1 - self.alpha**2 + self.beta
        return wm, wc

    def draw(self, mean: Array, covariance: Array) -> Array:
        """Return the points, (2n + 1, n): mean, mean plus each scaled column of the root, mean minus each column."""
        n = len(mean)
        gamma = np.sqrt(self.alpha**2 * (n + self.kappa))
        columns = gamma * square_root(covariance, self.first).T
        return np.vstack([mean, mean + columns, mean - columns])


def square_root(covariance: Array, first: Sequence[int] = ()) -> Array:
    """Compute L (n, n) with L L^T = P: the Cholesky factor of P with the states ``first`` before all others."""
    n = len(covariance)
    order = [*first, *(i for i in range(n) if i not in first)]
    try:
        factor = np.linalg.cholesky(covariance[order][:, order])
    except np.linalg.LinAlgError:
        raise NotPositiveDefiniteError(
            "the covariance is not positive definite, so the filter has failed; check that all process and "
            "measurement variances are positive"
        ) from None
    root = np.empty((n, n))
    root[order] = factor
    return root


class UnscentedKalmanFilter(GaussianFilter):
    """An unscented Kalman filter for any process and measurement.

    Parameters
    ----------
    f : callable
        ``f(state, dt, u) -> state``, arrays of shape (n,).
    h : callable
        ``h(state) -> measurement``, shapes (n,) to (m,).
    mean, covariance : ndarray, shapes (n,), (n, n)
        Mean and covariance at the start.
    points : SigmaPoints
    redraw_sigma_points : bool
        Draw new sigma points after Q is added (FilterPy 2.0.0). If False, apply h to the propagated points (FilterPy
        1.4.5, which the paper probably used).
    angles : sequence of int
        States that are angles. The difference of a point from the center may exceed half a turn, so only its change in
        a step is wrapped. A circular mean would be wrong, since the center's weight is a large negative number for a
        small alpha.
    measured_angles : sequence of int
        Elements of ``h`` that are angles: their differences from the center point and their innovations are wrapped.

    Attributes
    ----------
    mean, covariance : ndarray
        x and P after the last call.
    """

    def __init__(
        self,
        f: Process,
        h: Measurement,
        mean: Array,
        covariance: Array,
        points: SigmaPoints,
        *,
        redraw_sigma_points: bool = True,
        angles: Sequence[int] = (),
        measured_angles: Sequence[int] = (),
    ) -> None:
        super().__init__(f, h, mean, covariance)
        self.points, self.redraw_sigma_points = points, redraw_sigma_points
        self.angles, self.measured_angles = list(angles), list(measured_angles)
        self._propagated: Array | None = None

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        wm, wc = self.points.weights(len(self.mean))
        drawn = self.points.draw(self.mean, self.covariance)
        sigmas = np.array([self.f(s, dt, u) for s in drawn])
        offsets = sigmas - sigmas[0]
        # An offset may exceed half a turn, but its change by f in one step may not.
        turned = (offsets - (drawn - drawn[0]))[:, self.angles]
        offsets[:, self.angles] -= 2 * np.pi * np.round(turned / (2 * np.pi))
        shift = wm @ offsets  # mean relative to the center, since the weights add up to one
        spread = offsets - shift
        before = drawn - drawn[0]
        self.mean = sigmas[0] + shift
        self.covariance = (spread.T * wc) @ spread + process_noise
        self._propagated = sigmas[0] + offsets
        self._store_prediction((before.T * wc) @ spread)

    def measure(
        self, measurement: Array, measurement_noise: Array, h: Measurement | None = None
    ) -> Innovation:
        """Compute nu, S and C from the sigma points; ``h`` replaces the filter's ``h``."""
        angles = self.measured_angles if h is None else []
        h = h or self.h
        points, sigmas, spread_x = self._measured_points()
        wm, wc = points.weights(len(self.mean))
        predicted = np.array([h(s) for s in sigmas])
        offsets = wrapped_differences(predicted - predicted[0], angles)
        predicted[:, angles] = predicted[0, angles] + offsets[:, angles]
        center = wm @ (predicted - predicted[0]) + predicted[0]
        spread_z = predicted - center
        s = (spread_z.T * wc) @ spread_z + measurement_noise
        nu = wrapped_differences(measurement - center, angles)
        return Innovation(nu, s, (spread_x.T * wc) @ spread_z, measurement_noise)

    def _measured_points(self) -> tuple[SigmaPoints, Array, Array]:
        """Return the sigma points of a measurement, (2n + 1, n), and their differences from the mean."""
        sigmas = self._propagated
        if self.redraw_sigma_points or sigmas is None:
            sigmas = self.points.draw(self.mean, self.covariance)
        return self.points, sigmas, sigmas - self.mean

    def correct(self, innovation: Innovation) -> None:
        super().correct(innovation)
        self._propagated = None
