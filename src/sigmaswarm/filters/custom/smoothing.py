"""What is known of a log in hindsight, by a model of the user's own: the textbook's smoother, whatever the model is."""

from collections.abc import Mapping

import numpy as np

from sigmaswarm.filters.custom.checks import check
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import SCALING_NAMES, Model
from sigmaswarm.filters.custom.run import ModelEstimate, failure_in
from sigmaswarm.filters.custom.steps import build_steps
from sigmaswarm.filters.textbook.custom import TextbookModel
from sigmaswarm.filters.textbook.loop import FAILURES
from sigmaswarm.filters.textbook.smoothing import smooth_steps
from sigmaswarm.geodesy import wrap_angle


def smooth_model(log: Log, model: Model, parameters: Mapping[str, float]) -> ModelEstimate:
    """Run the filter of a model of your own over a log, and smooth: each estimate knows all measurements.

    H. E. Rauch, F. Tung and C. T. Striebel, AIAA Journal 3(8), 1965; S. Sarkka, IEEE TAC 53(3), 2008. In NumPy, some
    hundred times slower than `run_model`, for it needs every prediction.

    Parameters
    ----------
    log, model, parameters
        As in `run_model`.

    Returns
    -------
    ModelEstimate
        ``nis`` and ``nll`` are the filter's. With ``failure`` set where it failed; what lies before is smoothed.

    Raises
    ------
    InputError
        If model, log and parameters do not fit together.
    """
    p = model.values(parameters)
    check(model, log)
    steps, n = build_steps(log), len(model.states)
    scaling = np.array([parameters.get(name, np.nan) for name in SCALING_NAMES])
    mean, covariance = np.full((len(log.time), n), np.nan), np.full((len(log.time), n, n), np.nan)
    nis, nll = np.full((2, len(steps.measurements)), np.nan)
    failed = 0
    try:
        with np.errstate(all="ignore"):  # what comes of it is looked at
            stepper = TextbookModel(model, steps, scaling, p)
    except FAILURES:  # R can't be had
        pass
    else:
        found = smooth_steps(stepper, len(steps.dt))
        failed, nis, nll = found.failed, stepper.nis, stepper.nll
        records = steps.records[: len(found.mean) - 1]
        at = np.flatnonzero(records >= 0)
        mean[records[at]], covariance[records[at]] = found.mean[at + 1], found.covariance[at + 1]
    angles = model.places(model.angles)
    mean[:, angles] = wrap_angle(mean[:, angles])
    failure = failure_in(log, steps, failed)
    return ModelEstimate(log.time, mean, covariance, steps.measurement_time, nis, nll, failure)
