"""Objectives of a tuning of a custom model."""

from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.overlap import Landmarks
from sigmaswarm.errors import InputError
from sigmaswarm.filters.custom.identity import fingerprint
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model
from sigmaswarm.filters.custom.run import Runner, run_model
from sigmaswarm.scoring.custom import truth_rmse
from sigmaswarm.tuning.box import Box
from sigmaswarm.tuning.config import ModelTuneConfig
from sigmaswarm.tuning.objectives import mean_cost, objective_named
from sigmaswarm.tuning.space import SCALING, Scale

MODEL_OBJECTIVES = {
    "truth-rmse": "root mean square of the scored states' errors against truth",
    "innovation-nll": "mean negative log-likelihood of each measurement before it is absorbed",
}
"""Objectives of custom models."""


class ModelProblem:
    """A model of the user's own, on logs.

    Raises
    ------
    InputError
        If the model does not fit a log, or the objective is none for models or needs truth that a log does not have.
    """

    def __init__(self, logs: Sequence[Log], model: Model, config: ModelTuneConfig) -> None:
        if not logs:
            raise InputError("no logs were given; give at least one")
        if config.objective not in MODEL_OBJECTIVES:
            raise InputError(
                f"the objective {config.objective!r} is none for a model of your own; "
                f"choose one of {', '.join(MODEL_OBJECTIVES)}"
            )
        truth = config.objective == "truth-rmse"
        self._model, self._config, self._logs = model, config, logs
        self._targets = [truth_rmse(log, model) if truth else None for log in logs]
        self.space = model_box(model, config.scale)
        self.data = [_described(log) for log in logs]
        self._elements = logs[0].measurements.shape[1]
        self.runner = Runner(model, logs)
        self.steps = np.array([len(steps.dt) for steps in self.runner.steps], dtype=np.int64)

    def parameters(self, point: Array) -> dict[str, float]:
        """Parameters by name at a point, shape (d,), in search coordinates."""
        return self._named(self.space.values(point))

    def why_none(self, point: Array) -> str | None:
        """Return the failure of the filter at a point, shape (d,), on the first log on which it fails."""
        parameters = self.parameters(point)
        failures = (run_model(log, self._model, parameters).failure for log in self._logs)
        return next((f"model {failure}" for failure in failures if failure), None)

    def costs(self, points: Array, executor: Executor | None) -> Array:
        """Costs, shape (n,), of points in search coordinates, shape (n, d): the mean over the logs that count."""
        return self.mean(self.each(points, range(len(self.data)), executor))

    def each(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        """The costs on some of the logs, shape (n, len(drives))."""
        if isinstance(executor, ProcessPoolExecutor):
            raise InputError(
                "functions of your own can't be sent to other processes; use a ThreadPoolExecutor"
            )
        sets = [self._named(row) for row in self.space.values(points)]
        jobs = [(parameters, i) for parameters in sets for i in drives]
        each = np.array(list((executor.map if executor else map)(self._cost, *zip(*jobs, strict=True))))
        return each.reshape(len(points), len(drives))

    def mean(self, each: Array) -> Array:
        """The costs, shape (n,), of the costs on each log that was tried, shape (n, k)."""
        return mean_cost(each, self._config.worst)

    def rise(self, costs: Array | float, best: float) -> Array:
        """How much worse costs are than another: 0.01 is 1%."""
        return objective_named(self._config.objective).rise(costs, best, self._elements)

    def judged(self, point: Array, executor: Executor | None) -> float:
        """The cost at a point."""
        return float(self.costs(point[np.newaxis], executor)[0])

    def warnings(self, point: Array) -> list[str]:
        """Return nothing: the meaning of the data of a user's own model is not known."""
        return []

    @property
    def seen(self) -> tuple[Landmarks, ...]:
        """None: a log of a custom model is recognized only as a whole."""
        return ()

    def on(self, data: Sequence[Log]) -> "ModelProblem":
        """The same filters and objective on other logs."""
        return ModelProblem(data, self._model, self._config)

    def _cost(self, parameters: dict[str, float], i: int) -> float:
        run, targets = self.runner.run(i, parameters), self._targets[i]
        if run.failed >= 0:
            return float("inf")
        return targets(run.mean) if targets else float(run.nll.mean())

    def _named(self, values: Array) -> dict[str, float]:
        return dict(zip(self.space.names, values.tolist(), strict=True))


def model_box(model: Model, scale: Scale) -> Box:
    """The model's parameters, and the sigma points' scaling where it has them; ``scale`` linear: nothing in log10."""
    scaling = SCALING if model.kind == "ukf" else ()
    own = model.parameters
    return Box(
        names=(*(d.name for d in scaling), *(t.name for t in own)),
        lowest=np.array([*(d.lowest for d in scaling), *(t.lowest for t in own)], dtype=np.float64),
        highest=np.array([*(d.highest for d in scaling), *(t.highest for t in own)], dtype=np.float64),
        logarithmic=np.array([*(False for _ in scaling), *(t.logarithmic for t in own)]) & (scale == "log10"),
    )


def _described(log: Log) -> dict[str, Any]:
    """Identification of a log, as `described` is of a drive."""
    columns = (log.time, log.inputs, log.measurement_time, log.measurements, log.mean, log.covariance)
    return {
        "name": log.name,
        "duration_s": round(float(log.time[-1] - log.time[0]), 3),
        "inputs": len(log.time),
        "measurements": len(log.measurements),
        "has_truth": bool(log.truth),
        "sha256": fingerprint(*columns, log.truth_time, dict(log.truth)),
    }
