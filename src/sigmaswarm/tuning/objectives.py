"""What a tuning minimizes. A new objective is one entry in `OBJECTIVES`.

Each takes the scores of all parameter sets on all drives and gives a cost per set and drive; the cost of a
set is the mean over its drives, and ``inf`` where the filter failed on any of them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.scoring.batch import Scores

HEADING_WEIGHT = 0.1
"""m per degree of heading error, in truth-pose."""
OUTAGE_WEIGHT = 0.1
"""m per metre of outage drift, in truth-pose."""


@dataclass(frozen=True)
class Objective:
    """One way to say how good a filter is.

    Attributes
    ----------
    name : str
    summary : str
        One sentence for people.
    per_drive : callable
        Scores to costs of shape (n_sets, n_drives); lower wins.
    needs_truth, needs_outages : bool
    warning : str or None
        What a user should know before trusting the result.
    """

    name: str
    summary: str
    per_drive: Callable[[Scores], Array]
    needs_truth: bool = False
    needs_outages: bool = False
    warning: str | None = None

    def costs(self, scores: Scores) -> Array:
        """Cost of each set, shape (n_sets,); ``inf`` for a set that failed or can't be scored."""
        mean = self.per_drive(scores).mean(axis=1)
        return np.where(scores.failed.any(axis=1) | ~np.isfinite(mean), np.inf, mean)


def _pose(scores: Scores) -> Array:
    # A drive too short for an outage, or too slow for a heading, has no such term: the same for all sets.
    heading = np.nan_to_num(np.degrees(scores.heading_rmse), posinf=np.inf)
    drift = np.nan_to_num(scores.outage_drift, posinf=np.inf)
    return scores.position_rmse + HEADING_WEIGHT * heading + OUTAGE_WEIGHT * drift


OBJECTIVES = {
    objective.name: objective
    for objective in (
        Objective(
            "truth-rmse",
            "position RMSE against truth, m",
            lambda scores: scores.position_rmse,
            needs_truth=True,
        ),
        Objective(
            "truth-pose",
            "position RMSE (m) + 0.1 m/deg x heading error + 0.1 x drift over 5 s outages (m)",
            _pose,
            needs_truth=True,
            needs_outages=True,
        ),
        Objective(
            "gps-rmse",
            "the paper's equation 4: RMSE against the fixes that the filter has just absorbed, m",
            lambda scores: scores.fix_rmse,
            warning=(
                "gps-rmse scores the filter against the GPS that it has just absorbed, so it rewards a filter "
                "that copies the GPS; kept to reproduce the paper. With truth, use truth-rmse or truth-pose"
            ),
        ),
    )
}
"""All objectives by name."""


def objective_named(name: str) -> Objective:
    """Look an objective up.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in OBJECTIVES:
        raise InputError(f"no objective is called {name!r}; choose one of {', '.join(OBJECTIVES)}")
    return OBJECTIVES[name]
