"""Tuning of a custom model: the optimization problem and the objectives."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model, fingerprint
from sigmaswarm.filters.custom.run import Runner, run_model
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.tuning.bounds import Bounds, Dimension
from sigmaswarm.tuning.config import SearchConfig
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.tuning.problem import Problem
from sigmaswarm.tuning.space import SCALING

MODEL_OBJECTIVES = {
    "truth-rmse": "root mean square of the scored states' errors against truth",
    "innovation-nll": "mean negative log-likelihood of each measurement, given the prediction before its update",
}


@dataclass(frozen=True, eq=False)
class ModelProblem(Problem[dict[str, float]]):
    model: Model
    logs: Sequence[Log]
    runner: Runner
    targets: list[Callable[[Array], float]] | None

    @property
    def steps(self) -> NDArray[np.int64]:
        return np.array([len(steps.dt) for steps in self.runner.steps], dtype=np.int64)

    def parameters(self, point: Array) -> dict[str, float]:
        return dict(zip(self.space.names, self.space.values(point).tolist(), strict=True))

    def failure_reason(self, point: Array) -> str | None:
        """Return the reason why the filter at a point, shape (d,), failed on a log, or None if it did not fail."""
        parameters = self.parameters(point)
        failures = (run_model(log, self.model, parameters).failure for log in self.logs)
        return next((f"model {self.model.name}, log {failure}" for failure in failures if failure), None)

    def costs_by_drive(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        if isinstance(executor, ProcessPoolExecutor):
            raise InputError("your own functions can't be sent to other processes; use a ThreadPoolExecutor")
        sets = [self.parameters(point) for point in points]
        jobs = [(parameters, i) for parameters in sets for i in drives]
        each = np.array(list((executor.map if executor else map)(self._cost, *zip(*jobs, strict=True))))
        return each.reshape(len(points), len(drives))

    def relative_increase(self, costs: Array | float, best: float) -> Array:
        present = (~np.isnan(steps.measurements) for steps in self.runner.steps)
        elements = float(np.mean([each.sum(axis=1).mean() for each in present]))
        return parse_objective(self.config.objective).relative_increase(costs, best, elements)

    def with_data(self, data: Sequence[Log]) -> "ModelProblem":
        return model_problem(data, self.model, self.config)

    def _cost(self, parameters: dict[str, float], i: int) -> float:
        run = self.runner.run(i, parameters)
        if run.failed >= 0:
            return float("inf")
        return self.targets[i](run.mean) if self.targets else float(run.nll.mean())


def model_problem(logs: Sequence[Log], model: Model, config: SearchConfig) -> ModelProblem:
    if not logs:
        raise InputError("there are no logs; pass at least one")
    if config.objective not in MODEL_OBJECTIVES:
        raise InputError(
            f"the objective {config.objective!r} is not available for a custom model; "
            f"choose one of {', '.join(MODEL_OBJECTIVES)}"
        )
    targets = [truth_rmse(log, model) for log in logs] if config.objective == "truth-rmse" else None
    own = [Dimension(t.name, "", 0, t.lowest, t.highest, logarithmic=t.logarithmic) for t in model.parameters]
    space = Bounds((*(SCALING if model.kind == "ukf" else ()), *own), config.scale)
    return ModelProblem(config, space, [*map(_described, logs)], model, logs, Runner(model, logs), targets)


def truth_rmse(log: Log, model: Model) -> Callable[[Array], float]:
    """Return a function that computes the RMSE of a model's ``scored`` states, by default all states with truth.

    The function takes the state means at the log's times, shape (k, n), and interpolates them to the times of the
    truth.
    """
    names = model.scored or tuple(log.truth)
    missing = [name for name in names if name not in log.truth]
    if missing or not names:
        what = f"of {missing[0]!r} " if missing and log.truth else ""
        raise log.wrong(f"has no truth {what}for truth-rmse; add the truth, or tune with innovation-nll")
    moments = log.time if log.truth_time is None else log.truth_time
    within = (moments >= log.time[0]) & (moments <= log.time[-1])
    if not within.any():
        raise log.wrong(
            f"truth covers t = {moments[0]:g} to {moments[-1]:g} s, but the inputs cover {log.time[0]:g} to "
            f"{log.time[-1]:g} s; convert both to one clock"
        )
    moments = moments[within]
    before = np.searchsorted(log.time, moments, side="right") - 1
    after = np.minimum(before + 1, len(log.time) - 1)
    interval = np.where(after > before, log.time[after] - log.time[before], 1.0)
    weight = ((moments - log.time[before]) / interval)[:, np.newaxis]
    truth = np.column_stack([log.truth[name][within] for name in names])
    indices, angles = model.indices(names), np.isin(names, model.angles)

    def rmse(mean: Array) -> float:
        estimate = mean[:, indices]
        early, moved = estimate[before], estimate[after] - estimate[before]
        error = early + weight * np.where(angles, wrap_angle(moved), moved) - truth
        error = np.where(angles, wrap_angle(error), error)
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))

    return rmse


def _described(log: Log) -> dict[str, Any]:
    columns = (log.time, log.inputs, log.measurement_time, log.measurements, log.mean, log.covariance)
    return {
        "name": log.name,
        "duration_s": round(float(log.time[-1] - log.time[0]), 3),
        "inputs": len(log.time),
        "measurements": len(log.measurements),
        "has_truth": bool(log.truth),
        "sha256": fingerprint(*columns, log.truth_time, dict(log.truth)),
    }
