"""Gyro bias from the last few seconds before a start, and its use by filters.

A cheap gyro may start with a bias of 20 deg/s. With this bias, the curvature of the gyro's path differs from that of
the fixes, and the integrated roll drifts. Both effects determine the bias to about 1 deg/s. This accuracy is far better
than that of a cheap gyro's prior. A good gyro has a ``bias_std`` below 1 deg/s and keeps its prior.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.drives.tables import Array

UP = 2  # axis of the rate about the vertical
CONTRADICTS = 5.0  # standard deviations; an alignment subtracts a larger bias about the vertical axis
OUTLIER_PROBABILITY = 1e-5
"""Prior probability that the gyro is far worse than in the training drives; a bias of five sigmas confirms this.

With 1e-3, the standard deviation of a good gyro's bias would increase by 0.07 deg/s.
"""
# rad/s, standard deviation of a far worse gyro's bias; an uncalibrated MPU-6050 may have 20 deg/s
OUTLIER_STD = 0.2
# rad/s, smallest standard deviation of the bias, since cars slip and receivers smooth
YAW_STD = np.radians(1.0)
TURN_SHARE = 0.3  # share of a turn's mean rate that may look like a bias, since fixes lag and the car slips
# rad, standard deviation of changes of roll and pitch in a few seconds, as on hills
TILT_CHANGE_STD = np.radians(8.0)
MAX_BIAS = 0.5  # rad/s, largest bias of a gyro; fixes that suggest a larger bias have jumped


@dataclass(frozen=True, eq=False)
class GyroBiasEvidence:
    """Evidence about the gyro bias from one alignment, or from several, stacked.

    ``bias`` and ``variance`` (3,), about forward, left and up, are in rad/s and (rad/s)^2; an unknown axis has infinite
    variance. The alignment's mean and covariance assume the bias ``taken``, rad/s, about up; ``turns`` (5,) is the
    change of x, y, vx, vy, theta per rad/s of bias.
    """

    bias: Array
    variance: Array
    taken: float
    turns: Array

    def with_bias(self, known: float) -> "GyroBiasEvidence":
        """Return the evidence for the original gyro, before a known bias about up, rad/s, was subtracted."""
        bias = self.bias.copy()
        bias[UP] += known
        return replace(self, bias=bias, taken=self.taken + known)

    def update(self, mean: Array, covariance: Array, places: Mapping[int, int], std: Array) -> None:
        """Update ``mean`` (..., n) and ``covariance`` (..., n, n) of the states at the start, in place.

        The bias follows from two measurements: 0 with standard deviation ``std`` (...), rad/s, and the observed bias.
        Alternatively, the gyro is far worse (`OUTLIER_PROBABILITY`, `OUTLIER_STD`). The two cases are weighted by the
        likelihood of all axes. ``places`` maps each axis, 0 to 2, with an estimated bias to its state.
        """
        std, axes = np.asarray(std)[..., None], [*places]
        usual, outlier = (self._measured(prior, axes) for prior in (std, np.array([OUTLIER_STD])))
        odds = np.log(OUTLIER_PROBABILITY / (1 - OUTLIER_PROBABILITY)) + outlier[2] - usual[2]
        share = 1.0 / (1.0 + np.exp(np.clip(-odds, -700.0, 700.0)))
        bias = (1 - share) * usual[0] + share * outlier[0]
        parts = [case[1] + (case[0] - bias) ** 2 for case in (usual, outlier)]
        variance = (1 - share) * parts[0] + share * parts[1]
        for k, (axis, place) in enumerate(places.items()):
            mean[..., place], covariance[..., place, place] = bias[..., k], variance[..., k]
            if axis == UP:
                across = variance[..., k, None] * self.turns
                mean[..., :5] += (bias[..., k, None] - np.asarray(self.taken)[..., None]) * self.turns
                covariance[..., :5, :5] += across[..., None] * self.turns[..., None, :]
                covariance[..., :5, place] = covariance[..., place, :5] = across

    def _measured(self, std: Array, axes: list[int]) -> tuple[Array, Array, Array]:
        """Return biases and variances, (..., k), for a prior standard deviation, and the log-likelihood, (..., 1)."""
        seen, variance = self.bias[..., axes], self.variance[..., axes]
        left = std**2 / (1.0 + std**2 / variance)
        surprise = seen**2 / (std**2 + variance) + np.log(1.0 + std**2 / variance)
        return seen * left / variance, left, -0.5 * surprise.sum(axis=-1, keepdims=True)
