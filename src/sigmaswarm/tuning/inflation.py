"""Sensitivity of the cost to each parameter, and inflation of the process noise.

The process noise is inflated so that the filter suits roads and IMUs that the tuning did not use. Inflation selects the
largest noise whose cost is close to the lowest cost, similar to the one-standard-error rule (L. Breiman et al.,
Classification and Regression Trees, 1984, section 3.4.3). A longer drive allows a more accurate estimate of the noise,
so a smaller cost increase is allowed.

For a planar model, all process noise is inflated except the random walk of the gyro's bias. The noise of the velocity
is included, since it represents the tilt of roads. The random walk can hardly be estimated from one drive: an inflation
to 1e-7 (rad/s)2/s raised the heading error on another car's drive by 29%. For a model with roll and pitch, the random
walks of the biases are inflated by the factor, and the noise of position and velocity by the square root of the factor.
If position and velocity had the whole factor, the position RMSE on another car's drive would be 0.86 instead of 0.65
times that of the fixes. If they were not inflated, the heading error with a cheap IMU would be 50% larger. The noises
of heading and yaw rate in robot-localization are not inflated, since they do not depend on roads.

A factor hardly changes a noise near zero. In a filter with roll and pitch, the noise of these angles, the random walks
of the gyro's x and y biases, and the standard deviations of the initial biases therefore have minima
(`space.INFLATION_MINIMA`). With these minima, a filter that was tuned on one drive has a position RMSE of 0.8 m instead
of 1.7 m on another car's drive. On drives of the same car, the minima change the RMSE by -5 to +2%. The standard
deviations of the initial biases are estimated from three or more drives with truth. The minima for these parameters
then do not apply, since they would increase the heading error by 10%. Instead, the standard deviation of the gyro's
bias is at least the value that the biases on these drives predict for another drive.

The standard deviation of the gyro's initial bias has another minimum if the starts of the training drives show biases.
At its start, a filter subtracts a bias of many standard deviations (`GyroBiasEvidence.update`), so the cost hardly
depends on this parameter. For a gyro with biases of 0.2 rad/s, the tuned standard deviation was 5e-5 rad/s, and the
filter diverged on drives with a smaller bias.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment_fit import InitialState
from sigmaswarm.filters.models import MODELS
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.tuning.problem import CarProblem, Problem, duration_share

MAX_INCREASE = 0.01
NOISE_SCALE = "all noise variances times"


@dataclass(frozen=True)
class Sensitivity:
    """Range of one parameter in which the cost increases by less than 1%.

    Attributes
    ----------
    name : str
    value : float
        Value in the tuned filter. For the common factor on all noise variances (`NOISE_SCALE`), this value is 1.
    lowest, highest : float or None
        Values at which the cost has increased by 1%; None if the cost at the bound is lower.
    lowest_rise : float
        Lowest relative change of the cost at the tried values; negative if the search had not converged.
    """

    name: str
    value: float
    lowest: float | None
    highest: float | None
    lowest_rise: float = 0.0

    @property
    def identified(self) -> bool:
        return self.lowest is not None or self.highest is not None


def sensitivities(
    problem: Problem[Any], point: Array, cost: float, executor: Executor | None
) -> tuple[Sensitivity, ...]:
    """Move each parameter in both directions from the best point, shape (d,), until the cost has increased by 1%.

    Only one parameter changes at a time, so trade-offs between parameters are not visible. The exception is a common
    factor on all noise variances, which is varied like a parameter. For costs in nats, see
    `Objective.relative_increase`.
    """
    space, names, axes = problem.space, [*problem.space.names], np.eye(len(point))
    down, up = ((bound - point)[:, np.newaxis] * axes for bound in (space.low, space.high))
    noises = space.logarithmic & space.noises
    if noises.any():
        # Two decades each way, also beyond the bounds; otherwise a variance at its bound would keep the factor at 1.
        together = np.where(noises, 2.0, 0.0)
        down, up = np.vstack([down, -together]), np.vstack([up, together])
        names.append(NOISE_SCALE)

    def value(k: int, at: Array) -> float:
        first = int(np.argmax(noises))
        return float(space.values(at)[k] if k < len(point) else 10 ** (at[first] - point[first]))

    shares = np.array([0.5**k for k in range(10, -1, -1)])  # fractions of the distance to the bound
    steps = np.stack([down, up], axis=1)
    points = (point + shares[:, np.newaxis] * steps[:, :, np.newaxis]).reshape(-1, len(point))
    # If a parameter is at a bound, its points in the direction of this bound are equal.
    tried, inverse = np.unique(points, axis=0, return_inverse=True)
    rises = problem.relative_increase(problem.costs(tried, executor)[inverse], cost)
    rises = rises.reshape(len(names), 2, len(shares))
    result: list[Sensitivity] = []
    for k, name in enumerate(names):
        reached = zip([_crossing(shares, rise) for rise in rises[k]], steps[k], strict=True)
        ends = [None if s is None else value(k, point + s * step) for s, step in reached]
        result.append(Sensitivity(name, value(k, point), *ends, lowest_rise=float(min(rises[k].min(), 0.0))))
    return tuple(result)


def _crossing(shares: Array, rise: Array) -> float | None:
    """Return the interpolated fraction of the distance at which the cost has increased by 1%; None if it has not."""
    above = np.flatnonzero(~(rise < MAX_INCREASE))
    if not len(above):
        return None
    k = int(above[0])
    share, before = (0.0, 0.0) if k == 0 else (float(shares[k - 1]), float(rise[k - 1]))
    if not np.isfinite(rise[k]):
        return share
    return share + (float(shares[k]) - share) * (MAX_INCREASE - before) / (float(rise[k]) - before)


INFLATION, TILTED_INFLATION, WITH_TRUTH = 0.05, 0.02, 0.01
"""Default limits of the relative cost increase.

The limits are those of planar models without truth, of other models without truth, and of tilted12 with truth.
"""
MIN_DRIVES_WITH_TRUTH = 3
"""Smallest number of drives with truth for an estimate of the standard deviations of the initial biases."""
REFERENCE_DURATION, TILTED_DURATION = 100.0, 150.0
"""Total driving times (s) up to which the whole cost increase is allowed.

The first time is for planar models, the second for models with roll and pitch. At twice this time, half of the increase
is allowed. On the 72 pairs of drives of `benchmarks/road_matrix.py`, the position RMSE of planar8 is 1 to 2% lower with
100 s than with 150 s, and its 5 s drift is 3 to 4% lower. With roll and pitch, a filter was tuned on 200 s of
kitti-09-30-0018 and tested on kitti-09-30-0033. The 95% radius contained 83% of its errors with 100 s, and 90% with 150
s; the position RMSE on the training roads differed by less than 1%. Shorter drives do not allow a larger increase:
after tuning on 60 s of a highway, an increase of 0.086 instead of 0.05 raised the 5 s drift on other roads by 20%.
"""
MIN_BIAS_RATIO = 5.0
"""Smallest ratio bias^2 / variance, averaged over initial alignments and axes, at which gyro biases are significant.

This mean is at most 1.4 on real drives and with a simulated ICM-20602, and 7 to 90 with a simulated MPU-6050.
"""
MAX_DECADES = 4.0  # decades; the largest factor is 10^4
STEP = 0.1  # decades between two factors


def inflate(
    problem: CarProblem, point: Array, allowed: float, executor: Executor | None
) -> tuple[Array, float, float]:
    """Inflate the process noise of a point, shape (d,), within the bounds, as much as its cost permits.

    ``allowed`` is the largest relative increase of the cost without a prior. It is reduced for driving times above the
    reference. Parameters below their minima are then raised to these minima. Return the new point, its cost and the
    inflation factor.
    """
    space = problem.space
    decades = np.arange(0.0, MAX_DECADES + STEP / 2, STEP)
    points = np.minimum(point + decades[:, None] * space.inflation, np.maximum(space.high, point))
    costs = problem.costs_without_prior(points, executor)
    reference = TILTED_DURATION if MODELS[problem.config.model].tilts else REFERENCE_DURATION
    share = allowed * duration_share(problem.data, reference)
    within = np.logical_and.accumulate(problem.relative_increase(costs, costs[0]) <= share)
    last, least = int(within.sum()) - 1 if within.any() else 0, space.least
    if len(problem.data) >= MIN_DRIVES_WITH_TRUTH and parse_objective(problem.config.objective).needs_truth:
        least = np.where([one.field == "bias_std" for one in space.dimensions], -np.inf, least)
    if shown := max(shown_bias(problem.starts()), predicted_bias(problem.true_gyro_biases())):
        gyro = [name == "gyro_bias_std" for name in space.names]
        least = np.where(gyro, np.maximum(least, np.minimum(np.log10(shown), space.high)), least)
    chosen = np.maximum(points[last], least)
    return chosen, float(problem.costs(chosen[np.newaxis], executor)[0]), float(10 ** decades[last])


def shown_bias(starts: Sequence[InitialState]) -> float:
    """Return the RMS of the gyro biases at the starts (rad/s), corrected for their errors; 0 if insignificant."""
    gyros = [start.gyro for start in starts if start.gyro is not None]
    bias, variance = (np.array([getattr(one, what) for one in gyros]) for what in ("bias", "variance"))
    # The variance of an axis that was not observed is infinite.
    known = np.isfinite(bias) & np.isfinite(variance)
    squares, variance = np.square(bias[known]), variance[known]
    if not known.any() or np.mean(squares / variance) < MIN_BIAS_RATIO:
        return 0.0
    return float(np.sqrt(max(np.mean(squares - variance), 0.0)))


def predicted_bias(biases: Sequence[float]) -> float:
    """Return the standard deviation (rad/s) that the gyro bias has on another drive, from true biases; 0 if unknown.

    For a mean of zero, the bias on another drive has a Student's t distribution with n degrees of freedom (n drives).
    For n < 3, the standard deviation of this distribution is infinite, and the RMS of the biases is returned instead.
    """
    known = np.array([bias for bias in biases if np.isfinite(bias)])
    if not len(known):
        return 0.0
    unknown = len(known) / (len(known) - 2) if len(known) > 2 else 1.0
    return float(np.sqrt(np.mean(np.square(known)) * unknown))
