"""Run any textbook filter over the steps of a drive or a log, and smooth its estimates (Rauch, Tung and Striebel).

Sources: H. E. Rauch, F. Tung and C. T. Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA Journal
3, 1965. S. Sarkka, Unscented Rauch-Tung-Striebel smoother, IEEE Transactions on Automatic Control 53(3), 2008.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm.filters.textbook.kalman import GaussianFilter, Prediction

FAILURES = (SigmaswarmError, np.linalg.LinAlgError, ArithmeticError, ValueError)
"""Errors that end a filter but not a tuning: P without a square root, or an argument outside a function's domain."""


class Stepper(Protocol):
    filter: GaussianFilter

    def step(self, i: int) -> None:
        """Compute step i: predict, then update with the measurements at its end."""
        ...


@dataclass(frozen=True, eq=False)
class Trajectory:
    mean: Array  # (k, n), NaN after a failure
    covariance: Array  # (k, n, n), or empty
    failed: int  # step in which the filter failed, or -1

    @classmethod
    def empty(cls, k: int, n: int, *, covariances: bool = True, failed: int = -1) -> "Trajectory":
        return cls(np.full((k, n), np.nan), np.full((k if covariances else 0, n, n), np.nan), failed)


def run_steps(
    stepper: Stepper, records: Sequence[int], *, n_rows: int, covariances: bool = True
) -> Trajectory:
    """Compute all steps, or the steps before a failure.

    ``records`` contains, for each step, the row of the trajectory that stores the state after the step; -1 stores
    nothing. ``n_rows`` is the number of rows of the trajectory.
    """
    trajectory = Trajectory.empty(n_rows, len(stepper.filter.mean), covariances=covariances)
    for i, row in enumerate(records):
        if _fails(stepper, i):
            return Trajectory(trajectory.mean, trajectory.covariance, i)
        if row >= 0:
            trajectory.mean[row] = stepper.filter.mean
            if covariances:
                trajectory.covariance[row] = stepper.filter.covariance
    return trajectory


def _fails(stepper: Stepper, i: int) -> bool:
    try:
        with np.errstate(all="ignore"):  # the result is checked
            stepper.step(i)
    except FAILURES:
        return True
    return not (np.isfinite(stepper.filter.mean).all() and np.isfinite(stepper.filter.covariance).all())


def smooth_steps(stepper: Stepper, n_steps: int) -> Trajectory:
    """Return smoothed states at the start and after each step before a failure."""
    filter, failed = stepper.filter, -1
    filtered, predictions = [(filter.mean, filter.covariance)], list[Prediction]()
    for i in range(n_steps):
        mean, covariance = filtered[-1]
        filter.prediction = Prediction(mean, covariance, covariance)  # remains if the step has no prediction
        if _fails(stepper, i):
            failed = i
            break
        filtered.append((filter.mean, filter.covariance))
        predictions.append(filter.prediction)
    means, covariances = [filtered[-1][0]], [filtered[-1][1]]
    for (mean, covariance), prior in zip(filtered[-2::-1], predictions[::-1], strict=True):
        gain = np.linalg.solve(prior.covariance, prior.cross.T).T  # G = C (P-)^-1
        change = covariances[-1] - prior.covariance
        means.append(filter.plus(mean, gain @ filter.minus(means[-1], prior.mean)))  # m + G (m^s' - m-)
        covariances.append(covariance + gain @ change @ gain.T)  # P + G (P^s' - P-) G^T
    return Trajectory(np.array(means[::-1]), np.array(covariances[::-1]), failed)
