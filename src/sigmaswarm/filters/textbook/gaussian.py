"""Common part of the textbook filters: a Gaussian state, and its update with an innovation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array

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
    """

    prediction: Prediction  # the last prediction

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
        self.mean = self.mean + gain @ innovation.nu
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
