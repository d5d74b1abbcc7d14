"""The smoother of Rauch, Tung and Striebel behind any textbook filter: it knows predictions, and no measurement.

References
----------
H. E. Rauch, F. Tung and C. T. Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA Journal 3, 1965.
S. Sarkka, Unscented Rauch-Tung-Striebel smoother, IEEE Transactions on Automatic Control 53(3), 2008.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import add, sub

import numpy as np

from sigmaswarm.filters.textbook.gaussian import Array, Prediction
from sigmaswarm.filters.textbook.loop import FAILURES, Stepper

Retraction = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What is known of a filter's state in hindsight.

    Attributes
    ----------
    mean, covariance : ndarray, shapes (k + 1, n), (k + 1, n, n)
        At the start, and behind each of k steps.
    failed : int
        The step in which the filter failed, or -1; the steps are those before it.
    """

    mean: Array
    covariance: Array
    failed: int


def smooth_steps(
    stepper: Stepper, n_steps: int, *, plus: Retraction = add, minus: Retraction = sub
) -> Smoothed:
    """Take all steps, and smooth. ``plus`` adds an error to a state and ``minus`` finds it, as in `manifold`."""
    filter, failed = stepper.filter, -1
    filtered, predictions = [(filter.mean, filter.covariance)], list[Prediction]()
    for i in range(n_steps):
        mean, covariance = filtered[-1]
        filter.prediction = Prediction(mean, covariance, covariance)  # a step of no length predicts nothing
        try:
            with np.errstate(all="ignore"):  # what comes of it is looked at
                stepper.step(i)
        except FAILURES:
            failed = i
        if failed >= 0 or not (np.isfinite(filter.mean).all() and np.isfinite(filter.covariance).all()):
            failed = i
            break
        filtered.append((filter.mean, filter.covariance))
        predictions.append(filter.prediction)
    return Smoothed(*rauch_tung_striebel(filtered, predictions, plus, minus), failed)


def rauch_tung_striebel(
    filtered: Sequence[tuple[Array, Array]],
    predictions: Sequence[Prediction],
    plus: Retraction = add,
    minus: Retraction = sub,
) -> tuple[Array, Array]:
    """Means (k + 1, n) and covariances (k + 1, n, n) in hindsight, of a filter's and its k predictions between them."""
    means, covariances = [filtered[-1][0]], [filtered[-1][1]]
    for (mean, covariance), prior in zip(filtered[-2::-1], predictions[::-1], strict=True):
        gain = np.linalg.solve(prior.covariance, prior.cross.T).T  # G = C (P-)^-1
        change = covariances[-1] - prior.covariance
        means.append(plus(mean, gain @ minus(means[-1], prior.mean)))  # m + G (m^s' - m-)
        covariances.append(covariance + gain @ change @ gain.T)  # P + G (P^s' - P-) G^T
    return np.array(means[::-1]), np.array(covariances[::-1])
