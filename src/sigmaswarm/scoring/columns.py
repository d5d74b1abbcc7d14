"""Columns of a track: position, errors against truth, and 3 sigma of each estimate."""

import numpy as np

from sigmaswarm.drives.drive import Array, Truth
from sigmaswarm.filters.models import THETA
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.score import truth_at
from sigmaswarm.scoring.truth_noise import is_known


class TrueMotion:
    """Truth prepared for comparison with estimates in pieces."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._theta = np.unwrap(truth.theta)

    def distance(self, time: Array, x: Array, y: Array) -> Array:
        """Distance from the truth, m; NaN where truth is not known."""
        true_x, true_y = truth_at(self._truth, time)
        return np.hypot(x - true_x, y - true_y)

    def heading_error(self, time: Array, theta: Array) -> Array:
        """Heading error, deg; NaN where truth is not known."""
        true = np.where(is_known(self._truth, time), np.interp(time, self._truth.time, self._theta), np.nan)
        return np.degrees(wrap_angle(theta - true))


def columns_of(time: Array, mean: Array, covariance: Array, truth: TrueMotion | None) -> dict[str, Array]:
    """Columns of `Tracks` from means (r, n) and covariances (r, n, n), or an empty array."""
    columns = {"time": time, "x": mean[:, 0], "y": mean[:, 1]}
    if truth is not None:
        columns["position_error"] = truth.distance(time, mean[:, 0], mean[:, 1])
        columns["heading_error"] = truth.heading_error(time, mean[:, THETA])
    if len(covariance):
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        columns["position_3sigma"] = 3 * np.hypot(std[:, 0], std[:, 1])
        columns["heading_3sigma"] = 3 * np.degrees(std[:, THETA])
    return columns
