"""Textbook filters for a user's model on a log: slow, but f and h can be any Python functions."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.filters.constants import OUTLIERS, OUTLIERS_SPAN
from sigmaswarm.filters.custom.log import FilterSteps
from sigmaswarm.filters.custom.model import Model, as_covariance
from sigmaswarm.filters.textbook import ExtendedKalmanFilter, SigmaPoints, UnscentedKalmanFilter
from sigmaswarm.filters.textbook.kalman import GaussianFilter, Innovation


class TextbookModel:
    """Textbook filter of a model on a log's steps.

    ``scaling`` (3,) is alpha, beta, kappa, and ``p`` is a `Model.record`. ``nis`` and ``nll`` (f,) are the normalized
    innovation squared and the negative log-likelihood of each measurement before its update; they are NaN for
    measurements after the current step. ``runs`` (m, 2) contains, for each element of a measurement, the number of
    consecutive outliers (`Model.robust`) and the time since the first of them, s.
    """

    def __init__(self, model: Model, steps: FilterSteps, scaling: Array, p: Any, runs: Array) -> None:
        self.model, self.steps, self.p, self.runs = model, steps, p, runs
        self.noise = as_covariance(model.measurement_noise(p))
        self.limits = model.limits(len(self.noise))
        self.filter = textbook_filter(model, steps, scaling, p)
        self.nis, self.nll = np.full((2, len(steps.measurements)), np.nan)

    def step(self, i: int) -> None:
        steps, kalman = self.steps, self.filter
        dt, row = float(steps.dt[i]), steps.updates[i]
        if dt > 0:
            q = as_covariance(self.model.process_noise(dt, self.p))
            kalman.predict(dt, steps.inputs[steps.source[i]], q)
        self.runs[:, 1] += dt
        if row >= 0:
            innovation = kalman.measure(steps.measurements[row], self.noise)
            present = np.flatnonzero(~np.isnan(steps.measurements[row]))
            if len(present) < len(self.noise):
                innovation = innovation.of(present)
            nis, limit = innovation.nis, self.limits[len(present) - 1]
            self.nis[row], self.nll[row] = nis, negative_log_likelihood(innovation, limit)
            if self._is_outlier(present, nis > limit):
                innovation = replace(innovation, variance=innovation.variance * nis / limit)
            kalman.correct(innovation)

    def _is_outlier(self, present: NDArray[np.int64], above: bool) -> bool:
        """Update ``runs``. Return ``above``, or False after a long run of outliers in all present elements."""
        count, since = self.runs[present, 0], self.runs[present, 1]
        since[count == 0] = 0.0
        count = count + 1 if above else np.zeros(len(present))
        self.runs[present] = np.column_stack([count, since])
        return above and not ((count >= OUTLIERS) & (since >= OUTLIERS_SPAN - 1e-6)).all()


def textbook_filter(model: Model, steps: FilterSteps, scaling: Array, p: Any) -> GaussianFilter:
    def f(state: Array, dt: float, u: Array) -> Array:
        return np.asarray(model.f(state.copy(), dt, u, p))  # a copy: f may work in place

    def h(state: Array) -> Array:
        return np.asarray(model.h(state.copy(), p))

    given, measured = (f, h, steps.mean, steps.covariance), model.measured_angles
    if model.kind == "ekf":
        return ExtendedKalmanFilter(*given, measured_angles=measured)
    alpha, beta, kappa = map(float, scaling)
    points, angles = SigmaPoints(alpha, beta, kappa), model.indices(model.angles)
    return UnscentedKalmanFilter(*given, points, angles=angles, measured_angles=measured)


def negative_log_likelihood(innovation: Innovation, limit: float = np.inf) -> float:
    """Return -log N(nu; 0, S), with a logarithmic increase for an NIS above the limit (see `Model.robust`).

    Raises `numpy.linalg.LinAlgError` if S is not positive definite.
    """
    root = np.linalg.cholesky(innovation.variance)
    log_det, nis = 2 * np.log(np.diag(root)).sum(), innovation.nis
    tail = nis if nis <= limit else limit * (1 + np.log(nis / limit))
    return float(0.5 * (tail + log_det + len(innovation.nu) * np.log(2 * np.pi)))
