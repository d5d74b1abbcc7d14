"""A textbook filter over the steps of a drive or a log, whatever its model is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm.filters.textbook.gaussian import GaussianFilter

FAILURES = (SigmaswarmError, np.linalg.LinAlgError, ArithmeticError, ValueError)
"""What ends a filter without ending the tuning: no square root, or a function outside of its domain."""


class Stepper(Protocol):
    """A filter on a time line."""

    filter: GaussianFilter

    def step(self, i: int) -> None:
        """Take step i: predict, then absorb what there is at its end."""
        ...


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What a filter believed at some moments.

    Attributes
    ----------
    mean, covariance : ndarray, shapes (k, n), (k, n, n)
        NaN from a failure on. The covariance is empty where none was asked for.
    failed : int
        The step in which the filter failed, or -1.
    """

    mean: Array
    covariance: Array
    failed: int

    @classmethod
    def empty(cls, k: int, n: int, *, covariances: bool = True, failed: int = -1) -> "Trajectory":
        """NaN at k moments, of n states."""
        return cls(np.full((k, n), np.nan), np.full((k if covariances else 0, n, n), np.nan), failed)


def run_steps(
    stepper: Stepper, records: Sequence[int], *, n_rows: int, covariances: bool = True
) -> Trajectory:
    """Take all steps; ``records`` says for each which of ``n_rows`` rows of the trajectory it writes, or -1."""
    n, failed = len(stepper.filter.mean), -1
    trajectory = Trajectory.empty(n_rows, n, covariances=covariances)
    for i, row in enumerate(records):
        try:
            with np.errstate(all="ignore"):  # what comes of it is looked at
                stepper.step(i)
        except FAILURES:
            failed = i
        mean, covariance = stepper.filter.mean, stepper.filter.covariance
        if failed >= 0 or not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            return Trajectory(trajectory.mean, trajectory.covariance, i)
        if row >= 0:
            trajectory.mean[row] = mean
            if covariances:
                trajectory.covariance[row] = covariance
    return trajectory
