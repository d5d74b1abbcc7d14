"""Constants of measurements and IMU gaps, shared by all implementations of a filter."""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters

STANDSTILL_RATE_NOISE = np.radians(0.5) ** 2  # rad2/s2, variance of the gyro's reading around its bias
SLIP_GATE = 9.0
"""Largest accepted NIS of a wheel speed: three sigmas.

The errors of slipping or locked wheels last for seconds, so even updates with small weights would add up. The number of
consecutive rejections is not limited: during rejections the speed is estimated from the fixes, and P grows until the
true speed is plausible.
"""
HEADING_GATE = 9.0
"""Upper limit of the NIS of a heading.

If the NIS is larger, S is increased until the NIS has this value (G. Chang, Robust Kalman filtering based on
Mahalanobis distance as outlier judging criterion, Journal of Geodesy 88, 2014). A filter with a wrong heading can
therefore recover.
"""
MOST_REJECTED = 5  # the gate rejects at most this many consecutive fixes, so that a filter can recover

# Standard deviations of the motion in an IMU gap relative to the mean of the adjacent samples
GAP_TURN_STD = 0.1  # rad/s; 0.05 to 0.3 give equal results
GAP_ACCELERATION_STD = 1.0  # m/s2 per axis; 0.5 to 2 give equal results
GAP_TILT_STD = 0.01  # rad/s about east and north; 0.02 gives equal results


def gap_covariance(n: int, dt: float, gap: float) -> Array:
    """Return the covariance (n, n) that a step of ``dt`` s in a gap of ``gap`` s adds to P + Q; 0 without a gap.

    The unobserved motion is a constant turn rate and a constant acceleration over the gap. Together, the steps in a gap
    therefore add (GAP_TURN_STD gap)^2 to the variance of the heading and (GAP_ACCELERATION_STD gap)^2 to the variance
    of each velocity. In each step, the position changes by dt / 2 times the change of velocity. `GAP_TILT_STD` is not
    included.
    """
    added = np.zeros((n, n))
    g = GAP_ACCELERATION_STD**2 * gap * dt
    for p, v in ((0, 2), (1, 3)):
        added[v, v] = g
        added[p, p] = g * dt * dt / 4.0
        added[p, v] = added[v, p] = g * dt / 2.0
    added[THETA, THETA] = GAP_TURN_STD**2 * gap * dt
    return added


def process_noise_per_step(p: FilterParameters, nominal_interval: float) -> Array:
    """Convert the diagonal of Q, (n,), from ``p.nominal_interval`` to the nominal IMU interval (s) of a drive."""
    return nominal_interval / (p.nominal_interval or nominal_interval) * np.array(p.process_noise)


# Student's t, for filters and objectives that are robust to outliers. With v degrees of freedom, it is a Gaussian whose
# covariance is divided by a random weight. The weight has a gamma distribution with mean 1; for an outlier it is small.
ITERATIONS = 3  # number of alternating estimates of the state and the weight of a fix
OUTLYING = 0.25  # a fix with a smaller weight is an outlier
OUTLIERS = 3  # number of consecutive outliers, over at least OUTLIERS_SPAN, after which P is inflated
OUTLIERS_SPAN = 5.0  # s

# The scale of an objective is c = 2 x, where x e^x E1(x) = v / (v + 2) and E1 is the exponential integral. With this c,
# the mean of ln det S / 2 + (v + 2) / 2 ln(1 + NIS / c) over Gaussian innovations is least where their mean NIS is 2,
# as for the Gaussian likelihood. With c = v (Student's density), it is least at a mean NIS of 2.75 (v = 4) or
# 2.42 (v = 8).
INNOVATION_DOF, INNOVATION_SCALE = 4.0, 2.9069903810286775  # v and c of `innovation-t`
FORECAST_DOF, FORECAST_SCALE = 8.0, 6.609907797270899  # v and c of `forecast-t`
LARGEST_TAIL = 1e38  # upper limit of 1 + NIS / c in `innovation-t`; a product of eight cannot overflow


# Of fuzzy filters, see `textbook.adaptive.FuzzyNoise`
LARGEST_RATIO = 10.0  # upper limit of d, against outliers; for good fixes, one d in 20 000 is larger
SLOWER = 4.0  # ratio of the time constants of the two averages
