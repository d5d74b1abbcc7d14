"""Run filters of users' models over logs, compiled or in textbook form, and smooth their estimates."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
from numba.core.errors import NumbaError

from sigmaswarm.arrays import Array
from sigmaswarm.errors import SigmaswarmWarning
from sigmaswarm.filters.compiled.custom import build_kernel
from sigmaswarm.filters.custom.log import FilterSteps, Log, build_steps
from sigmaswarm.filters.custom.model import SCALING_NAMES, Model, as_covariance, fingerprint
from sigmaswarm.filters.custom.textbook import TextbookModel
from sigmaswarm.filters.textbook.kalman import complex_step
from sigmaswarm.filters.textbook.loop import FAILURES, Trajectory, run_steps, smooth_steps
from sigmaswarm.geodesy import wrap_angle

# Number of steps in which a compiled filter is compared with the textbook filter before its first use
VERIFIED_STEPS = 20
# Largest accepted difference, in standard deviations; rounding causes far smaller differences, wrong code larger ones
MAX_DIFFERENCE = 1e-6


@dataclass(frozen=True, eq=False)
class ModelEstimate:
    """Estimates of the filter of a user's model at each time of a log.

    Attributes
    ----------
    time : ndarray, shape (k,)
        Times of the log, s.
    mean, covariance : ndarray, shapes (k, n), (k, n, n)
        State estimate, angles wrapped to (-pi, pi]. NaN after a failure.
    measurement_time : ndarray, shape (f,)
        Times of the measurements within ``time``, s.
    nis, nll : ndarray, shape (f,)
        Normalized innovation squared and negative log-likelihood of each measurement, before its update. For a
        consistent filter, the mean NIS is the mean number of elements of a measurement that are not NaN.
    failure : str or None
        The failure and its time; None if the filter did not fail.
    """

    time: Array
    mean: Array
    covariance: Array
    measurement_time: Array
    nis: Array
    nll: Array
    failure: str | None = None


def run_model(log: Log, model: Model, parameters: Mapping[str, float]) -> ModelEstimate:
    """Run the filter of a user's model over a log.

    Parameters
    ----------
    log : Log
        The filter does not use the log's truth.
    model : Model
    parameters : mapping of str to float
        The model's parameters by name, as in `Tuning.parameters`. For an unscented filter they include alpha, beta and
        kappa.

    Returns
    -------
    ModelEstimate
        Estimates from all measurements up to each time. ``failure`` is set if the filter failed.

    Raises
    ------
    InputError
        If model, log and parameters do not match.
    """
    model.values(parameters)  # report wrong names before compiling
    runner = Runner(model, [log])
    return _estimate(log, model, runner.steps[0], runner.run(0, parameters, covariances=True))


def smooth_model(log: Log, model: Model, parameters: Mapping[str, float]) -> ModelEstimate:
    """Run the filter of a user's model over a log, and smooth its estimates: each estimate uses all measurements.

    `smooth` lists the sources. Filter and smoother run in NumPy, about a hundred times slower than `run_model`.

    Parameters
    ----------
    log, model, parameters
        See `run_model`.

    Returns
    -------
    ModelEstimate
        ``nis`` and ``nll`` are those of the filter. If the filter failed, ``failure`` is set; the estimates before the
        failure are smoothed, and the others are NaN.

    Raises
    ------
    InputError
        If model, log and parameters do not match.
    """
    model.values(parameters)
    check(model, log)
    steps = build_steps(log)
    smoothed = _empty_trajectory(steps, covariances=True, failed=0)
    try:
        stepper = _textbook(model, steps, parameters, np.zeros((log.measurements.shape[1], 2)))
    except FAILURES:
        return _estimate(log, model, steps, smoothed)
    trajectory = smooth_steps(stepper, len(steps.dt))
    records = steps.records[: len(trajectory.mean) - 1]
    at = np.flatnonzero(records >= 0)
    smoothed.mean[records[at]] = trajectory.mean[at + 1]
    smoothed.covariance[records[at]] = trajectory.covariance[at + 1]
    found = replace(smoothed, nis=stepper.nis, nll=stepper.nll, failed=trajectory.failed)
    return _estimate(log, model, steps, found)


def _estimate(log: Log, model: Model, steps: FilterSteps, run: "ModelTrajectory") -> ModelEstimate:
    angles = model.indices(model.angles)
    run.mean[:, angles] = wrap_angle(run.mean[:, angles])
    failure = failure_in(log, steps, run.failed)
    return ModelEstimate(
        log.time, run.mean, run.covariance, steps.measurement_time, run.nis, run.nll, failure
    )


def failure_in(log: Log, steps: FilterSteps, failed: int) -> str | None:
    if failed < 0:
        return None
    moment = log.time[0] + steps.dt[: failed + 1].sum()
    return (
        f"{log.name}: the filter failed at t = {moment:.3f} s (covariance not positive definite, or f or h "
        "returned a value that is not finite); check that all variances are positive"
    )


@dataclass(frozen=True, eq=False)
class ModelTrajectory(Trajectory):
    """Trajectory of a filter at the times of a log, with NIS and negative log-likelihood of each measurement, (f,)."""

    nis: Array
    nll: Array


class Runner:
    """A model and logs, prepared for runs with any parameters.

    Raises `InputError` if the model does not match a log.
    """

    def __init__(self, model: Model, logs: Sequence[Log]) -> None:
        for log in logs:
            check(model, log)
        self.model = model
        self.steps = [build_steps(log) for log in logs]
        self.kernel = kernel_of(model, self.steps[0])

    def run(self, i: int, parameters: Mapping[str, float], *, covariances: bool = False) -> ModelTrajectory:
        return run_kernel(self.model, self.kernel, self.steps[i], parameters, covariances=covariances)


def run_kernel(
    model: Model,
    kernel: Any,
    steps: FilterSteps,
    parameters: Mapping[str, float],
    *,
    covariances: bool,
    runs: Array | None = None,
) -> ModelTrajectory:
    """Run the compiled filter or, if ``kernel`` is None, the textbook filter.

    ``runs`` is updated as in `TextbookModel`.
    """
    runs = np.zeros((steps.measurements.shape[1], 2)) if runs is None else runs
    p, scaling = model.values(parameters), _scaling(parameters)
    run = _empty_trajectory(steps, covariances=covariances)
    line = (steps.dt, steps.source, steps.updates, steps.records, steps.inputs, steps.measurements)
    angles = np.isin(range(len(model.states)), model.indices(model.angles))
    measured = np.isin(range(steps.measurements.shape[1]), model.measured_angles)
    written = (run.mean, run.covariance, run.nis, run.nll)
    try:
        if kernel is None:
            stepper, records = _textbook(model, steps, parameters, runs), steps.records.tolist()
            found = run_steps(stepper, records, n_rows=len(steps.inputs), covariances=covariances)
            return ModelTrajectory(**vars(found), nis=stepper.nis, nll=stepper.nll)
        noise = as_covariance(model.measurement_noise(p))
        limits = model.limits(steps.measurements.shape[1])
        start = steps.mean, steps.covariance
        failed = kernel(*line, *start, angles, measured, scaling, noise, limits, runs, p, *written)
    except FAILURES:  # from the user's functions, in an unknown step
        return _empty_trajectory(steps, covariances=covariances, failed=0)
    return replace(run, failed=int(failed))


@np.errstate(all="ignore")  # the result is checked
def _textbook(
    model: Model, steps: FilterSteps, parameters: Mapping[str, float], runs: Array
) -> TextbookModel:
    """Return the textbook filter at the start of a log. Raises one of `FAILURES` if the user's functions fail there."""
    return TextbookModel(model, steps, _scaling(parameters), model.values(parameters), runs)


def _scaling(parameters: Mapping[str, float]) -> Array:
    return np.array([parameters.get(name, np.nan) for name in SCALING_NAMES])


def _empty_trajectory(steps: FilterSteps, *, covariances: bool, failed: int = -1) -> ModelTrajectory:
    k, n, (nis, nll) = len(steps.inputs), len(steps.mean), np.full((2, len(steps.measurements)), np.nan)
    trajectory = Trajectory.empty(k, n, covariances=covariances, failed=failed)
    return ModelTrajectory(**vars(trajectory), nis=nis, nll=nll)


_KERNELS: "WeakKeyDictionary[Model, Any]" = WeakKeyDictionary()
_BUILT: "WeakValueDictionary[str, Any]" = WeakValueDictionary()
"""Kernels by the hash of a model's functions; models that differ only in bounds or R have the same kernel."""


def kernel_of(model: Model, steps: FilterSteps) -> Any:
    """Return the kernel of a model, compiled at the first use, or None if the model cannot be compiled."""
    if model not in _KERNELS:
        _KERNELS[model] = _compiled(model, steps) if model.kind == "ukf" else None
    return _KERNELS[model]


def _compiled(model: Model, steps: FilterSteps) -> Any:
    """Compile the filter; warn and return None if this fails, or if its results differ from the textbook filter."""
    few = replace(
        steps,
        **{name: getattr(steps, name)[:VERIFIED_STEPS] for name in ("dt", "source", "updates", "records")},
    )
    trial = trial_parameters(model)
    diagonal = np.ndim(model.process_noise(1.0, model.values(trial))) == 1
    functions = model.f, model.h, model.process_noise
    key = fingerprint(*functions, diagonal)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Numba warns about slow constructs in a user's function
            kernel = _BUILT.get(key) or build_kernel(*functions, diagonal=diagonal)
            compiled = run_kernel(model, kernel, few, trial, covariances=True)
    except (NumbaError, TypeError, NotImplementedError) as error:  # Numba also raises other errors
        why = _reason(error)
    else:
        textbook = run_kernel(model, None, few, trial, covariances=True)
        if _same(compiled, textbook):
            _BUILT[key] = kernel
            return kernel
        if _BUILT.pop(key, None):  # a global value that the functions read has changed
            return _compiled(model, steps)
        why = "the compiled functions and the Python functions return different numbers"
    warnings.warn(
        f"model {model.name}: can't be compiled ({why}); the textbook filter runs instead, about a hundred times "
        "slower",
        SigmaswarmWarning,
        stacklevel=2,
    )
    return None


def _same(a: ModelTrajectory, b: ModelTrajectory) -> bool:
    deviation = np.sqrt(np.diagonal(b.covariance, axis1=1, axis2=2))
    apart = np.abs(a.mean - b.mean) / deviation
    return (
        a.failed == b.failed
        and not np.any(apart > MAX_DIFFERENCE)
        and bool(np.array_equal(np.isnan(a.mean), np.isnan(b.mean)))
    )


def _reason(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    reasons = [line for line in lines if not line.startswith(("Failed in", "During", "File ", "^"))]
    return (reasons or lines or [type(error).__name__])[0].rstrip(".:")


def trial_parameters(model: Model) -> dict[str, float]:
    """Return parameters in the middle of their bounds, on the scale of the search."""
    middle = {
        t.name: float(np.sqrt(t.lowest * t.highest) if t.logarithmic else (t.lowest + t.highest) / 2)
        for t in model.parameters
    }
    return middle | ({"alpha": 0.5, "beta": 2.0, "kappa": 1.0} if model.kind == "ukf" else {})


def check(model: Model, log: Log) -> None:
    """Call the model's functions at the start of the log.

    Raises `InputError` if a function fails or does not match the log.
    """
    n, m = len(model.states), log.measurements.shape[1]
    if len(log.mean) != n:
        raise log.wrong(f"mean has {len(log.mean)} values, but the model {model.name} has {n} states")
    for name in log.truth:
        if name not in model.states:
            raise log.wrong(f"truth names {name!r}, which is not a state of the model {model.name}")
    for i in model.measured_angles:
        if i not in range(m):
            raise model.wrong(
                f"measured_angles contains the index {i}, but a measurement of {log.name} has {m} elements "
                "(indices from 0)"
            )
    p = model.values(trial_parameters(model))
    dt = float(np.diff(log.time).mean()) if len(log.time) > 1 else 1.0
    u = (log.inputs if log.inputs is not None else np.empty((1, 0)))[0]

    def f(state: Any) -> Any:
        return model.f(state.copy(), dt, u, p)

    def h(state: Any) -> Any:
        return model.h(state.copy(), p)

    _shape(model, log, "f", lambda: f(log.mean), [(n,)])
    _shape(model, log, "h", lambda: h(log.mean), [(m,)])
    _shape(model, log, "process_noise", lambda: model.process_noise(dt, p), [(n,), (n, n)])
    _shape(model, log, "measurement_noise", lambda: model.measurement_noise(p), [(m,), (m, m)])
    if model.kind == "ekf":  # its derivatives are complex steps
        _shape(model, log, "f of a complex state", lambda: complex_step(f, log.mean), [(n, n)])
        _shape(model, log, "h of a complex state", lambda: complex_step(h, log.mean), [(m, n)])


def _shape(model: Model, log: Log, role: str, call: Callable[[], Any], wanted: list[tuple[int, ...]]) -> None:
    with np.errstate(all="ignore"):
        try:
            result = np.asarray(call(), dtype=np.float64)
        except Exception as error:  # a user's function may raise any error
            reason = " ".join(str(error).split())
            raise model.wrong(f"{role} fails on {log.name} ({type(error).__name__}, {reason})") from error
    if result.shape not in wanted:
        shapes = " or ".join(str(shape) for shape in wanted)
        raise model.wrong(f"{role} returns shape {result.shape} on {log.name}; return {shapes}")
