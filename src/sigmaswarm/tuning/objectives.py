"""Objectives: functions that convert scores of parameter sets to costs, and weighted sums of such functions."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.scoring.batch import Scores

HEADING_WEIGHT = 0.1  # m/deg, for truth-pose
OUTAGE_WEIGHT = 0.1  # m/m, for truth-pose


@dataclass(frozen=True)
class Objective:
    """A cost of a filter on drives.

    Attributes
    ----------
    name : str
    summary : str
        Description for users.
    per_drive : callable
        Function that converts scores to costs, shape (n_sets, n_drives).
    needs_truth, needs_outages, needs_forecasts : bool
        True if the scores must contain errors against truth, drifts in outages, or forecasts of hidden fixes.
    scale_free : bool
        True if the cost does not depend on a common factor of all covariances.
    likelihood : bool
        True for a negative log-likelihood, or a sum with such a term. Without truth, the unit of the whole sum is nats.
    nats : float
        Total weight of the logarithmic terms; 0 if the cost is a positive error. If all errors are 1% larger, a term of
        weight 1 increases by 0.01 nats per element of a measurement.
    warning : str or None
        Warning for the user before the search.
    """

    name: str
    summary: str
    per_drive: Callable[[Scores], Array]
    needs_truth: bool = False
    needs_outages: bool = False
    needs_forecasts: bool = False
    scale_free: bool = False
    likelihood: bool = False
    nats: float = 0.0
    warning: str | None = None

    def costs(self, scores: Scores, worst: float = 1.0) -> Array:
        """Return the mean of the highest costs of each set, shape (n_sets,); ``inf`` if the set failed on any drive.

        ``worst`` is the fraction of the drives over which costs are averaged.
        """
        return mean_cost(self.costs_by_drive(scores), worst)

    def costs_by_drive(self, scores: Scores) -> Array:
        """Return the costs, shape (n_sets, n_drives); ``inf`` where a set failed or has no score."""
        costs = self.per_drive(scores)
        return np.where(scores.failed | ~np.isfinite(costs), np.inf, costs)

    def relative_increase(self, costs: Array | float, best: float, elements: float = 2) -> Array:
        """Return the relative increase of costs over ``best``; 0.01 means that errors are 1% larger.

        ``elements`` is the mean number of elements of a measurement.
        """
        costs = np.asarray(costs)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            change = np.expm1((costs - best) / (elements * self.nats)) if self.nats else costs / best - 1
        return np.where(np.isfinite(costs), change, np.inf)


def mean_cost(each: Array, worst: float) -> Array:
    """Return `conditional_value_at_risk`, shape (n,); ``inf`` if any drive failed."""
    cost = conditional_value_at_risk(each, worst)
    return np.where(np.isfinite(cost), cost, np.inf)


def conditional_value_at_risk(costs: Array, share: float) -> Array:
    """Return the mean over the fraction ``share`` of highest costs in each row. Costs are (n, m), the result is (n,).

    If m times ``share`` is not an integer, the smallest of these costs has a smaller weight (conditional value at risk:
    R. T. Rockafellar and S. Uryasev, J. Risk 2, 2000).
    """
    if not 0 < share <= 1:
        raise InputError(f"worst = {share:g}: specify a fraction of the drives, above 0 and at most 1")
    if share == 1.0:
        return costs.mean(axis=1)
    count = costs.shape[1]
    weight = np.clip(share * count - np.arange(count), 0.0, 1.0)
    used = weight > 0
    with np.errstate(invalid="ignore"):  # a failed set has infinite costs
        return np.sort(costs, axis=1)[:, ::-1][:, used] @ weight[used] / weight.sum()


def _pose(scores: Scores) -> Array:
    # On a drive that is too short for outages or too slow for headings, the drift or heading term is 0 for every set.
    heading = np.nan_to_num(np.degrees(scores.heading_rmse), posinf=np.inf)
    drift = np.nan_to_num(scores.outage_drift, posinf=np.inf)
    return scores.position_rmse + HEADING_WEIGHT * heading + OUTAGE_WEIGHT * drift


def _deviation(mean: Array) -> Array:
    """Return the absolute logarithm of mean NIS / 2 or mean NEES / 2; both ratios are 1 for a consistent filter."""
    return np.abs(np.log(mean / 2))


OBJECTIVES = {
    objective.name: objective
    for objective in (
        Objective(
            "truth-rmse",
            "position RMSE against truth, m",
            lambda scores: scores.position_rmse,
            needs_truth=True,
            scale_free=True,
        ),
        Objective(
            "truth-pose",
            "position RMSE (m) + 0.1 m/deg x heading error + 0.1 x drift over 5 s outages (m)",
            _pose,
            needs_truth=True,
            needs_outages=True,
            scale_free=True,
        ),
        Objective(
            "innovation-nll",
            "mean negative log-likelihood of the fixes, as predicted before each update, in nats",
            lambda scores: scores.innovation_nll,
            likelihood=True,
            nats=1.0,
        ),
        Objective(
            "innovation-t",
            "mean negative log-likelihood (Student's t) of the fixes, as predicted before each update, in nats",
            lambda scores: scores.innovation_t,
            likelihood=True,
            nats=1.0,
        ),
        Objective(
            "forecast-t",
            "mean negative log-likelihood (Student's t) of fixes that are hidden for 3 to 5 s, in nats",
            lambda scores: scores.forecast_t,
            needs_forecasts=True,
            likelihood=True,
            nats=1.0,
        ),
        Objective(
            "outage-rmse",
            "RMS forecast error for fixes hidden for 3 to 5 s, m",
            lambda scores: scores.forecast_rmse,
            needs_forecasts=True,
            scale_free=True,
        ),
        Objective(
            "nis",
            "|ln(mean NIS / 2)|: error of the scale of the innovations' covariance",
            lambda scores: _deviation(scores.mean_nis),
            nats=1.0,
        ),
        Objective(
            "nees",
            "|ln(mean NEES / 2)|: error of the scale of the position's covariance",
            lambda scores: _deviation(scores.mean_nees),
            needs_truth=True,
            nats=1.0,
        ),
        Objective(
            "gps-rmse",
            "the paper's equation 4: RMSE of the updated positions against the fixes, m",
            lambda scores: scores.fix_rmse,
            warning=(
                "gps-rmse compares the filter with the fix of the last update, so this cost is lowest for a filter "
                "that copies the fixes. Use gps-rmse only to repeat the paper. Without truth, use innovation-nll"
            ),
        ),
    )
}

FLAGS = ("needs_truth", "needs_outages", "needs_forecasts", "likelihood")
_TERM = re.compile(r"\s*(?:(?P<weight>[0-9.]+(?:e[+-]?[0-9]+)?)\s*\*?\s*)?(?P<name>[a-z][a-z-]*)\s*")


@cache
def parse_objective(name: str) -> Objective:
    """Return an objective, or a weighted sum of objectives such as ``truth-pose + 0.2 nees``."""
    terms = [_term(part, name) for part in name.split("+")]
    if len(terms) == 1 and terms[0][0] == 1.0:
        return terms[0][1]
    warnings = [o.warning for _, o in terms if o.warning]
    in_nats = all(o.nats for _, o in terms) or any(o.likelihood for _, o in terms)
    return Objective(
        name=" + ".join(o.name if w == 1.0 else f"{w:g} {o.name}" for w, o in terms),
        summary=" + ".join(o.summary if w == 1.0 else f"{w:g} x ({o.summary})" for w, o in terms),
        per_drive=lambda scores: np.sum([w * o.per_drive(scores) for w, o in terms], axis=0),
        **{flag: any(getattr(o, flag) for _, o in terms) for flag in FLAGS},
        scale_free=all(o.scale_free for _, o in terms),
        nats=sum(w * o.nats for w, o in terms) if in_nats else 0.0,
        warning=warnings[0] if warnings else None,
    )


def _term(part: str, whole: str) -> tuple[float, Objective]:
    match = _TERM.fullmatch(part)
    if not match or match["name"] not in OBJECTIVES:
        raise InputError(
            f"no objective is called {part.strip()!r}; choose one of {', '.join(OBJECTIVES)}, auto, "
            "or a sum like 'truth-pose + 0.2 nees'"
        )
    try:
        weight = float(match["weight"] or 1.0)
    except ValueError:
        raise InputError(
            f"{whole!r}: {match['weight']!r} is not a weight; write a number such as 0.2"
        ) from None
    if not 0 < weight < np.inf:
        raise InputError(
            f"{whole!r}: the weight of {match['name']} must be positive and finite (is {weight:g})"
        )
    return weight, OBJECTIVES[match["name"]]
