"""Errors of a user's model against the truth in its log."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model
from sigmaswarm.geodesy import wrap_angle


@dataclass(frozen=True, eq=False)
class StateTargets:
    """True states of one log, prepared for comparison with any number of estimates.

    Attributes
    ----------
    places : (s,) int: the states that are compared
    angles : (s,) bool: which of them are angles
    truth : (j, s)
    before : (j,) int: the row of the log's time at or before each moment of truth
    weight : (j,) of the row after it
    """

    places: list[int]
    angles: NDArray[np.bool_]
    truth: Array
    before: NDArray[np.intp]
    weight: Array

    def rmse(self, mean: Array) -> float:
        """sqrt(mean(e^T e)) over moments of truth; e = estimate - truth, the estimate, (k, n), linear in between."""
        estimate = mean[:, self.places]
        early, late = estimate[self.before], estimate[np.minimum(self.before + 1, len(mean) - 1)]
        error = early + self.weight[:, np.newaxis] * self._turn(late - early) - self.truth
        return float(np.sqrt(np.mean(np.sum(self._turn(error) ** 2, axis=1))))

    def _turn(self, difference: Array) -> Array:
        return np.where(self.angles, wrap_angle(difference), difference)


def state_targets(log: Log, model: Model) -> StateTargets:
    """Prepare the truth of the model's ``scored`` states, or of all that the log has.

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
    return StateTargets(
        places=model.places(names),
        angles=np.isin(names, model.angles),
        truth=np.column_stack([log.truth[name][within] for name in names]),
        before=before,
        weight=(moments - log.time[before]) / interval,
    )
