"""Remarks on a tuning."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.tuning.diagnostics import SCALE_FREE
from sigmaswarm.tuning.sensitivity import NOISE_SCALE, RISE
from sigmaswarm.wording import in_order, to_do

if TYPE_CHECKING:
    from sigmaswarm.tuning.result import Tuning

NOT_VALIDATED = (
    "its cost is that of the drives it was tuned on; evaluate it on others, or name some as validation"
)
"""The remark that an evaluation answers."""
INFLATED = (
    "{} times those of the lowest cost (process-noise inflation): the costs of the two filters hardly differ, and on "
    "roads and IMUs that the tuning has not seen, the one with more process noise does better. On the same roads it "
    "drifts somewhat farther over outages; --inflation 0 turns it off"
)
OF_THESE_SENSORS = (
    "tuned with truth it belongs to the receiver and the IMU of these drives: on others it may be far less accurate "
    "than their fixes. For those tune without truth (--objective innovation-t)"
)
MORE_DRIVES = "tune on more drives, or on drives that are more like those of the validation"
LARGE_GAP = 0.2
"""Relative increase of the validation cost above which a remark is made."""


def remarks_on(tuning: "Tuning[Any]") -> list[str]:
    """List the remarks as sentences; those that ask for action (`TO_DO`) come first."""
    t = tuning
    remarks = [
        *t.warnings,
        *([INFLATED.format(_inflated(t))] if t.inflation_factor != 1.0 else []),
        *(
            f"{touched}: the optimum may lie beyond the bounds"
            for touched in t.touched_bounds
            if touched.parameter not in t.unidentified
        ),
    ]
    if names := ", ".join(name for name in t.unidentified if name != NOISE_SCALE):
        remarks.append(
            f"the objective does not determine {names}: each alone may have any value within its bounds at 1% of the "
            "cost"
        )
    if NOISE_SCALE in t.unidentified and t.config.objective not in SCALE_FREE:
        why = "it does not determine how large all noises are together, so the covariances can't be trusted"
        remarks.append(to_do("add innovation-nll or nis to the objective", why))
    if _heading_is_loose(t):
        remedy = "for a car use the lateral constraint (--use lateral), or tune with truth-pose"
        why = (
            "fixes alone determine the heading poorly: it may be off by tens of degrees with a good position"
        )
        remarks.append(to_do(remedy, why))
    better = min(t.sensitivities, key=lambda s: s.lowest_rise, default=None)
    if better is not None and better.lowest_rise < -RISE and t.inflation_factor == 1.0:
        why = f"moving {better.name} alone lowers the cost by {-better.lowest_rise:.0%}"
        remarks.append(to_do("search longer, with more trials, or polish", why))
    if isinstance(t.parameters, FilterParameters) and "truth" in t.config.objective:
        remarks.append(OF_THESE_SENSORS)
    return in_order([*remarks, *_on_validation(t)])


def _on_validation(tuning: "Tuning[Any]") -> list[str]:
    validation = tuning.validation
    if validation is None:
        return [NOT_VALIDATED]
    if not np.isfinite(validation.cost):
        return [to_do(MORE_DRIVES, "the tuned filter failed on at least one validation drive")]
    if validation.gap > LARGE_GAP:
        gap = f"{validation.gap:.0%} larger than on the training drives"
        return [to_do(MORE_DRIVES, f"errors on the validation drives are {gap}")]
    return []


def _heading_is_loose(tuning: "Tuning[Any]") -> bool:
    p = tuning.parameters
    held = not isinstance(p, FilterParameters) or p.lateral_noise or p.velocity_noise
    return not held and "truth-pose" not in tuning.config.objective


def _inflated(tuning: "Tuning[Any]") -> str:
    """Name the noises that were inflated, and the factors."""
    p, factor = tuning.parameters, f"{tuning.inflation_factor:.3g}"
    if not isinstance(p, FilterParameters) or not MODELS[p.model].tilts:
        return f"all process noises are {factor}"
    root = f"{tuning.inflation_factor**0.5:.3g}"
    return f"the random walks of the biases are {factor}, the noises of position and velocity {root}"
