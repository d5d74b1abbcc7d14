"""The extended Kalman filter in textbook form.

D. Simon, Optimal State Estimation, Wiley 2006, section 13.2.3.
"""

from collections.abc import Callable, Sequence

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.textbook.gaussian import (
    GaussianFilter,
    Innovation,
    Measurement,
    Process,
    wrapped_differences,
)


class ExtendedKalmanFilter(GaussianFilter):
    """An extended Kalman filter for any process and measurement that also accept complex states.

    Parameters
    ----------
    f : callable
        ``f(state, dt, u) -> state``, arrays of shape (n,).
    h : callable
        ``h(state) -> measurement``, shapes (n,) to (m,).
    mean, covariance : ndarray, shapes (n,), (n, n)
        Mean and covariance at the start.
    measured_angles : sequence of int
        Elements of ``h`` that are angles: their innovations are wrapped.
    """

    def __init__(
        self,
        f: Process,
        h: Measurement,
        mean: Array,
        covariance: Array,
        *,
        measured_angles: Sequence[int] = (),
    ) -> None:
        super().__init__(f, h, mean, covariance)
        self.measured_angles = list(measured_angles)

    def transition(self, mean: Array, dt: float, u: Array) -> Array:
        """Return F, the Jacobian of the process, (n, n)."""
        return complex_step(lambda s: self.f(s, dt, u), mean)

    def sensitivity(self, h: Measurement, mean: Array) -> Array:
        """Return H, the Jacobian of a measurement, (m, n)."""
        return complex_step(h, mean)

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        """Compute x' = f(x), P' = F P F^T + Q."""
        jacobian = self.transition(self.mean, dt, u)
        self.mean = self.f(self.mean, dt, u)
        cross = self.covariance @ jacobian.T
        self.covariance = jacobian @ self.covariance @ jacobian.T + process_noise
        self._store_prediction(cross)

    def measure(
        self, measurement: Array, measurement_noise: Array, h: Measurement | None = None
    ) -> Innovation:
        """Compute nu = z - h(x), S = H P H^T + R, C = P H^T."""
        angles = self.measured_angles if h is None else []
        h = h or self.h
        jacobian = self.sensitivity(h, self.mean)
        cross = self.covariance @ jacobian.T
        nu = wrapped_differences(measurement - h(self.mean), angles)
        return Innovation(nu, jacobian @ cross + measurement_noise, cross, measurement_noise)


def complex_step(function: Callable[[Array], Array], x: Array) -> Array:
    """Return the Jacobian, shape (m, n), up to rounding: column k is Im f(x + i h e_k) / h for a tiny h.

    W. Squire and G. Trapp, Using complex variables to estimate derivatives of real functions, SIAM Review 40, 1998.
    """
    tiny = 1e-100
    columns = [np.imag(function(x + 1j * tiny * e)) / tiny for e in np.eye(len(x))]  # pyright: ignore[reportArgumentType]
    return np.array(columns).T
