"""What a tuning takes where nothing is asked for: the filter that suits the drives, and the objective."""

import warnings
from collections.abc import Sequence
from typing import Any

from sigmaswarm.doctor.suited import Equipment, equipment, suited
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import SigmaswarmWarning
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import clash

PLAIN = "planar5"
"""The paper's model, which uses nothing beside the fixes unless it is asked to."""
OBJECTIVES_OF_CARS = ("truth-pose + 0.2 nees", "innovation-t")
"""With truth and without: docs/objectives.md, "Outliers"."""
WITH_FORECASTS = "0.5 innovation-t + 0.5 forecast-t"
"""Without truth, of a filter that knows tilts, where fixes err anew each time: what it forecasts over seconds then
tells it from others. Where errors last, forecasts are of these: on a u-blox M8's it ended at 11 m in place of 4. A
planar filter gains on its own roads, too, but trusts them more: on another car's it was 3.6 times as far off as the
fixes."""
ROOM = 30.0
"""s under way, in which fixes can be hidden."""
OBJECTIVES_OF_LOGS = ("truth-rmse", "innovation-nll")
"""The same for models of the user's own, which have these two only."""


def with_filter(asked: dict[str, Any], drives: Sequence[Drive | Equipment]) -> tuple[dict[str, Any], str]:
    """The options of a tuning with a model and what it uses, and what was chosen and why, in a line.

    What the user gave stays. Where neither ``model`` nor ``use`` is given, both are those of `suited`. With ``use``
    alone the model is, and with ``model`` alone what it uses; but planar5, the paper's, then uses nothing. What does
    not go with the ``kind`` that is asked for, or with the objective, is left out.

    Parameters
    ----------
    asked : dict
        `TuneOptions` that the user gave.
    drives : sequence of Drive or Equipment
        All that the filter has to run on.

    Returns
    -------
    options : dict
    said : str
        Empty where the user gave both.
    """
    if "model" in asked and "use" in asked:
        return asked, ""
    found = suited(drives)
    model = asked.get("model") or _with_kind(found.model, asked.get("kind"))
    if "use" in asked:
        return {**asked, "model": model}, f"{_called(model, asked['use'])}, as asked: {found.because}"
    use = [] if model == PLAIN else [option for option in found.use if _goes(option, asked, model)]
    said = _called(model, use) + (", as asked" if "model" in asked else "")
    because = "the paper's; name what it may use with --use" if model == PLAIN else found.because
    if "model" in asked and model not in (PLAIN, found.model):
        because = f"{found.model} is what suits the logs: {because}"
    return {**asked, "model": model, "use": tuple(use)}, f"{said}: {because}"


def _called(model: str, use: Sequence[str]) -> str:
    return f"{model} with {', '.join(use) or 'position fixes alone'}"


def _with_kind(model: str, kind: str | None) -> str:
    """The model, or the largest before it that is compiled as the kind that is asked for."""
    if kind is None or model not in MODELS or kind in MODELS[model].kinds:
        return model
    return "planar8"


def _goes(option: str, asked: dict[str, Any], model: str) -> bool:
    """Whether an option goes with the kind and the objective that were asked for."""
    if option == "robust" and "innovation-nll" in str(asked.get("objective")):
        return False  # to which outliers count in full, whatever the filter makes of them
    kind = asked.get("kind")
    return kind is None or clash(kind, [option]) is None


def objective_for(data: Sequence[Drive | Equipment | Log], asked: str, model: str = PLAIN) -> str:
    """The objective that is asked for; for ``auto`` the one that suits the data and the filter's model."""
    if asked != "auto":
        return asked
    logs = any(isinstance(one, Log) for one in data)
    with_truth, without = OBJECTIVES_OF_LOGS if logs else OBJECTIVES_OF_CARS
    cars = [equipment(one) for one in data if not isinstance(one, Log)]
    tilts = model in MODELS and MODELS[model].tilts
    if not logs and tilts and _allows_forecasts(cars):
        without = WITH_FORECASTS
    blind = [one.name for one in data if not one.truth]
    if blind and len(blind) < len(data):
        warnings.warn(
            f"{blind[0]} has no truth, so all are tuned with {without}; leave it out, or say --objective",
            SigmaswarmWarning,
            stacklevel=5,
        )
    return without if blind else with_truth


def _allows_forecasts(found: Sequence[Equipment]) -> bool:
    """Whether most drives have fixes whose errors are white, and each is long enough to hide some."""
    return 2 * sum(one.white for one in found) > len(found) and all(one.driven > ROOM for one in found)
