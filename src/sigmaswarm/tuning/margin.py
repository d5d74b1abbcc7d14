"""A margin for other roads and IMUs: how much more a filter may doubt before the objective objects.

A filter that is tuned on one drive trusts its model as far as that drive bears it. On other roads, on a warmer day or
with another IMU it is then sure of what is wrong, and takes the fixes for outliers. As statisticians take the simplest
model within one standard error of the best (L. Breiman et al., Classification and Regression Trees, 1984, section
3.4.3), so of all filters that the objective hardly tells from the best that one is taken which doubts most. The longer
the drives, the less they leave open, and the less the share; drives of less than `PER` bear no more.

What is doubted: of a planar model all process noises by one factor, since the velocity's stands for roads that tilt.
Of one that knows tilts the walks of its IMU's biases, which it takes for constant otherwise, and the noises of position
and velocity by the factor's root: raised as much as the walks they cost the same car as much and help another one less
(0.86 of the fixes' own error in place of 0.65); left alone, a cheap IMU's heading is off half as much again, since what
vibration makes is then taken for biases.

What a good IMU on a smooth road makes vanish stays vanished, for ten times 1e-13 is nothing. So such a filter is left
no less than a little of it (`space.LEAST`): a start's biases known to 0.005 m/s2 and 0.01 deg/s, and walks of the
gyro's biases about x and y and of roll and pitch. Its own roads cost that 1 to 6%; of one KITTI drive's filter on
colorado-1, 3.1 m become 0.9.
"""

from concurrent.futures import Executor
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.problem import Problem

MARGIN, TILTED_MARGIN = 0.05, 0.02
"""What is usual where truth has no say, of a planar model and of one that knows tilts."""
PER = 100.0
"""s of driving that a margin is said for; twice as many leave half as much open, and bear half the share.

Less bear no more: on 60 s of a motorway 0.086 in place of 0.05 made drifts over 5 s on other roads 1.2 times as large.
"""
DECADES = 4.0
"""The largest factor is 10 to that power."""
STEP = 0.1
"""Decades between two factors."""


def with_margin(
    problem: Problem[Any], point: Array, cost: float, margin: float, executor: Executor | None
) -> tuple[Array, float, float]:
    """Raise what is doubted until the cost has risen by a share.

    Parameters
    ----------
    problem : Problem
        Its variances are searched as logarithms.
    point : ndarray, shape (d,)
        The optimum, in search coordinates.
    cost : float
        There.
    margin : float
        Share by which the cost may rise on `PER` seconds of driving, or less.
    executor : concurrent.futures.Executor or None

    Returns
    -------
    point : ndarray, shape (d,)
        The farthest of them before the cost rises more, with no less than the least; no noise leaves the box.
    cost : float
        There.
    factor : float
        Of what is doubted most, where it is not at its bound.
    """
    space = problem.space
    decades = np.arange(0.0, DECADES + STEP / 2, STEP)
    points = np.minimum(point + decades[:, None] * space.inflations, np.maximum(space.high, point))
    costs = problem.costs(points, executor)
    share = margin * min(1.0, PER / sum(entry["duration_s"] for entry in problem.data))
    within = np.logical_and.accumulate(problem.rise(costs, cost) <= share)
    last = int(within.sum()) - 1 if within.any() else 0
    chosen = np.maximum(points[last], space.least)
    if np.array_equal(chosen, points[last]):
        return chosen, float(costs[last]), float(10 ** decades[last])
    return chosen, float(problem.costs(chosen[np.newaxis], executor)[0]), float(10 ** decades[last])
