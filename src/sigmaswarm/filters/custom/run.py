"""Filters of the user's own over logs: compiled where that can be, in the textbook's form where not."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numba.core.errors import NumbaError

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import SigmaswarmWarning
from sigmaswarm.filters.compiled.custom import build_kernel
from sigmaswarm.filters.custom.checks import check, trial_parameters
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import SCALING_NAMES, Model, as_covariance
from sigmaswarm.filters.custom.steps import Steps, build_steps
from sigmaswarm.filters.textbook.custom import TextbookModel
from sigmaswarm.filters.textbook.loop import FAILURES, Trajectory, run_steps
from sigmaswarm.geodesy import wrap_angle

TRIED = 20
"""Steps that both filters take before the compiled one is trusted with a user's functions."""
SAME = 1e-6
"""How far apart, in standard deviations, they may end: rounding is far below, another meaning far above."""


@dataclass(frozen=True, eq=False)
class ModelEstimate:
    """What a filter of the user's own believed at each of a log's times, after all measurements up to then.

    Attributes
    ----------
    time : ndarray, shape (k,)
        s, the log's.
    mean, covariance : ndarray, shapes (k, n), (k, n, n)
        Of the state, angles wrapped to (-pi, pi]. NaN from a failure on.
    measurement_time : ndarray, shape (f,)
        s, of the measurements within ``time``.
    nis, nll : ndarray, shape (f,)
        Of each measurement before it is absorbed: normalized innovation squared, whose mean is m for a consistent
        filter, and negative log-likelihood.
    failure : str or None
        What went wrong and when; None where nothing did.
    """

    time: Array
    mean: Array
    covariance: Array
    measurement_time: Array
    nis: Array
    nll: Array
    failure: str | None = None


def run_model(log: Log, model: Model, parameters: Mapping[str, float]) -> ModelEstimate:
    """Run the filter of a model of your own over a log.

    Parameters
    ----------
    log : Log
        Its truth, if any, is not looked at.
    model : Model
    parameters : mapping of str to float
        By name, as `Tuning.parameters` has them: the model's, and alpha, beta, kappa for an unscented filter.

    Returns
    -------
    ModelEstimate
        With ``failure`` set where the filter failed.

    Raises
    ------
    InputError
        If model, log and parameters do not fit together.
    """
    model.values(parameters)  # a wrong name is told before anything is compiled
    runner = Runner(model, [log])
    run = runner.run(0, parameters, covariances=True)
    run.mean[:, model.places(model.angles)] = wrap_angle(run.mean[:, model.places(model.angles)])
    steps = runner.steps[0]
    failure = failure_in(log, steps, run.failed)
    return ModelEstimate(
        log.time, run.mean, run.covariance, steps.measurement_time, run.nis, run.nll, failure
    )


def failure_in(log: Log, steps: Steps, failed: int) -> str | None:
    """The sentence that says in which step a filter failed; None where it did in none (-1)."""
    if failed < 0:
        return None
    moment = log.time[0] + steps.dt[: failed + 1].sum()
    return (
        f"{log.name}: the filter failed at t = {moment:.3f} s (covariance not positive definite, or f or h gave no "
        "finite number); are all variances positive?"
    )


@dataclass(frozen=True, eq=False)
class Filtered(Trajectory):
    """What a filter did with a log: the trajectory at its ``time``, and each measurement's NIS and NLL, (f,)."""

    nis: Array
    nll: Array


class Runner:
    """Logs made ready once, to be filtered with any number of parameter sets.

    Parameters
    ----------
    model : Model
    logs : sequence of Log

    Raises
    ------
    InputError
        If the model does not fit a log.
    """

    def __init__(self, model: Model, logs: Sequence[Log]) -> None:
        for log in logs:
            check(model, log)
        self.model = model
        self.steps = [build_steps(log) for log in logs]
        self.kernel = kernel_of(model, self.steps[0])

    def run(self, i: int, parameters: Mapping[str, float], *, covariances: bool = False) -> Filtered:
        """Filter log i with parameters by name."""
        return _run(self.model, self.kernel, self.steps[i], parameters, covariances=covariances)


def _run(
    model: Model, kernel: Any, steps: Steps, parameters: Mapping[str, float], *, covariances: bool
) -> Filtered:
    p = model.values(parameters)
    scaling = np.array([parameters.get(name, np.nan) for name in SCALING_NAMES])
    if kernel is None:
        return _run_textbook(model, steps, scaling, p, covariances=covariances)
    run = _nothing(steps, covariances=covariances)
    line = (steps.dt, steps.source, steps.absorbs, steps.records, steps.inputs, steps.measurements)
    angles = np.isin(range(len(model.states)), model.places(model.angles))
    measured = np.isin(range(steps.measurements.shape[1]), model.measured_angles)
    written = (run.mean, run.covariance, run.nis, run.nll)
    try:
        noise = as_covariance(model.measurement_noise(p))
        failed = kernel(*line, steps.mean, steps.covariance, angles, measured, scaling, noise, p, *written)
    except FAILURES:  # raised by the user's functions; the first step is as good as any to name
        return _nothing(steps, covariances=covariances, failed=0)
    return replace(run, failed=int(failed))


def _run_textbook(model: Model, steps: Steps, scaling: Array, p: Any, *, covariances: bool) -> Filtered:
    try:
        with np.errstate(all="ignore"):  # what comes of it is looked at
            stepper = TextbookModel(model, steps, scaling, p)
    except FAILURES:  # R can't be had
        return _nothing(steps, covariances=covariances, failed=0)
    trajectory = run_steps(stepper, steps.records.tolist(), n_rows=len(steps.inputs), covariances=covariances)
    return Filtered(**vars(trajectory), nis=stepper.nis, nll=stepper.nll)


def _nothing(steps: Steps, *, covariances: bool, failed: int = -1) -> Filtered:
    """NaN all over."""
    k, n, each = len(steps.inputs), len(steps.mean), np.full((2, len(steps.measurements)), np.nan)
    trajectory = Trajectory.empty(k, n, covariances=covariances, failed=failed)
    return Filtered(**vars(trajectory), nis=each[0], nll=each[1])


_KERNELS: "WeakKeyDictionary[Model, Any]" = WeakKeyDictionary()


def kernel_of(model: Model, steps: Steps) -> Any:
    """The model's compiled filter, made when first asked for; None where the textbook's has to do."""
    if model not in _KERNELS:
        _KERNELS[model] = _compiled(model, steps) if model.kind == "ukf" else None
    return _KERNELS[model]


def _compiled(model: Model, steps: Steps) -> Any:
    """Compile, and compare with the textbook's filter over the first steps; None, with a warning, if it fails."""
    few = replace(
        steps, **{name: getattr(steps, name)[:TRIED] for name in ("dt", "source", "absorbs", "records")}
    )
    trial = trial_parameters(model)
    diagonal = np.ndim(model.process_noise(1.0, model.values(trial))) == 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Numba, on how a user's function could be faster
            kernel = build_kernel(model.f, model.h, model.process_noise, diagonal=diagonal)
            compiled = _run(model, kernel, few, trial, covariances=True)
    except (NumbaError, TypeError, NotImplementedError) as error:  # Numba's own are not all NumbaErrors
        why = _reason(error)
    else:
        textbook = _run(model, None, few, trial, covariances=True)
        if _same(compiled, textbook):
            return kernel
        why = "compiled, they give other numbers"
    warnings.warn(
        f"model {model.name}: its functions can't be compiled ({why}); the textbook filter runs them, some hundred "
        "times slower",
        SigmaswarmWarning,
        stacklevel=2,
    )
    return None


def _same(a: Filtered, b: Filtered) -> bool:
    deviation = np.sqrt(np.diagonal(b.covariance, axis1=1, axis2=2))
    apart = np.abs(a.mean - b.mean) / deviation
    return (
        a.failed == b.failed
        and not np.any(apart > SAME)
        and bool(np.array_equal(np.isnan(a.mean), np.isnan(b.mean)))
    )


def _reason(error: Exception) -> str:
    """The line of Numba's message that says what it can't do."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if not line.startswith(("Failed in", "During", "File ", "^"))]
    return (telling or lines or [type(error).__name__])[0].rstrip(".:")
