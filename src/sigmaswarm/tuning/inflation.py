"""Inflate the process noise, for roads and IMUs that the tuning did not use.

Tuning on one drive can make the process noise too small for other roads, temperatures or IMUs. The filter is
overconfident there and rejects good fixes. A remedy from statistics is to choose the simplest model within one standard
error of the best (L. Breiman et al., Classification and Regression Trees, 1984, section 3.4.3). Likewise, inflation
chooses the largest process noise whose cost is close to the lowest. A longer drive determines the noise better, so
the allowed cost increase is smaller. It is constant for drives shorter than `REFERENCE_DURATION`.

A planar model inflates all process noise by one factor, since the velocity's noise represents the tilt of roads. A
model with roll and pitch inflates the random walks of the IMU biases by the factor, and the noise of position and
velocity by its square root. If position and velocity were inflated by the whole factor, results on the same car would
not change, but the error on another car would be 0.86 instead of 0.65 of the fixes' error. Without inflation of
position and velocity, the heading error with a cheap IMU is 50% larger, since the filter interprets vibration as
biases.

The model robot-localization inflates the noise of position, velocity and acceleration. It does not inflate heading and
yaw rate, which do not depend on roads. The default cost increase comes from filters tuned without truth on each of six
drives (two more KITTI roads, kingston-1, dresden, half of colorado-1) and evaluated on the others. With 0.02 the pose
errors on the same car's drives were smallest. On other cars' drives larger values are better, but no value is safe:
tune this model on the same car.

A good IMU on a smooth road can reduce a noise to zero, and inflation can't correct this: ten times 1e-13 is still
negligible. A filter with roll and pitch therefore has lower limits (`space.LEAST`): initial bias deviations of
0.005 m/s2 and 0.01 deg/s, and random walks of roll, pitch and the gyro biases about x and y. These limits increase the
error on the training roads by 1 to 6%. A filter tuned on one KITTI drive has an error of 0.9 m on colorado-1, instead
of 3.1 m.
"""

from concurrent.futures import Executor
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.problem import Problem

INFLATION, TILTED_INFLATION = 0.05, 0.02
"""Default relative cost increases without truth, for planar models driven by the IMU and for the other models."""
REFERENCE_DURATION = 100.0
"""Seconds of driving that the cost increase refers to; twice the duration allows half the increase.

The increase is not larger for shorter drives. On 60 s of a motorway, an increase of 0.086 instead of 0.05 made drifts
over 5 s on other roads 1.2 times as large.
"""
DECADES = 4.0
"""Largest decimal logarithm of the factor."""
STEP = 0.1
"""Decades between two factors that are tried."""


def inflated(
    problem: Problem[Any], point: Array, cost: float, allowed: float, executor: Executor | None
) -> tuple[Array, float, float]:
    """Inflate the process noise of the best point, shape (d,), until the cost has risen by the allowed share.

    ``allowed`` is the relative cost increase for up to `REFERENCE_DURATION` seconds of driving. The function returns
    the last point within it (after applying the lower limits), its cost, and the largest factor of any noise. All noise
    variances stay within their bounds.
    """
    space = problem.space
    decades = np.arange(0.0, DECADES + STEP / 2, STEP)
    points = np.minimum(point + decades[:, None] * space.inflation, np.maximum(space.high, point))
    costs = problem.costs(points, executor)
    share = allowed * min(1.0, REFERENCE_DURATION / sum(entry["duration_s"] for entry in problem.data))
    within = np.logical_and.accumulate(problem.rise(costs, cost) <= share)
    last = int(within.sum()) - 1 if within.any() else 0
    chosen = np.maximum(points[last], space.least)
    if np.array_equal(chosen, points[last]):
        return chosen, float(costs[last]), float(10 ** decades[last])
    return chosen, float(problem.costs(chosen[np.newaxis], executor)[0]), float(10 ** decades[last])
