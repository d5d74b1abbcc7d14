"""Process-noise inflation, for roads and IMUs that the tuning has not seen.

A filter tuned on one drive trusts its model as far as that drive allows. On other roads, on a warmer day or with
another IMU it is then overconfident and rejects good fixes. Statisticians take the simplest model within one standard
error of the best (L. Breiman et al., Classification and Regression Trees, 1984, section 3.4.3). Likewise, the filter
with the largest process noise is taken among those whose cost is nearly the best. Longer drives determine more, so the
allowed cost increase falls with their length; it does not rise for drives shorter than `REFERENCE_DURATION`.

A planar model inflates all process noise by one factor, since the velocity's noise represents the tilt of roads. A
model with roll and pitch inflates the random walks of the IMU's biases, which it otherwise assumes constant, by the
factor, and the noise of position and velocity by its root. Raised by the whole factor, these cost the same on the same
car and help less on another one (0.86 of the fixes' own error instead of 0.65). Not raised, the heading error with a
cheap IMU grows by half, since the filter mistakes vibration for biases.

The model robot-localization inflates the noise of position, velocity and acceleration, and leaves heading and yaw rate
alone, which do not depend on roads. Filters were tuned without truth on each of six drives (two more KITTI roads,
kingston-1, dresden, half of colorado-1) and evaluated on the others: 0.02 gave the smallest errors of pose on the same
car's drives. Other cars' drives gain from more, but no value is safe there: tune that filter on the same car.

A noise that a good IMU on a smooth road reduces to zero stays zero, since ten times 1e-13 is still negligible. Such a
filter therefore gets lower limits (`space.LEAST`): initial bias deviations of 0.005 m/s2 and 0.01 deg/s, and random
walks of the gyro biases about x and y and of roll and pitch. On its own roads this costs 1 to 6%; with one KITTI
drive's filter on colorado-1 it turns 3.1 m into 0.9.
"""

from concurrent.futures import Executor
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.problem import Problem

INFLATION, TILTED_INFLATION = 0.05, 0.02
"""Default cost increases without truth, of a planar model driven by the IMU and of the others."""
REFERENCE_DURATION = 100.0
"""Seconds of driving that the cost increase refers to; it is half as large for twice as many.

The increase is not larger for shorter drives: on 60 s of a motorway 0.086 instead of 0.05 made drifts over 5 s on other
roads 1.2 times as large.
"""
DECADES = 4.0
"""Largest decimal logarithm of the factor."""
STEP = 0.1
"""Decades between two factors."""


def inflated(
    problem: Problem[Any], point: Array, cost: float, allowed: float, executor: Executor | None
) -> tuple[Array, float, float]:
    """Inflate process noise from an optimum, (d,), until the cost has risen by the allowed share.

    ``allowed`` is the relative increase on `REFERENCE_DURATION` seconds of driving, or less. Returns the last point
    before the cost rises more, moved to the lower limits, its cost, and the factor of the noise that is inflated most.
    No noise leaves its bounds.
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
