"""Estimate of the gyro bias from the last few seconds before a start, and its use by filters.

A cheap gyro may start with a bias of 20 deg/s. With this bias, the path computed from the gyro is curved differently
from the path of the fixes, and the integrated roll and pitch drift. With these effects, the bias can be estimated with
an accuracy of about 1 deg/s. The prior of a cheap gyro is far less accurate. The prior of a good gyro is narrower
(``bias_std`` below 1 deg/s), so the evidence hardly changes the estimate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached

UP = 2  # axis of the rate about the vertical
CONTRADICTS = 5.0  # standard deviations; an alignment subtracts a larger bias about the vertical axis
OUTLIER_PROBABILITY = 1e-5
"""Prior probability that the gyro is far worse than in the training drives.

A bias above about five standard deviations makes this likely. If this probability were 1e-3, the standard deviation of
a good gyro's bias would increase by 0.07 deg/s.
"""
OUTLIER_STD = 0.2  # rad/s, standard deviation of such a gyro's bias; an MPU-6050 may have a bias of 20 deg/s
YAW_STD = np.radians(1.0)  # rad/s, smallest standard deviation of a fitted bias: cars slip, receivers smooth
TURN_SHARE = 0.3  # part of a turn's mean rate that may look like a bias, since fixes lag and cars slip
TILT_CHANGE_STD = np.radians(8.0)  # rad, standard deviation of tilt changes in a few seconds, as on hills
MAX_BIAS = 0.5  # rad/s, largest bias of a gyro; fixes that suggest a larger bias have jumped


@dataclass(frozen=True, eq=False)
class GyroBiasEvidence:
    """Evidence about the gyro bias from one alignment.

    ``bias`` and ``variance`` (3,), about the forward, left and up axes, are in rad/s and (rad/s)^2; an unknown axis has
    infinite variance. The alignment's mean and covariance assume the bias ``taken`` (vertical axis, rad/s). ``turns``
    (5,) is the change of x, y, vx, vy, theta per rad/s of bias.
    """

    bias: Array
    variance: Array
    taken: float
    turns: Array

    def with_bias(self, known: float) -> "GyroBiasEvidence":
        """Return the evidence about the raw gyro; before the alignment, ``known`` (rad/s) was subtracted from it."""
        bias = self.bias.copy()
        bias[UP] += known
        return replace(self, bias=bias, taken=self.taken + known)

    def update(self, mean: Array, covariance: Array, indices: Sequence[int], std: float) -> None:
        """Update ``mean`` (n,) and ``covariance`` (n, n) of the states at the start, in place.

        ``std`` is the prior standard deviation of the biases, rad/s. ``indices`` contains, for each axis, the index of
        the state that is its bias; it is negative if there is none.
        """
        bias, variance, used = np.zeros(3), np.zeros(3), np.array(indices, dtype=np.int64)
        mix_biases(self.bias, self.variance, used, std, bias, variance)
        update_biases(mean, covariance, used, bias, variance, self.taken, self.turns)


@cached(error_model="numpy")
def mix_biases(
    observed: Array, unsure: Array, indices: NDArray[np.int64], std: float, bias: Array, variance: Array
) -> None:
    """Combine the observed biases and their variances with a prior. Write the mean and variance of each estimated bias.

    The prior is a mixture of two normal distributions with mean 0. Their standard deviations are ``std`` (rad/s) and,
    for a far worse gyro with the probability `OUTLIER_PROBABILITY`, `OUTLIER_STD`. The likelihood of all axes
    determines the weights.
    """
    usual, outlier = std * std, OUTLIER_STD * OUTLIER_STD
    odds = np.log((1.0 - OUTLIER_PROBABILITY) / OUTLIER_PROBABILITY)
    for axis in range(3):
        if indices[axis] >= 0:
            square, noise = observed[axis] * observed[axis], unsure[axis]
            odds -= 0.5 * (square / (usual + noise) + np.log(1.0 + usual / noise))
            odds += 0.5 * (square / (outlier + noise) + np.log(1.0 + outlier / noise))
    share = 1.0 / (1.0 + np.exp(min(max(odds, -700.0), 700.0)))  # probability of a far worse gyro
    for axis in range(3):
        left, left_outlier = usual / (1.0 + usual / unsure[axis]), outlier / (1.0 + outlier / unsure[axis])
        of, of_outlier = observed[axis] * left / unsure[axis], observed[axis] * left_outlier / unsure[axis]
        mean = (1.0 - share) * of + share * of_outlier
        bias[axis] = mean
        variance[axis] = (1.0 - share) * (left + (of - mean) * (of - mean))
        variance[axis] += share * (left_outlier + (of_outlier - mean) * (of_outlier - mean))


@cached(error_model="numpy")
def update_biases(
    mean: Array,
    covariance: Array,
    indices: NDArray[np.int64],
    bias: Array,
    variance: Array,
    taken: float,
    turns: Array,
) -> None:
    """Write the biases to the state, and correct its first five elements, which assume the vertical bias ``taken``."""
    for axis in range(3):
        index = indices[axis]
        if index >= 0:
            mean[index] = bias[axis]
            covariance[index, index] = variance[axis]
            for i in range(5 if axis == UP else 0):
                mean[i] += (bias[axis] - taken) * turns[i]
                covariance[i, index] = variance[axis] * turns[i]
                covariance[index, i] = covariance[i, index]
                for j in range(5):
                    covariance[i, j] += variance[axis] * turns[i] * turns[j]
