"""The optimization problem of a tuning run."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.datasets.dataset import Dataset, LocalDataset
from sigmaswarm.drives.alignment_fit import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import drive_record, rounded
from sigmaswarm.drives.overlap import Landmarks, landmarks
from sigmaswarm.drives.sensors import LogProperties, enough_for_fix_error, log_properties, true_gyro_bias
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.run import run_kernel
from sigmaswarm.filters.fixes_alone import MotionNoise, fitted_noise
from sigmaswarm.filters.kernels import kernel_name
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline_of
from sigmaswarm.filters.starts import require_named_axes
from sigmaswarm.scoring.batch import Scores
from sigmaswarm.scoring.remote import AnyBatchScorer
from sigmaswarm.tuning.batch import check_drives, scorer_for
from sigmaswarm.tuning.bounds import Bounds
from sigmaswarm.tuning.config import SearchConfig, TuneConfig
from sigmaswarm.tuning.diagnostics import (
    confirmed_std,
    correlation_of,
    correlation_warnings,
    divergence_or_drift_warnings,
    forecasts_of,
    scale_warnings,
)
from sigmaswarm.tuning.objectives import Objective, mean_cost, parse_objective
from sigmaswarm.tuning.receiver import (
    StdCheck,
    accuracy_warnings,
    fix_noise,
    median_stated_std,
    noise_warnings,
    prior_costs,
    prior_warnings,
)
from sigmaswarm.tuning.space import TYPICAL_DURATION, TYPICAL_WEIGHT, SearchSpace, search_space

P = TypeVar("P", covariant=True)


@dataclass(frozen=True, eq=False)
class Problem(ABC, Generic[P]):
    """Filter, data and objective of a tuning run; points are in search coordinates.

    Q refers to the IMU interval of the drives for which ``space`` was made. ``data`` identifies the drives or logs.
    """

    config: SearchConfig
    space: Bounds
    data: list[dict[str, Any]]

    @property
    def recorded_data(self) -> list[dict[str, Any]]:
        """The record ``data`` of tuning.toml, with additional properties that do not identify a drive."""
        return self.data

    @property
    def seen(self) -> Iterable[Landmarks]:
        """Landmarks that identify each drive; empty for logs of a custom model."""
        return ()

    @property
    @abstractmethod
    def steps(self) -> NDArray[np.int64]:
        """Number of filter steps of one evaluation on each drive, shape (m,)."""

    @abstractmethod
    def parameters(self, point: Array) -> P:
        """Return the filter parameters at a point, shape (d,)."""

    @abstractmethod
    def costs_by_drive(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        """Return the costs, shape (n, k), of points, shape (n, d), on k drives given by index; ``inf`` for failures."""

    @abstractmethod
    def relative_increase(self, costs: Array | float, best: float) -> Array:
        """Return the relative increase of costs over ``best``; 0.01 means 1%."""

    @abstractmethod
    def with_data(self, data: Any) -> "Problem[P]":
        """Return the problem with the same filter and objective, but other data."""

    def combined(self, each: Array) -> Array:
        """Combine the costs on k drives, shape (n, k), to costs of the points, shape (n,)."""
        return mean_cost(each, self.config.worst)

    def costs(self, points: Array, executor: Executor | None) -> Array:
        """Return the costs, shape (n,), of points, shape (n, d); ``inf`` where a filter failed."""
        return self.combined(self.costs_by_drive(points, range(len(self.steps)), executor))

    def costs_without_prior(self, points: Array, executor: Executor | None) -> Array:
        """Return the costs, shape (n,), of points, shape (n, d), without a prior."""
        return self.costs(points, executor)

    def diagnosis(self, point: Array, executor: Executor | None) -> dict[str, Any]:
        """Return the attributes of `Tuning` that describe faults of the filter at a point, which the cost hides."""
        return {}

    def baseline_point(self) -> Array | None:
        """Return the baseline as a point in the search space, shape (d,); None for a custom model."""
        return None

    def failure_reason(self, point: Array) -> str | None:
        """Return the reason why the filter at a point failed, or None if it is unknown."""
        return None


@dataclass(frozen=True, eq=False)
class CarProblem(Problem[FilterParameters]):
    """Tuning of a built-in model on drives, made by `car_problem`.

    ``std_check`` is the standard deviation of the fixes that replaces an assumed one. For ``branched`` see
    `PassOptions`.
    """

    config: TuneConfig
    space: SearchSpace
    scorer: AnyBatchScorer
    std_check: StdCheck | None = None
    branched: bool = True

    @cached_property
    def objective(self) -> Objective:
        return parse_objective(self.config.objective)

    @cached_property
    def _receiver_std(self) -> Array:  # in meters, shape (m, 2)
        check = self.std_check
        return np.array(
            [(check.std,) * 2 if check and one.assumed_std else one.receiver_std for one in self.sensors]
        )

    @cached_property
    def _shown_stds(self) -> list[float | None]:
        """Standard deviations of the fixes of each drive, m per axis, from the truth or from ``std_check``."""
        if self.objective.needs_truth:
            return [one.true_std if np.isfinite(one.true_std) else None for one in self.sensors]
        check = self.std_check
        return [check.std if check and one.assumed_std else None for one in self.sensors]

    @property
    def recorded_data(self) -> list[dict[str, Any]]:
        described: list[dict[str, Any]] = []
        for entry, one, std in zip(self.data, self.sensors, self._shown_stds, strict=True):
            shown = {} if std is None else {"shown_std_m": rounded(std)}
            known = {key: value for key, value in entry.items() if value != {}}
            described.append({**known, "receiver_std_m": rounded(max(one.receiver_std)), **shown})
        return described

    @property
    def shown_std(self) -> float | None:
        """Median standard deviation of the fixes, m per axis, from the truth or from ``std_check``; None if unknown."""
        known = [std for std in self._shown_stds if std is not None]
        return float(np.median(known)) if known else None

    @cached_property
    def _weight_of_typical(self) -> float:
        return TYPICAL_WEIGHT * duration_share(self.data, TYPICAL_DURATION)

    @cached_property
    def _landmarks(self) -> list[Landmarks]:
        return self.scorer.dataset.map(landmarks)

    @property
    def seen(self) -> Iterable[Landmarks]:
        """Landmarks of each drive; those of a remote dataset are computed one by one, to save memory."""
        dataset = self.scorer.dataset
        return self._landmarks if isinstance(dataset, LocalDataset) else dataset.imap(landmarks)

    @property
    def steps(self) -> NDArray[np.int64]:
        return self.scorer.steps

    def parameters(self, point: Array) -> FilterParameters:
        return self.space.decode(point[np.newaxis])[0]

    @cached_property
    def sensors(self) -> list[LogProperties]:
        return self.scorer.dataset.map(log_properties)

    def costs_by_drive(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        scorer = self.scorer.subset(drives)
        parameter_sets = self.space.decode(points)
        costs = scorer.measured(partial(costs_of_each, self.config.objective), parameter_sets, executor)
        if self.config.prior:
            costs += self.config.prior * prior_costs(parameter_sets, self._receiver_std[list(drives)])
            costs += self.config.prior * self._weight_of_typical * self.space.distance(points)[:, np.newaxis]
        return costs

    def costs_without_prior(self, points: Array, executor: Executor | None) -> Array:
        plain = replace(self, config=self.config.model_copy(update={"prior": 0.0}))
        return plain.costs(points, executor)

    def relative_increase(self, costs: Array | float, best: float) -> Array:
        return self.objective.relative_increase(costs, best)

    def with_data(self, data: Sequence[Drive] | Dataset) -> "CarProblem":
        return car_problem(data, self.config, self.space, self.std_check, branched=self.branched)

    def baseline_point(self) -> Array:
        """Return the baseline for the first drive as a point in the search space, shape (d,)."""
        model, use = self.config.model, self.config.use
        (parameters,) = self.scorer.dataset.subset([0]).map(
            partial(baseline_of, model=model, use=use, shown_std=self.shown_std)
        )
        return self.space.point_of(parameters)

    def fixes_alone(self, executor: Executor | None = None) -> MotionNoise:
        """Fit the noise of a constant-velocity filter that uses only fixes."""
        return MotionNoise.typical(self.scorer.map_prepared(fitted_noise, executor))

    def starts(self) -> Sequence[InitialState]:
        """Return the initial state of the filter on each drive."""
        return self.scorer.map_prepared(attrgetter("initial"))

    def true_gyro_biases(self) -> Sequence[float]:
        """Return the bias of gz on each drive, rad/s, if the objective uses truth."""
        return self.scorer.dataset.map(true_gyro_bias) if self.objective.needs_truth else ()

    def diagnosis(self, point: Array, executor: Executor | None) -> dict[str, Any]:
        noise = self.fixes_alone(executor)
        forecasts = forecasts_of(self.parameters(point), noise, self.scorer, self.shown_std, executor)
        return {
            "fixes_alone": noise,
            "forecasts": tuple(forecasts),
            "warnings": tuple(self.warnings(point)),
        }

    def warnings(self, point: Array) -> list[str]:
        parameters, scorer, objective = self.parameters(point), self.scorer, self.objective
        messages = divergence_or_drift_warnings(
            parameters, scorer, self.shown_std, outages=not objective.needs_outages
        )
        if parameters.accuracy_scale is not None:
            messages += accuracy_warnings(parameters, scorer.dataset.map(median_stated_std), self.config.use)
        messages += scale_warnings(objective, parameters, scorer)
        # Skipped with truth, since estimating the noise of the fixes takes as long as reading a drive.
        if not (objective.needs_truth and all(drive.truth for drive in self.sensors)):
            noise = scorer.dataset.map(fix_noise)
            prior = self.config.prior or 0.0
            names, check = [drive.name for drive in self.sensors], self.std_check
            assumed = [drive.assumed_std and not check for drive in self.sensors]
            stds = self._receiver_std
            decided = prior_warnings(parameters, prior, names, stds, noise, assumed) if prior else []
            messages += [check.message] if check else []
            messages += decided or noise_warnings(parameters, noise, check, self.config.use)
            if enough_for_fix_error(self.sensors):  # with fewer fixes, fix-error increases errors
                correlations = scorer.map_prepared(partial(correlation_of, parameters=parameters))
                messages += correlation_warnings(parameters, correlations, self.config.use)
        return messages


def duration_share(data: Iterable[Mapping[str, Any]], reference: float) -> float:
    """Return the ratio of a reference duration (s) to the total driving time, at most 1."""
    return min(1.0, reference / sum(entry["duration_s"] for entry in data))


def costs_of_each(objective: str, scores: Scores) -> Array:
    """Return the costs of a named objective, shape (n_sets, n_drives)."""
    return parse_objective(objective).costs_by_drive(scores)


def car_problem(
    drives: Sequence[Drive] | Dataset,
    config: TuneConfig,
    space: SearchSpace | None = None,
    std_check: StdCheck | None = None,
    *,
    branched: bool = True,
) -> CarProblem:
    """Create the optimization problem. If ``space`` is None, also determine the space and ``std_check``."""
    objective = parse_objective(config.objective)
    if config.prior and not objective.nats:
        raise InputError(
            f"prior = {config.prior:g}: the prior is in nats, but {objective.name} is not; omit prior, or use "
            "innovation-nll or innovation-t"
        )
    dataset = LocalDataset(drives) if isinstance(drives, Sequence) else drives
    have = dataset.map(log_properties)
    check_drives(have, objective)
    _check_columns(have, config)
    scorer = scorer_for(
        objective, dataset, config.outage_seed, as_recorded=config.as_recorded, branched=branched
    )
    data = dataset.map(drive_record)
    # Compiled before the threads start; otherwise all threads would wait for the kernel.
    run_kernel(kernel_name(config.model, config.kind, "fix-error" in config.use))
    if space is None:
        space, std_check = car_space(config, have), _std_check(scorer, config, have)
    return CarProblem(config, space, data, scorer, std_check, branched)


def _std_check(scorer: AnyBatchScorer, config: TuneConfig, have: Sequence[LogProperties]) -> StdCheck | None:
    """Compare the assumed standard deviation of fixes with their scatter, if it is assumed on all drives.

    Return None if a log or the truth shows the standard deviation on some drive, since the result applies to all
    receivers. Also return None with fix-error, which models the assumed standard deviation as that of correlated
    errors.
    """
    if (
        not all(one.assumed_std for one in have)
        or "fix-error" in config.use
        or parse_objective(config.objective).needs_truth
    ):
        return None
    (like,) = scorer.dataset.subset([0]).map(partial(baseline_of, model=config.model, use=config.use))
    scatters = [one.scatter for one in scorer.dataset.map(fix_noise) if np.isfinite(one.scatter)]
    return confirmed_std(like, float(np.median(scatters)), scorer) if scatters else None


def car_space(config: TuneConfig, drives: Sequence[Drive | LogProperties]) -> SearchSpace:
    """Return the search space of a configuration; Q refers to the median IMU interval of the drives."""
    have = [log_properties(drive) for drive in drives]
    return search_space(
        config.model,
        config.scale,
        float(np.median([one.interval for one in have])),
        kind=config.kind,
        use=config.use,
        fix_std=float(np.median([one.receiver_std for one in have])),
        has_truth=parse_objective(config.objective).needs_truth,
    )


def _check_columns(drives: Sequence[LogProperties], config: TuneConfig) -> None:
    needed = {"accuracy": "std_x and std_y", "velocity": "speed and course", "heading": "heading"}
    for drive in drives:
        for option, columns in needed.items():
            if option in config.use and not getattr(drive, option):
                why = f"which --use {option} needs; omit {option}"
                raise InputError(f"{drive.name}: its gps.csv has no {columns}, {why}")
        require_named_axes(drive.name, drive.axes, config.model)
