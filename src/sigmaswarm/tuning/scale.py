"""The covariance's scale, where the objective leaves it free: errors alone do not say what a filter should say of them.

All noises and the start's covariance times one factor leave a Kalman filter's gains, and so its estimates, as they are;
its covariances are multiplied, and its NIS divided. So mean NIS / 2 is the factor that makes the filter consistent. It
holds for planar8 and tilted12 as far as their gains do not depend on the scale: a gate and Student's t do, and so does
what a drive itself gives, its start and its gaps. planar5's box lets the heading be unsure by degrees, where the sigma
points' spread, and with it the mean, follows the scale. What the factor does to the position is therefore measured.
"""

from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.remote import Replays
from sigmaswarm.wording import to_do

SCALE_FREE = ("truth-rmse", "truth-pose")
"""Objectives that do not look at a covariance."""
REMEDY = "tune with '{objective} + 0.2 nees'"
MOVED = 0.02
"""Share by which the position RMSE may change, for the factor to be offered."""
NEAR = 0.2
"""Share by which mean NIS may miss 2 after the factor."""


def said_of_scale(objective: str, parameters: FilterParameters, replays: Replays) -> list[str]:
    """A sentence where the objective leaves the covariance's scale free, with the factor that makes NIS right.

    The factor is offered for planar8 and tilted12, where it leaves the positions as they are; see
    `FilterParameters.scaled`.
    """
    if objective not in SCALE_FREE:
        return []
    before = replays.scores([parameters])
    nis = float(before.mean_nis.mean())
    said = f"{objective} leaves the scale of the covariances free: mean NIS is {nis:.2g} where 2 is right"
    remedy = REMEDY.format(objective=objective)
    if parameters.model != "planar5" and nis > 0:
        after = replays.scores([parameters.scaled(nis / 2)])
        moved = float(after.position_rmse.mean() / before.position_rmse.mean() - 1)
        if abs(moved) <= MOVED and abs(float(after.mean_nis.mean()) / 2 - 1) <= NEAR:
            right = f"all noises times {nis / 2:.3g} make it right and move the position RMSE by {moved:+.1%}"
            return [to_do(f"{remedy}, or take FilterParameters.scaled({nis / 2:.3g})", f"{said}; {right}")]
    return [to_do(remedy, said)]
