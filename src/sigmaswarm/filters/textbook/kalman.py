"""The extended and the unscented Kalman filter in textbook form, in NumPy, with a Gaussian state as the common base.

Sigma points, weights, predict and update of the unscented filter are as in FilterPy 2.0.0.

References
----------
D. Simon, Optimal State Estimation, Wiley 2006, section 13.2.3 (extended).
S. J. Julier and J. K. Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92(3), 2004.
R. van der Merwe, Sigma-point Kalman filters for probabilistic inference in dynamic state-space models, 2004.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import SigmaswarmError

Process = Callable[[Array, float, Array], Array]
Measurement = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Innovation:
    """Innovation of a measurement, before the update.

    Attributes
    ----------
    nu : ndarray, shape (m,)
        Measurement minus its prediction.
    variance : ndarray, shape (m, m)
        S, the covariance of ``nu``.
    cross : ndarray, shape (n, m)
        C, the covariance of the state with the predicted measurement.
    noise : ndarray, shape (m, m)
        R, which S includes.
    """

    nu: Array
    variance: Array
    cross: Array
    noise: Array

    @property
    def gain(self) -> Array:
        """K = C S^-1, shape (n, m)."""
        return np.asarray(np.linalg.solve(self.variance, self.cross.T).T, np.float64)

    @property
    def nis(self) -> float:
        """Normalized innovation squared, nu^T S^-1 nu."""
        return float(self.nu @ np.linalg.solve(self.variance, self.nu))

    def of(self, elements: NDArray[np.int64]) -> "Innovation":
        """Return the innovation of the given elements of the measurement."""
        square = np.ix_(elements, elements)
        return Innovation(
            self.nu[elements], self.variance[square], self.cross[:, elements], self.noise[square]
        )


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of a filter before the update, for smoothing.

    ``mean`` (n,) and ``covariance`` (n, n) are m- and P-; P- includes the inflation of an adaptive filter
    (`adaptive.inflate_observed`). ``cross`` (n, n) is the covariance of the previous state with the predicted state.
    """

    mean: Array
    covariance: Array
    cross: Array


def wrapped_differences(values: Array, columns: Sequence[int]) -> Array:
    """Return ``values``, shape (..., m), with the angles (rad) in ``columns`` wrapped to [-pi, pi]."""
    values = values.copy()
    values[..., columns] -= 2 * np.pi * np.round(values[..., columns] / (2 * np.pi))
    return values


class GaussianFilter:
    """Base class of filters with a Gaussian state: ``mean``, shape (n,), and ``covariance``, shape (n, n).

    ``f(state, dt, u) -> state``, shape (n,), is the process; ``h(state)``, shape (m,), predicts a measurement.
    ``plus(state, error)`` injects an error, and ``minus(state, other)`` returns the error that changes ``other`` into
    the state.
    """

    prediction: Prediction  # the last prediction
    plus, minus = np.add, np.subtract

    def __init__(self, f: Process, h: Measurement, mean: Array, covariance: Array) -> None:
        self.f, self.h = f, h
        self.mean, self.covariance = mean.astype(np.float64), covariance.astype(np.float64)

    def predict(self, dt: float, u: Array, process_noise: Array) -> None:
        """Propagate the state by the process over ``dt`` seconds; Q, shape (n, n), is added to the covariance."""
        raise NotImplementedError

    def _store_prediction(self, cross: Array) -> None:
        self.prediction = Prediction(self.mean, self.covariance, cross)

    def measure(
        self, measurement: Array, measurement_noise: Array, h: Measurement | None = None
    ) -> Innovation:
        """Compute the innovation of a measurement, shape (m,), with noise covariance R, shape (m, m)."""
        raise NotImplementedError

    def correct(self, innovation: Innovation) -> None:
        """Update the state: x + K nu, P - K S K^T."""
        gain = innovation.gain
        self.mean = self.plus(self.mean, gain @ innovation.nu)
        self.covariance = self.covariance - gain @ innovation.variance @ gain.T

    def inflate(self, added: Array) -> None:
        """Add a covariance, shape (n, n), to P, as if Q of the last prediction had been larger."""
        self.covariance = self.covariance + added
        self.prediction = replace(self.prediction, covariance=self.covariance)

    def update(
        self, measurement: Array, measurement_noise: Array, h: Measurement | None = None
    ) -> Innovation:
        innovation = self.measure(measurement, measurement_noise, h)
        self.correct(innovation)
        return innovation


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
    """Return the Jacobian, shape (m, n), up to rounding. Column k is Im f(x + i h e_k) / h for a tiny h.

    W. Squire and G. Trapp, Using complex variables to estimate derivatives of real functions, SIAM Review 40, 1998.
    """
    tiny = 1e-100
    columns = [np.imag(function(x + 1j * tiny * e)) / tiny for e in np.eye(len(x))]  # pyright: ignore[reportArgumentType]
    return np.array(columns).T


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
        States that come first in the Cholesky factorization of P. Every square root of P is valid, but each gives
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
        """Compute nu, S and C from the sigma points. ``h`` replaces the filter's ``h``."""
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
