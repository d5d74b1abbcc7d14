"""Scores of many parameter sets on many drives."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import chain
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.datasets.dataset import LocalDataset
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepare_drive
from sigmaswarm.drives.tables import Indices, Mask
from sigmaswarm.filters.kernel_array import KernelArray, KernelSums
from sigmaswarm.filters.parameter_table import group_tables
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, run_array
from sigmaswarm.filters.student import INNOVATION_DOF
from sigmaswarm.scoring.jobs import Job, cores, jobs_for, run_jobs
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, forecast_pass, outage_pass, tracking_pass

T = TypeVar("T")
LOG_2PI = math.log(2 * math.pi)


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of every parameter set on every drive; each array has shape (n_sets, n_drives).

    `Score` describes the names and units. Undefined values are NaN.
    """

    position_rmse: Array
    heading_rmse: Array
    outage_drift: Array
    fix_rmse: Array
    forecast_rmse: Array
    innovation_nll: Array
    innovation_t: Array
    forecast_t: Array
    mean_nis: Array
    mean_nees: Array
    failed: Mask

    def __getitem__(self, at: tuple[int, int]) -> Score:
        return Score(**{name: values[at].item() for name, values in vars(self).items()})

    def stacked(self) -> Array:
        """Return one array, shape (n_scores, n_sets, n_drives), for transport."""
        return np.array([*vars(self).values()], dtype=np.float64)

    @classmethod
    def unstacked(cls, stacked: Array) -> "Scores":
        *numbers, failed = (np.asfortranarray(one) for one in stacked)
        return cls(*numbers, failed=failed.astype(np.bool_))


_NUMBERS = tuple(field.name for field in fields(Scores) if field.name != "failed")


@dataclass(frozen=True)
class PassOptions:  # arguments of BatchScorer
    outages: bool = False
    forecasts: bool = False
    outage_seed: int = 0
    as_recorded: bool = False


class BatchScorer:
    """Scorer that prepares drives once and runs any number of parameter sets over them.

    ``as_recorded`` applies only to drives that are not yet prepared. ``outages`` adds a pass over every drive with
    outages of ``outage_length`` s. ``forecasts`` adds a pass in which fixes are hidden in windows of 3 to 5 s.
    """

    def __init__(
        self,
        drives: Sequence[Drive | PreparedDrive],
        *,
        outages: bool,
        forecasts: bool = False,
        outage_length: float = OUTAGE_LENGTH,
        outage_seed: int = 0,
        as_recorded: bool = False,
    ) -> None:
        self._ready = tuple(prepare_drive(drive, as_recorded=as_recorded) for drive in drives)
        self._passes = {"tracking": tuple(map(tracking_pass, self._ready))}
        if outages:
            length, seed = outage_length, outage_seed
            self._passes["outages"] = tuple(outage_pass(r, length=length, seed=seed) for r in self._ready)
        if forecasts:
            self._passes["forecasts"] = tuple(forecast_pass(r, seed=outage_seed) for r in self._ready)

    @staticmethod
    def joined(parts: Sequence["BatchScorer"]) -> "BatchScorer":
        """Join scorers with the same passes, without preparing drives again."""
        whole = BatchScorer.__new__(BatchScorer)
        whole._ready = tuple(one for part in parts for one in part._ready)
        passes = {name: [part._passes[name] for part in parts] for name in parts[0]._passes}
        whole._passes = {name: tuple(chain(*replays)) for name, replays in passes.items()}
        return whole

    def subset(self, drives: Sequence[int]) -> "BatchScorer":
        if list(drives) == list(range(len(self._ready))):
            return self
        part = BatchScorer.__new__(BatchScorer)
        part._ready = tuple(self._ready[i] for i in drives)
        part._passes = {name: tuple(replays[i] for i in drives) for name, replays in self._passes.items()}
        return part

    @cached_property
    def drives(self) -> tuple[Drive, ...]:
        return tuple(ready.drive for ready in self._ready)

    @cached_property
    def initial(self) -> tuple[InitialState, ...]:
        return tuple(ready.initial for ready in self._ready)

    @property
    def dataset(self) -> LocalDataset:
        return LocalDataset(self.drives)

    @property
    def truth_moments(self) -> list[int]:
        return [replay.targets.n_positions for replay in self._passes["tracking"]]

    @property
    def hidden_fixes(self) -> list[int]:
        """Number of hidden fixes of each drive."""
        return [replay.n_hidden for replay in self._passes.get("forecasts", ())]

    @property
    def steps(self) -> NDArray[np.int64]:
        """Number of filter steps of one parameter set on each drive, summed over all passes, shape (n_drives,)."""
        return np.sum(np.array([*self._steps.values()], dtype=np.int64), axis=0)

    @cached_property
    def _steps(self) -> dict[str, list[int]]:
        return {name: [len(r.timeline.dt) for r in replays] for name, replays in self._passes.items()}

    @cached_property
    def _divisors(self) -> dict[str, Array]:
        return {name: _divisors_of(replays) for name, replays in self._passes.items()}

    @cached_property
    def _jobs(self) -> dict[tuple[int, str, int], list[Job]]:
        """Cache the results of `jobs_for`, since all generations of a search have the same jobs."""
        return {}

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Return the scores of the parameter sets; the scores do not depend on the executor."""
        if not parameter_sets or not self.drives:
            empty = np.full((len(parameter_sets), len(self.drives)), np.nan)
            return Scores(*[empty] * len(_NUMBERS), failed=np.zeros(empty.shape, dtype=np.bool_))
        return _scores_by(self._divisors, self._run(parameter_sets, executor))

    def measured(
        self,
        take: Callable[[Scores], Array],
        parameter_sets: Sequence[FilterParameters],
        executor: Executor | None = None,
    ) -> Array:
        """Score the parameter sets; return the result of ``take``, shape (n_sets, n_drives)."""
        return np.asfortranarray(take(self.scores(parameter_sets, executor)))

    def map_prepared(self, function: Callable[[PreparedDrive], T]) -> list[T]:
        return [function(one) for one in self._ready]

    def _run(
        self, parameter_sets: Sequence[FilterParameters], executor: Executor | None
    ) -> dict[str, KernelSums]:
        workers = cores() if executor else 1
        work: list[tuple[Job, Indices, KernelArray]] = []
        for places, table in group_tables(parameter_sets):
            array = KernelArray(table)
            array.compute_starts(self.initial)
            key = len(table), array.kernel, workers
            if key not in self._jobs:
                self._jobs[key] = jobs_for(self._steps, *key)
            work += [
                (job, places[job.sets.start : job.sets.stop], array.part(job.sets)) for job in self._jobs[key]
            ]
        # The longest jobs start first, so that all workers end at about the same time.
        work.sort(key=lambda item: item[0].work, reverse=True)
        tasks = [
            (self._passes[job.name][job.drives.start : job.drives.stop], array) for job, _, array in work
        ]
        sums = {name: KernelSums.empty(len(self.drives), len(parameter_sets)) for name in self._passes}
        for (job, places, _), part in zip(work, run_jobs(run_array, tasks, executor), strict=True):
            sums[job.name].put(slice(job.drives.start, job.drives.stop), places, part)
        return sums


def scores_from_sums(passes: Mapping[str, Sequence[FilterPass]], sums: Mapping[str, KernelSums]) -> Scores:
    return _scores_by({name: _divisors_of(passes[name]) for name in sums}, sums)


def _divisors_of(replays: Sequence[FilterPass]) -> Array:
    """Return the divisors of the sums of each replay, shape (5, n_drives, 1); NaN replaces 0.

    The order of the divisors is: number of positions, total weight of positions, total weight of headings, number of
    fixes, number of hidden fixes.
    """
    counts = np.array(
        [
            (t.n_positions, t.position_weight, t.heading_weight, len(replay.timeline.fixes), replay.n_hidden)
            for replay in replays
            for t in (replay.targets,)
        ],
        dtype=np.float64,
    )
    return np.where(counts > 0, counts, np.nan).T[..., np.newaxis]


def _scores_by(divisors: Mapping[str, Array], sums: Mapping[str, KernelSums]) -> Scores:
    shape = next(iter(sums.values())).failed.T.shape
    columns = dict.fromkeys(_NUMBERS, np.full(shape, np.nan))
    failed = np.zeros(shape, dtype=np.bool_)
    for name, added in sums.items():
        for score, values in _pass_scores(name, divisors[name], added).items():
            columns[score] = values.T
        failed |= added.failed.T
    return Scores(**columns, failed=failed)


def _pass_scores(name: str, divisors: Array, sums: KernelSums) -> dict[str, Array]:
    """Return the scores of a pass by name; each array has shape (n_drives, n_sets)."""
    moments, positions, headings, fixes, hidden = divisors
    if name == "outages":
        return {"outage_drift": np.sqrt(sums["SQ_POSITION"] / positions)}
    if name == "forecasts":
        likelihood = sums["FORECAST_T"] / hidden + LOG_2PI
        return {"forecast_rmse": np.sqrt(sums["SQ_FORECAST"] / hidden), "forecast_t": likelihood}
    tails = sums["LOG_DET"] + (INNOVATION_DOF + 2) * sums["LOG_TAIL"]
    return {
        "position_rmse": np.sqrt(sums["SQ_POSITION"] / positions),
        "heading_rmse": np.sqrt(sums["SQ_HEADING"] / headings),
        "fix_rmse": np.sqrt(sums["SQ_FIX"] / fixes),
        "innovation_nll": (sums["NIS"] + sums["LOG_DET"]) / fixes / 2 + LOG_2PI,
        "innovation_t": tails / fixes / 2 + LOG_2PI,
        "mean_nis": sums["NIS"] / fixes,
        "mean_nees": sums["NEES"] / moments,
    }
