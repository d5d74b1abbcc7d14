"""Checks of a model on a log before anything runs."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model
from sigmaswarm.filters.textbook.ekf import complex_step

TRIAL_SCALING = {"alpha": 0.5, "beta": 2.0, "kappa": 1.0}


def trial_parameters(model: Model) -> dict[str, float]:
    """Parameters from the middle of the bounds, to try the model's functions with."""
    middle = {
        t.name: float(np.sqrt(t.lowest * t.highest) if t.logarithmic else (t.lowest + t.highest) / 2)
        for t in model.parameters
    }
    return middle | (TRIAL_SCALING if model.kind == "ukf" else {})


def check(model: Model, log: Log) -> None:
    """Try the model's functions on the log's first data.

    Raises
    ------
    InputError
        With the function, its result, and what is needed.
    """
    n, m = len(model.states), log.measurements.shape[1]
    if len(log.mean) != n:
        raise log.wrong(f"mean has {len(log.mean)} values, the model {model.name} has {n} states")
    for name in log.truth:
        if name not in model.states:
            raise log.wrong(f"truth names {name!r}, which is not a state of the model {model.name}")
    for i in model.measured_angles:
        if i not in range(m):
            raise model.wrong(
                f"measured_angles has {i}, but a measurement of {log.name} has {m} elements, from 0"
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
        except Exception as error:  # whatever a user's function may raise
            said = " ".join(str(error).split())
            raise model.wrong(f"{role} fails on {log.name}: {type(error).__name__}: {said}") from error
    if result.shape not in wanted:
        shapes = " or ".join(str(shape) for shape in wanted)
        raise model.wrong(f"{role} gives shape {result.shape} on {log.name}; it should be {shapes}")
