"""What a tuning minimizes: a filter's cost on data, over a box."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.fingerprint import described
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import require_axes
from sigmaswarm.scoring.batch import Replayer
from sigmaswarm.tuning.batch import check_drives, replayer_for
from sigmaswarm.tuning.box import Box
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.objectives import Objective, mean_cost, objective_named
from sigmaswarm.tuning.space import SearchSpace, search_space

P = TypeVar("P", covariant=True)


class Landscape(Protocol):
    """What a search needs: a box, and the costs of points in it."""

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
    """What `tune` needs to know of a filter, its data and its objective."""

    @property
    def data(self) -> list[dict[str, Any]]:
        """Name, length and fingerprint of each drive."""
        ...

    def parameters(self, point: Array) -> P:
        """The filter at a point, shape (d,), in search coordinates."""
        ...

    def rise(self, costs: Array | float, best: float) -> Array:
        """How much worse costs are than another: 0.01 is 1%."""
        ...

    def on(self, data: Sequence[Any]) -> "Problem[P]":
        """The same filters and objective on other data."""
        ...


@dataclass(frozen=True, eq=False)
class CarProblem:
    """A filter for cars, on drives: `car_problem` makes it.

    Attributes
    ----------
    config : TuneConfig
    space : SearchSpace
        May be that of other drives, whose IMU Q refers to.
    data : list of dict
        Name, length and fingerprint of each drive.
    replayer : Replayer
        The drives, made ready for the objective.
    """

    config: TuneConfig
    space: SearchSpace
    data: list[dict[str, Any]]
    replayer: Replayer

    @cached_property
    def objective(self) -> Objective:
        """What is minimized on each drive."""
        return objective_named(self.config.objective)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, shape (m,)."""
        return self.replayer.steps

    def parameters(self, point: Array) -> FilterParameters:
        """The filter at a point, shape (d,), in search coordinates."""
        return self.space.decode(point[np.newaxis])[0]

    def costs(self, points: Array, executor: Executor | None) -> Array:
        """Costs, shape (n,), of points in search coordinates, shape (n, d)."""
        return self.mean(self.each(points, range(len(self.replayer.drives)), executor))

    def each(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        """The costs on some of the drives, shape (n, len(drives))."""
        replayer = self.replayer.subset(drives)
        return self.objective.each(replayer.scores(self.space.decode(points), executor))

    def mean(self, each: Array) -> Array:
        """The costs, shape (n,), of the costs on each drive that was tried, shape (n, k)."""
        return mean_cost(each, self.config.worst)

    def rise(self, costs: Array | float, best: float) -> Array:
        """How much worse costs are than another: 0.01 is 1%."""
        return self.objective.rise(costs, best)

    def on(self, data: Sequence[Drive]) -> "CarProblem":
        """The same filters and objective on other drives."""
        return car_problem(data, self.config, self.space)


def car_problem(drives: Sequence[Drive], config: TuneConfig, space: SearchSpace | None = None) -> CarProblem:
    """A filter for cars on drives; in the ``space`` of other drives, where given, whose IMU Q refers to.

    Raises
    ------
    InputError
        If the objective or an option asks for something that a drive does not have.
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    objective = objective_named(config.objective)
    check_drives(drives, objective)
    _check_columns(drives, config)
    ready = [PreparedDrive(drive, as_recorded=config.as_recorded) for drive in drives]
    replayer = replayer_for(objective, ready, config.outage_seed)
    data = [described(drive) for drive in drives]
    return CarProblem(config, space or car_space(config, usual_interval(drives)), data, replayer)


def car_space(config: TuneConfig, interval: float) -> SearchSpace:
    """The box of the filter that is asked for; ``interval``: s between two IMU samples, which Q refers to."""
    return search_space(config.model, config.scale, interval, kind=config.kind, use=config.use)


def usual_interval(drives: Sequence[Drive]) -> float:
    """The drives' usual time between two IMU samples, s."""
    return float(np.median([drive.nominal_interval for drive in drives]))


def _check_columns(drives: Sequence[Drive], config: TuneConfig) -> None:
    silent = [d.name for d in drives if d.gps.std_x is None or d.gps.std_y is None]
    if "accuracy" in config.use and silent:
        raise InputError(
            f"{silent[0]}: its gps.csv has no std_x and std_y, which --use accuracy needs; leave accuracy out"
        )
    for drive in drives:
        require_axes(drive, config.model)
    lacking = [d.name for d in drives if d.gps.speed is None or d.gps.course is None]
    if "velocity" in config.use and lacking:
        raise InputError(
            f"{lacking[0]}: its gps.csv has no speed and course, which --use velocity needs; leave velocity out"
        )
