"""Defaults of a tuning run that depend on the drives."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import LASTING_ERRORS, LogProperties, enough_for_fix_error, log_properties
from sigmaswarm.drives.suggestion import suggest_filter
from sigmaswarm.errors import SigmaswarmWarning
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.kernels import FILTERS, kernel_name
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import incompatibility
from sigmaswarm.tuning.config import C, TuneConfig, validated_config
from sigmaswarm.tuning.inflation import INFLATION, TILTED_INFLATION, WITH_TRUTH
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.wording import count_of

PAPER_MODEL = "planar5"
OBJECTIVES_OF_CARS = ("truth-pose + 0.2 nees", "innovation-t")
"""Objectives with and without truth; see docs/objectives.md, "Outliers"."""
CORRELATED_OBJECTIVE = "truth-pose + 0.2 nees + 0.1 innovation-t"
"""Objective with truth, without ``fix-error``, if the fix errors of most drives are correlated.

R can then hardly be estimated from the truth, since a drive has few independent position errors. After tuning on the
first half of comma2k19 with truth alone, the filter hardly uses the fixes (mean NIS 0.02), and the position RMSE on the
second half is 0.81 m. With 0.1 innovation-t it is 0.50 m, and with 0.3 innovation-t 0.47 m. With the halves exchanged,
the three values are 0.54, 0.52 and 1.63 m (12 seeds). If fix errors are white, the likelihood only adds noise: with
RTK, the heading error of planar8 would rise by 20%.
"""
FORECAST_OBJECTIVES = ("truth-pose + 0.2 nees + 0.2 forecast-t", "0.5 innovation-t + 0.5 forecast-t")
"""Objectives with and without truth, for a model with roll and pitch, if the fix errors of most drives are white.

With truth, forecasts are added, since the drift in truth-pose comes from only a few outages. After tuning on three
simulated drives of 120 s, the 5 s drift on other drives was 1.9 m without forecasts and 0.8 m with them.

If the fix errors are correlated, a filter that is tuned by forecasts reproduces these errors: with a u-blox M8, its
position RMSE was 11 m instead of 4 m. For planar models, forecasts are not used. Without truth, they overfit the filter
to the training roads: on a drive of another car, its position RMSE was 3.6 times that of the fixes. With truth, they
increase the heading error of planar8 by 5% (ten cases).
"""
FIX_ERROR_OBJECTIVE = "innovation-t + 0.2 truth-pose + 0.2 nees"
"""Default objective with truth if the filter estimates correlated fix errors (option ``fix-error``).

It consists mainly of the likelihood, since a drive has few independent position errors. With a larger weight of
truth-pose, the filter overfits to the errors of the training drive.
"""
PRIOR_WITH_TRUTH = 0.3
"""Weight of the priors with `FIX_ERROR_OBJECTIVE`.

Among parameter sets with nearly equal costs, the priors select the typical one. After tuning on four simulated drives
with a u-blox M8, the 30 s drift was 22 to 118 m without priors, depending on the seed, and 21 to 24 m with this weight.
With a weight of 1 instead, the position RMSE after tuning on one such drive was 5% larger on average (five drives).
"""
MAX_WHITE_SHARE = 0.7
"""Largest ratio of white noise to true standard deviation of the fixes at which fix-error is used.

A log of very accurate fixes without stated accuracy looks like a log with correlated errors. With fix errors of 0.08 m,
a robot's filter had a position RMSE of 0.93 m with fix-error, and 0.07 m without it. The ratio is 0.2 to 0.6 with a
u-blox M8.
"""
MAX_STD_RATIO = 2.0
"""Largest factor between the true and the stated (or assumed) standard deviation of fixes.

Above this factor, `PRIOR_WITH_TRUTH` is not used.
"""
MIN_DRIVEN = 30.0  # s, driving time that each drive must exceed for `FORECAST_OBJECTIVES`
OBJECTIVES_OF_LOGS = ("truth-rmse", "innovation-nll")
"""Objectives with and without truth for custom models, which support no other objectives."""


def default_filter_options(
    options: dict[str, Any], drives: Sequence[Drive | LogProperties]
) -> tuple[dict[str, Any], str]:
    """Add missing ``model`` and ``use``.

    Return the options, and a line that explains the added options ("" if none was missing).

    No measurements are added to planar5, the paper's model. Measurements that conflict with ``kind`` or the objective
    are omitted. ``fix-error`` is added only to the model that suits the sensors: on roads that need tilted12,
    ``fix-error`` doubles the drift of planar8 over 30 s.
    """
    if "model" in options and "use" in options:
        return options, ""
    suggestion, kind = suggest_filter(drives), options.get("kind")
    model = options.get("model") or suggestion.model
    if not options.get("model") and kind is not None and kind not in MODELS[model].filter_types:
        model = "planar8"
    if "use" in options:
        described = _described(model, options["use"])
        return {**options, "model": model}, f"{described} (as given), since {suggestion.because}"
    use, because = [], ". This is the paper's model; add measurements with --use"
    if model != PAPER_MODEL:
        allowed = MODELS[model].options if model in MODELS else ()
        offered = (*suggestion.use, "gate") if allowed else suggestion.use
        use = [name for name in offered if name in (allowed or (name,)) and _fits(name, options)]
        other = model != suggestion.model and "model" in options
        because = f". {suggestion.model} suits the logs" * other + f", since {suggestion.because}"
        if model == suggestion.model and _needs_fix_error(model, options, drives):
            use.append("fix-error")
            because += f", and {LASTING_ERRORS}"
        if drives and all(log_properties(drive).heading for drive in drives):
            because += f". To use the heading, write --use {' '.join((*use, 'heading'))}"
    described = _described(model, use) + (", as given" if "model" in options else "")
    return {**options, "model": model, "use": tuple(use)}, f"{described}{because}"


def _needs_fix_error(model: str, options: dict[str, Any], drives: Sequence[Drive | LogProperties]) -> bool:
    """Return True if all drives have correlated fix errors and enough fixes, and filter and objective permit fix-error.

    Without truth, fix-error changes the position RMSE by -25% on kingston-1, and by -13% and +6% on two parts of
    comma2k19. With simulated receivers whose errors last minutes, fix-error improves only the covariance. If the
    objective uses truth, fix-error is used only with the default objective of a model with roll and pitch (see
    `space.FIX_ERROR_TIME`).
    """
    have, objective = [log_properties(one) for one in drives], options.get("objective") or "auto"
    known = model in MODELS
    if objective == "auto":
        suits = not all(one.truth for one in have) or (known and MODELS[model].tilts)
    else:
        suits = not parse_objective(objective).needs_truth
    kind = options.get("kind") or (MODELS[model].filter_types[0] if known else "")
    modeled = kernel_name(model, kind, True) in FILTERS and _fits("fix-error", options)
    lasting = all(one.lasting for one in have)
    if objective == "auto" and all(one.truth for one in have):
        lasting = lasting and not _are_shown_white(have)
    return suits and modeled and enough_for_fix_error(have) and lasting


def _are_shown_white(drives: Sequence[LogProperties]) -> bool:
    """Return True if the noise of the fixes is nearly as large as their errors against the truth."""
    return _mean(drives, "noise") > MAX_WHITE_SHARE * _mean(drives, "true_std")


def _mean(drives: Sequence[LogProperties], name: str) -> float:
    return float(np.mean([getattr(one, name) for one in drives])) if drives else np.nan


def _described(model: str, use: Sequence[str]) -> str:
    return f"{model} with {', '.join(use) or 'position fixes alone'}"


def _fits(name: str, options: dict[str, Any]) -> bool:
    if name == "robust" and "innovation-nll" in str(options.get("objective")):
        return False  # innovation-nll does not reduce the weight of outliers
    kind = options.get("kind")
    return kind is None or incompatibility(kind, [name]) is None


def objective_for(
    data: Sequence[Drive | LogProperties | Log],
    objective: str,
    model: str = PAPER_MODEL,
    use: Sequence[str] = (),
) -> str:
    """Return the objective, with ``auto`` replaced by the default."""
    if objective != "auto":
        return objective
    logs = any(isinstance(one, Log) for one in data)
    with_truth, without = OBJECTIVES_OF_LOGS if logs else OBJECTIVES_OF_CARS
    cars = [log_properties(one) for one in data if not isinstance(one, Log)]
    tilts = model in MODELS and MODELS[model].tilts
    white = 2 * sum(one.white for one in cars) > len(cars)
    if not logs and tilts and white and all(one.driven > MIN_DRIVEN for one in cars):
        with_truth, without = FORECAST_OBJECTIVES
    if not logs and 2 * sum(one.lasting for one in cars) > len(cars) and not _are_shown_white(cars):
        with_truth = CORRELATED_OBJECTIVE
    if "fix-error" in use:
        with_truth = FIX_ERROR_OBJECTIVE
    without_truth = [one.name for one in data if not one.truth]
    if without_truth and len(without_truth) < len(data):
        warnings.warn(
            f"{without_truth[0]} has no truth, so the objective is {without}; omit drives without truth, or set "
            "--objective",
            SigmaswarmWarning,
            stacklevel=5,
        )
    return without if without_truth else with_truth


def complete_config(config: C, data: Sequence[LogProperties | Log]) -> C:
    """Replace the objective ``auto``, and an unset prior weight or process-noise inflation, by defaults."""
    car = isinstance(config, TuneConfig)
    model, use = (config.model, config.use) if car else (PAPER_MODEL, ())
    objective = objective_for(data, config.objective, model, use)
    cars = [one for one in data if not isinstance(one, Log)]
    return with_default_guards(
        config.model_copy(update={"objective": objective}), as_stated=_is_as_stated(cars)
    )


def _is_as_stated(cars: Sequence[LogProperties]) -> bool:
    """Return True if the truth confirms the receivers' standard deviations, which are the center of the prior on R."""
    ratio = _mean(cars, "true_std") / _mean(cars, "receiver_std")
    return 1 / MAX_STD_RATIO < ratio < MAX_STD_RATIO


def explain_tuning(drives: Sequence[Drive | LogProperties], **options: Any) -> list[str]:
    """Describe in three lines the filter, the objective and the search that `tune` would use."""
    sensors = [log_properties(one) for one in drives]
    options, because = default_filter_options(options, sensors)
    config = complete_config(validated_config(TuneConfig, options), sensors)
    sets, trials = config.particles * config.generations * config.trials, count_of(config.trials, "trial")
    given = config.model + (f" with {', '.join(config.use)}" if config.use else "")
    return [
        f"Filter: {because or given}",
        f"Objective: {config.objective}: {parse_objective(config.objective).summary}",
        f"Search: {config.optimizer} with {sets} parameter sets, {trials}, seed {config.seed}",
    ]


def with_default_guards(config: C, *, as_stated: bool = True) -> C:
    """Set the weight of the priors and the process-noise inflation if they are None.

    Objectives that are likelihoods without truth have priors and, in a log10 search, inflation. Objectives with truth
    have inflation only in a log10 search of a model with roll and pitch. In such a search they also have priors if the
    objective is a likelihood, the filter has fix-error, and ``as_stated`` is True (see `_is_as_stated`). Other
    objectives have neither.
    """
    if not isinstance(config, TuneConfig):
        return config
    objective, model = parse_objective(config.objective), MODELS[config.model]
    without_truth = objective.likelihood and not objective.needs_truth
    prior, inflation = float(without_truth), 0.0
    if config.scale == "log10" and without_truth:
        inflation = TILTED_INFLATION if model.tilts or model.measures_imu else INFLATION
    elif config.scale == "log10" and objective.needs_truth and model.tilts:
        inflation = WITH_TRUTH
        likelihood = objective.likelihood and "fix-error" in config.use
        prior = PRIOR_WITH_TRUTH if likelihood and as_stated else 0.0
    return config.model_copy(
        update={
            "prior": prior if config.prior is None else config.prior,
            "inflation": inflation if config.inflation is None else config.inflation,
        }
    )
