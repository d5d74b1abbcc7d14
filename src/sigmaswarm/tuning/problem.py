"""The problem that a tuning solves: a filter's cost on data, over a box."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Protocol, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.datasets.dataset import Dataset, LocalDataset
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.fingerprint import described
from sigmaswarm.drives.overlap import Landmarks, landmarks
from sigmaswarm.drives.sensors import Sensors, sensors_of
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.run import run_kernel
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import require_named_axes
from sigmaswarm.scoring.batch import Scores
from sigmaswarm.scoring.remote import Replays
from sigmaswarm.tuning.batch import check_drives, replays_for
from sigmaswarm.tuning.box import Box
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.diagnostics import (
    FEW,
    NAMED,
    correlation_of,
    drifts_of,
    may_drift_far,
    restarts_of,
    said_of_correlation,
    said_of_drifts,
    said_of_lost,
    said_of_scale,
)
from sigmaswarm.tuning.objectives import Objective, mean_cost, objective_named
from sigmaswarm.tuning.prior import prior_costs, typical_variance
from sigmaswarm.tuning.receiver import (
    FixNoise,
    fix_noise,
    said_of_accuracy,
    said_of_noise,
    said_of_prior,
    stated,
)
from sigmaswarm.tuning.space import SearchSpace, search_space

P = TypeVar("P", covariant=True)
PRIOR_DECIDED = 0.02
"""Cost of the prior, nats per fix, above which a warning reports that it decided R."""


class Landscape(Protocol):
    """A box, and the costs of points in it."""

    @property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, shape (m,)."""
        ...

    @property
    def space(self) -> Box:
        """The box that is searched."""
        ...

    def costs(self, points: Array, executor: Executor | None) -> Array:
        """Costs, shape (n,), of points in search coordinates, shape (n, d); ``inf`` where a filter failed."""
        ...

    def each(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        """The costs on some of the drives, shape (n, len(drives))."""
        ...

    def mean(self, each: Array) -> Array:
        """The costs, shape (n,), of the costs on each drive that was tried, shape (n, k)."""
        ...


class Problem(Landscape, Protocol[P]):
    """A filter, its data and its objective, as `tune` uses them."""

    @property
    def data(self) -> list[dict[str, Any]]:
        """Name, length and fingerprint of each drive."""
        ...

    @property
    def seen(self) -> Sequence[Landmarks]:
        """Landmarks by which each drive is recognized; empty for logs of a user's model."""
        ...

    def parameters(self, point: Array) -> P:
        """The filter at a point, shape (d,), in search coordinates."""
        ...

    def judged(self, point: Array, executor: Executor | None) -> float:
        """The objective at a point without the prior, for other data."""
        ...

    def warnings(self, point: Array) -> list[str]:
        """List faults of the filter at a point that the objective does not see, as sentences."""
        ...

    def rise(self, costs: Array | float, best: float) -> Array:
        """Relative increase of costs: 0.01 is 1%."""
        ...

    def on(self, data: Any) -> "Problem[P]":
        """The same filters and objective on other data."""
        ...


@dataclass(frozen=True, eq=False)
class CarProblem:
    """A filter for cars, on drives: `car_problem` makes it.

    Attributes
    ----------
    config : TuneConfig
    space : SearchSpace
        May be that of other drives, with the IMU interval of Q.
    data : list of dict
        Name, length and fingerprint of each drive.
    replays : Replays
        The drives, prepared for the objective.
    """

    config: TuneConfig
    space: SearchSpace
    data: list[dict[str, Any]]
    replays: Replays

    @cached_property
    def objective(self) -> Objective:
        """The objective on each drive."""
        return objective_named(self.config.objective)

    @cached_property
    def _receiver_std(self) -> Array:
        """Standard deviation of each drive's receiver, shape (m, 2), m."""
        return np.array([one.receiver_std for one in self.sensors])

    @property
    def seen(self) -> Sequence[Landmarks]:
        """Landmarks of each drive; of a remote dataset they are fetched when used, to save memory."""
        dataset = self.replays.dataset
        return self._landmarks if isinstance(dataset, LocalDataset) else LandmarksOf(dataset)

    @cached_property
    def _landmarks(self) -> tuple[Landmarks, ...]:
        return tuple(self.replays.dataset.map(landmarks))

    @property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, shape (m,)."""
        return self.replays.steps

    def parameters(self, point: Array) -> FilterParameters:
        """The filter at a point, shape (d,), in search coordinates."""
        return self.space.decode(point[np.newaxis])[0]

    @cached_property
    def _fix_noise(self) -> list[FixNoise]:
        return self.replays.dataset.map(fix_noise)

    @cached_property
    def sensors(self) -> list[Sensors]:
        """Sensors of each drive."""
        return self.replays.dataset.map(sensors_of)

    def warnings(self, point: Array) -> list[str]:
        """List divergence, unused measurements, a free covariance scale and, without truth, an implausible R."""
        parameters = self.parameters(point)
        lost = self._lost(parameters)
        weighs = parameters.accuracy_scale is not None
        found = [*lost, *(said_of_accuracy(parameters, self.replays.dataset.map(stated)) if weighs else [])]
        found += said_of_scale(self.objective.name, parameters, self.replays)
        known = all(drive.truth for drive in self.sensors)
        if not (
            known and self.objective.needs_truth
        ):  # a look at the fixes' noise takes as long as reading a drive
            found += self._prior_decided(point) or said_of_noise(parameters, self._fix_noise)
            correlations = self.replays.of_each_prepared(partial(correlation_of, parameters=parameters))
            found += said_of_correlation(parameters, correlations)
        return found

    def _lost(self, parameters: FilterParameters) -> list[str]:
        """Where a filter diverges; or else, if the objective hides no fixes, where it drifts too far in outages."""
        replays = self.replays
        said = said_of_lost(replays.of_each_prepared(partial(restarts_of, parameters=parameters)))
        if said or self.objective.needs_outages:
            return said
        some = replays.subset(range(min(len(replays.dataset), NAMED)))
        if not may_drift_far(some.of_each_prepared(partial(drifts_of, parameters=parameters, most=FEW))):
            return []
        return said_of_drifts(some.of_each_prepared(partial(drifts_of, parameters=parameters)))

    def _prior_decided(self, point: Array) -> list[str]:
        """Warn where the prior decided R."""
        if not self.config.prior:
            return []
        filters = [self.parameters(point)]
        costs = self.config.prior * prior_costs(filters, self._receiver_std)[0]
        r = np.sqrt(np.mean(typical_variance(filters, self._receiver_std)[0], axis=1))
        known = zip(self.sensors, self._receiver_std, self._fix_noise, r, costs, strict=True)
        found = (
            said_of_prior(one.name, std, noise, near)
            for one, std, noise, near, cost in known
            if cost > PRIOR_DECIDED
        )
        return next(filter(None, found), [])

    def costs(self, points: Array, executor: Executor | None) -> Array:
        """Costs, shape (n,), of points in search coordinates, shape (n, d)."""
        return self.mean(self.each(points, range(len(self.replays.dataset)), executor))

    def each(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        """The costs on some of the drives, shape (n, len(drives))."""
        replays = self.replays.subset(drives)
        parameter_sets = self.space.decode(points)
        costs = replays.measured(partial(costs_of_each, self.config.objective), parameter_sets, executor)
        if self.config.prior:
            costs += self.config.prior * prior_costs(parameter_sets, self._receiver_std[list(drives)])
        return costs

    def mean(self, each: Array) -> Array:
        """The costs, shape (n,), of the costs on each drive that was tried, shape (n, k)."""
        return mean_cost(each, self.config.worst)

    def judged(self, point: Array, executor: Executor | None) -> float:
        """The objective itself at a point, without the prior."""
        plain = replace(self, config=self.config.model_copy(update={"prior": 0.0}))
        return float(plain.costs(point[np.newaxis], executor)[0])

    def rise(self, costs: Array | float, best: float) -> Array:
        """Relative increase of costs: 0.01 is 1%."""
        return self.objective.rise(costs, best)

    def on(self, data: Sequence[Drive] | Dataset) -> "CarProblem":
        """The same filters and objective on other drives."""
        return car_problem(data, self.config, self.space)


@dataclass(frozen=True, eq=False)
class LandmarksOf(Sequence[Landmarks]):
    """The landmarks of a remote dataset, computed when they are needed."""

    dataset: Dataset

    def __len__(self) -> int:
        return len(self.dataset)

    @overload
    def __getitem__(self, k: int) -> Landmarks: ...
    @overload
    def __getitem__(self, k: slice) -> list[Landmarks]: ...
    def __getitem__(self, k: int | slice) -> Landmarks | list[Landmarks]:
        places = range(len(self))[k]
        if isinstance(places, int):
            return self.dataset.subset([places]).map(landmarks)[0]
        return self.dataset.subset(places).map(landmarks)

    def __iter__(self) -> Iterator[Landmarks]:
        return self.dataset.imap(landmarks)


def costs_of_each(objective: str, scores: Scores) -> Array:
    """The costs of an objective, given by its name, on each drive, shape (n_sets, n_drives)."""
    return objective_named(objective).each(scores)


def car_problem(
    drives: Sequence[Drive] | Dataset, config: TuneConfig, space: SearchSpace | None = None
) -> CarProblem:
    """Make the problem of tuning a filter for cars on drives, local or remote.

    ``space``, where given, is that of other drives, with the IMU interval of Q.

    Raises
    ------
    InputError
        If the objective or an option needs data that a drive does not have.
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    objective = objective_named(config.objective)
    if config.prior and not objective.nats:
        raise InputError(
            f"prior = {config.prior:g}: is counted in nats, and {objective.name} is not; leave prior out, or take "
            "innovation-nll or innovation-t"
        )
    dataset = LocalDataset(drives) if isinstance(drives, Sequence) else drives
    have = dataset.map(sensors_of)
    check_drives(have, objective)
    _check_columns(have, config)
    replays = replays_for(objective, dataset, config.outage_seed, as_recorded=config.as_recorded)
    data = dataset.map(described)
    run_kernel(config.model)  # written out here, before threads start that would all wait for it
    return CarProblem(config, space or car_space(config, have), data, replays)


def car_space(config: TuneConfig, drives: Sequence[Drive | Sensors]) -> SearchSpace:
    """The search space of a configuration; Q refers to the drives' usual time between two IMU samples."""
    have = [sensors_of(drive) for drive in drives]
    return search_space(
        config.model,
        config.scale,
        float(np.median([one.interval for one in have])),
        kind=config.kind,
        use=config.use,
        fix_std=float(np.median([one.receiver_std for one in have])),
        has_truth=objective_named(config.objective).needs_truth,
    )


def _check_columns(drives: Sequence[Sensors], config: TuneConfig) -> None:
    silent = [drive.name for drive in drives if not drive.accuracy]
    if "accuracy" in config.use and silent:
        raise InputError(
            f"{silent[0]}: its gps.csv has no std_x and std_y, which --use accuracy needs; leave accuracy out"
        )
    for drive in drives:
        require_named_axes(drive.name, drive.axes, config.model)
    lacking = [drive.name for drive in drives if not drive.velocity]
    if "velocity" in config.use and lacking:
        raise InputError(
            f"{lacking[0]}: its gps.csv has no speed and course, which --use velocity needs; leave velocity out"
        )
