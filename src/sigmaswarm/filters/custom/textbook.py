"""The reference filters on a log: slow, and any Python will do in f and h."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm.filters.custom.model import Model, as_covariance
from sigmaswarm.filters.custom.steps import Steps
from sigmaswarm.filters.reference import ExtendedKalmanFilter, SigmaPoints, UnscentedKalmanFilter
from sigmaswarm.filters.reference.gaussian import GaussianFilter, Innovation

FAILURES = (SigmaswarmError, np.linalg.LinAlgError, ArithmeticError, ValueError)
"""What ends a filter without ending the tuning: no square root, or a function outside of its domain."""


@dataclass(frozen=True, eq=False)
class Run:
    """What a filter did with a log.

    Attributes
    ----------
    mean, covariance : ndarray, shapes (k, n), (k, n, n)
        At the log's ``time``, after all measurements up to then. The covariance is empty where none was asked for.
    nis, nll : ndarray, shape (f,)
        Of each measurement before it is absorbed: normalized innovation squared, negative log-likelihood.
    failed : int
        The step in which the filter failed, or -1.
    """

    mean: Array
    covariance: Array
    nis: Array
    nll: Array
    failed: int

    @classmethod
    def empty(cls, steps: Steps, *, covariances: bool) -> "Run":
        """NaN all over."""
        k, n = len(steps.inputs), len(steps.mean)
        wide = np.full((k if covariances else 0, n, n), np.nan)
        each = np.full((2, len(steps.measurements)), np.nan)
        return cls(np.full((k, n), np.nan), wide, each[0], each[1], -1)


def run_textbook(model: Model, steps: Steps, scaling: Array, p: Any, *, covariances: bool = True) -> Run:
    """Run the reference filter; ``scaling`` is alpha, beta, kappa, ``p`` the model's record."""
    run = Run.empty(steps, covariances=covariances)
    step = 0
    try:
        with np.errstate(all="ignore"):  # what comes of it is looked at
            noise = as_covariance(model.measurement_noise(p))
            kalman = reference_filter(model, steps, scaling, p)
            for step in range(len(steps.dt)):
                take(model, kalman, steps, step, p, noise, run)
    except FAILURES:
        return replace(run, failed=step)
    return run


def reference_filter(model: Model, steps: Steps, scaling: Array, p: Any) -> GaussianFilter:
    """The model's filter at the start of a log."""

    def f(state: Array, dt: float, u: Array) -> Array:
        return np.asarray(model.f(state.copy(), dt, u, p))  # a copy: f may work in place

    def h(state: Array) -> Array:
        return np.asarray(model.h(state.copy(), p))

    if model.kind == "ekf":
        return ExtendedKalmanFilter(f, h, steps.mean, steps.covariance, measured_angles=model.measured_angles)
    alpha, beta, kappa = (float(value) for value in scaling)
    points = SigmaPoints(alpha, beta, kappa)
    return UnscentedKalmanFilter(
        f,
        h,
        steps.mean,
        steps.covariance,
        points,
        angles=model.places(model.angles),
        measured_angles=model.measured_angles,
    )


def take(
    model: Model, kalman: GaussianFilter, steps: Steps, step: int, p: Any, noise: Array, run: Run
) -> None:
    """Take one step, absorb what there is at its end, and write down what came of it."""
    dt, row, at = float(steps.dt[step]), steps.absorbs[step], steps.records[step]
    if dt > 0:
        kalman.predict(dt, steps.inputs[steps.source[step]], as_covariance(model.process_noise(dt, p)))
    if row >= 0:
        innovation = kalman.measure(steps.measurements[row], noise)
        run.nis[row], run.nll[row] = innovation.nis, negative_log_likelihood(innovation)
        kalman.absorb(innovation)
    if not (np.isfinite(kalman.mean).all() and np.isfinite(kalman.covariance).all()):
        raise ArithmeticError("the state is no finite number any more")
    if at >= 0:
        run.mean[at] = kalman.mean
        if len(run.covariance):
            run.covariance[at] = kalman.covariance


def negative_log_likelihood(innovation: Innovation) -> float:
    """-log N(nu; 0, S); raises `numpy.linalg.LinAlgError` where S is no covariance."""
    root = np.linalg.cholesky(innovation.variance)
    log_det = 2 * np.log(np.diag(root)).sum()
    return float(0.5 * (innovation.nis + log_det + len(innovation.nu) * np.log(2 * np.pi)))
