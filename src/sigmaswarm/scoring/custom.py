"""Errors of a user's model against the truth in its log."""

from collections.abc import Callable

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model
from sigmaswarm.geodesy import wrap_angle


def truth_rmse(log: Log, model: Model) -> Callable[[Array], float]:
    """Return a function of means (k, n), at the log's times, to the RMSE of the model's ``scored`` states.

    It is sqrt(mean(e^T e)) over moments of truth; e = estimate - truth, the estimate linear in between. By default all
    states are scored whose truth the log has.

    Raises
    ------
    InputError
        If the log has no such truth, or none within its time.
    """
    names = model.scored or tuple(log.truth)
    missing = [name for name in names if name not in log.truth]
    if missing or not names:
        what = f"of {missing[0]!r} " if missing and log.truth else ""
        raise log.wrong(f"has no truth {what}for truth-rmse; add it, or tune with innovation-nll")
    moments = log.time if log.truth_time is None else log.truth_time
    within = (moments >= log.time[0]) & (moments <= log.time[-1])
    if not within.any():
        raise log.wrong(
            f"truth covers t = {moments[0]:g} to {moments[-1]:g} s, the inputs {log.time[0]:g} to {log.time[-1]:g} s; "
            "put both on one clock"
        )
    moments = moments[within]
    before = np.searchsorted(log.time, moments, side="right") - 1
    after = np.minimum(before + 1, len(log.time) - 1)
    interval = np.where(after > before, log.time[after] - log.time[before], 1.0)
    weight = ((moments - log.time[before]) / interval)[:, np.newaxis]
    truth = np.column_stack([log.truth[name][within] for name in names])
    places, angles = model.places(names), np.isin(names, model.angles)

    def rmse(mean: Array) -> float:
        estimate = mean[:, places]
        early, moved = estimate[before], estimate[after] - estimate[before]
        error = early + weight * np.where(angles, wrap_angle(moved), moved) - truth
        error = np.where(angles, wrap_angle(error), error)
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))

    return rmse
