"""Scores of many parameter sets on many drives, from the compiled replays."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.datasets.dataset import LocalDataset
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.filters.kernel_array import KernelArray, Sums
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.replay import Replay, run_array
from sigmaswarm.filters.student import INNOVATION_DOF
from sigmaswarm.filters.table import tables_of
from sigmaswarm.scoring.jobs import Job, cores, jobs_for, run_jobs
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, forecast_replay, outage_replay, tracking_replay

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of every parameter set on every drive; each array has shape (n_sets, n_drives).

    The names and units are those of `Score`; NaN where a score is not defined or the filter failed.
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
    failed: NDArray[np.bool_]

    def __getitem__(self, at: tuple[int, int]) -> Score:
        """The score of one set on one drive."""
        numbers = {name: float(getattr(self, name)[at]) for name in _NUMBERS}
        return Score(**numbers, failed=bool(self.failed[at]))

    def stacked(self) -> Array:
        """All scores as one array, shape (n_scores, n_sets, n_drives), for transport."""
        return np.array([getattr(self, field.name) for field in fields(self)], dtype=np.float64)

    @classmethod
    def unstacked(cls, stacked: Array) -> "Scores":
        """Scores from the array of `stacked`."""
        *numbers, failed = (np.asfortranarray(one) for one in stacked)
        return cls(*numbers, failed=failed.astype(np.bool_))


@dataclass(frozen=True)
class Passes:
    """Passes over a drive, and its preprocessing: see `Replayer` and `PreparedDrive`."""

    outages: bool = False
    forecasts: bool = False
    outage_seed: int = 0
    as_recorded: bool = False


class Replayer:
    """Drives prepared once, to be replayed by any number of parameter sets.

    Parameters
    ----------
    drives : sequence of Drive or PreparedDrive
    outages : bool
        Run the outages too (a pass of its own over each drive).
    forecasts : bool
        Run with fixes hidden all over the drive (another pass).
    outage_length : float
        s.
    outage_seed : int
        Places the windows.

    Raises
    ------
    AlignmentError
        If a drive never moves far enough to start a filter.
    """

    def __init__(
        self,
        drives: Sequence[Drive | PreparedDrive],
        *,
        outages: bool,
        forecasts: bool = False,
        outage_length: float = OUTAGE_LENGTH,
        outage_seed: int = 0,
    ) -> None:
        ready = [prepared(drive) for drive in drives]
        self._ready = tuple(ready)
        self.drives = tuple(one.drive for one in ready)
        self.initial = tuple(one.initial for one in ready)
        self._passes = {"tracking": tuple(map(tracking_replay, ready))}
        if outages:
            length, seed = outage_length, outage_seed
            self._passes["outages"] = tuple(outage_replay(one, length=length, seed=seed) for one in ready)
        if forecasts:
            self._passes["forecasts"] = tuple(forecast_replay(one, seed=outage_seed) for one in ready)

    @classmethod
    def together(cls, parts: Sequence["Replayer"]) -> "Replayer":
        """Join replayers with the same passes, without preparing anything again."""
        whole = copy(parts[0])
        whole._forget()
        whole._ready = tuple(one for part in parts for one in part._ready)
        whole.drives = tuple(drive for part in parts for drive in part.drives)
        whole.initial = tuple(initial for part in parts for initial in part.initial)
        names = parts[0]._passes
        whole._passes = {name: tuple(r for part in parts for r in part._passes[name]) for name in names}
        return whole

    @property
    def dataset(self) -> LocalDataset:
        """The drives."""
        return LocalDataset(self.drives)

    def subset(self, drives: Sequence[int]) -> "Replayer":
        """A replayer of some of the drives, by index, without preparing anything again."""
        if list(drives) == list(range(len(self.drives))):
            return self
        part = copy(self)
        part._forget()
        part._ready = tuple(self._ready[i] for i in drives)
        part.drives = tuple(self.drives[i] for i in drives)
        part.initial = tuple(self.initial[i] for i in drives)
        part._passes = {name: tuple(replays[i] for i in drives) for name, replays in self._passes.items()}
        return part

    @property
    def truth_moments(self) -> list[int]:
        """Number of moments of truth at which each drive is scored."""
        return [replay.targets.n_positions for replay in self._passes["tracking"]]

    @property
    def hidden_fixes(self) -> list[int]:
        """Number of fixes that are hidden on each drive; empty without forecasts."""
        return [replay.n_hidden for replay in self._passes.get("forecasts", ())]

    @property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, over all passes, shape (n_drives,)."""
        return np.sum(np.array([*self._steps.values()], dtype=np.int64), axis=0)

    @cached_property
    def _steps(self) -> dict[str, list[int]]:
        """Of each replay."""
        return {
            name: [len(replay.timeline.dt) for replay in replays] for name, replays in self._passes.items()
        }

    @cached_property
    def _counts(self) -> dict[str, "Counts"]:
        return {name: Counts.of(replays) for name, replays in self._passes.items()}

    @cached_property
    def _jobs(self) -> dict[tuple[int, ModelName, int], list[Job]]:
        """Results of `jobs_for`."""
        return {}

    def _forget(self) -> None:
        """Clear the caches, which are of other drives."""
        for found in ("_steps", "_counts", "_jobs"):
            self.__dict__.pop(found, None)

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Score the sets; the result has the same bits whatever the executor and its number of workers."""
        if not parameter_sets or not self.drives:
            empty = np.full((len(parameter_sets), len(self.drives)), np.nan)
            return Scores(*[empty] * len(_NUMBERS), failed=np.zeros(empty.shape, dtype=np.bool_))
        return _scores_by(self._counts, self._run(parameter_sets, executor))

    def measured(
        self,
        take: Callable[[Scores], Array],
        parameter_sets: Sequence[FilterParameters],
        executor: Executor | None = None,
    ) -> Array:
        """Apply a function to the scores, shape (n_sets, n_drives)."""
        return np.asfortranarray(take(self.scores(parameter_sets, executor)))

    def of_each_prepared(self, function: Callable[[PreparedDrive], T]) -> list[T]:
        """Apply a function to each prepared drive."""
        return [function(one) for one in self._ready]

    def _run(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None) -> dict[str, Sums]:
        """Run every pass by every set, in jobs that keep all workers busy."""
        workers = cores() if executor else 1
        work: list[tuple[Job, NDArray[np.intp], KernelArray]] = []
        for places, table in tables_of(parameter_sets):
            array = KernelArray(table)
            array.compute_starts(self.initial)
            work += [
                (job, places[job.sets.start : job.sets.stop], array.part(job.sets))
                for job in self._jobs_for(len(table), array.model, workers)
            ]
        # The longest first, so that no worker is left with one at the end.
        work.sort(key=lambda item: item[0].work, reverse=True)
        tasks = [
            (self._passes[job.name][job.replays.start : job.replays.stop], array) for job, _, array in work
        ]
        sums = {name: Sums.empty(len(self.drives), len(parameter_sets)) for name in self._passes}
        for (job, places, _), part in zip(work, run_jobs(run_array, tasks, executor), strict=True):
            sums[job.name].put(slice(job.replays.start, job.replays.stop), places, part)
        return sums

    def _jobs_for(self, n_sets: int, model: ModelName, workers: int) -> list[Job]:
        """As `jobs_for`; kept, since all generations of a search have the same jobs."""
        key = n_sets, model, workers
        if key not in self._jobs:
            self._jobs[key] = jobs_for(self._steps, n_sets, model, workers)
        return self._jobs[key]


@dataclass(frozen=True, eq=False)
class Counts:
    """Divisors of the sums of each replay, each of shape (n_drives, 1); NaN in place of 0.

    Attributes
    ----------
    moments : number of positions that are compared
    positions, headings : total weights of their errors
    fixes, hidden : numbers of fixes
    """

    moments: Array
    positions: Array
    headings: Array
    fixes: Array
    hidden: Array

    @classmethod
    def of(cls, replays: Sequence[Replay]) -> "Counts":
        """Counts of the replays of a pass."""
        each = [
            (t.n_positions, t.position_weight, t.heading_weight, len(replay.timeline.fixes), replay.n_hidden)
            for replay in replays
            for t in (replay.targets,)
        ]
        counts = np.array(each, dtype=np.float64)
        return cls(*np.where(counts > 0, counts, np.nan).T[..., np.newaxis])


def scores_of(passes: Mapping[str, Sequence[Replay]], sums: Mapping[str, Sums]) -> Scores:
    """Scores from the sums of each pass (``tracking``, ``outages``, ``forecasts``); NaN for a missing pass."""
    return _scores_by({name: Counts.of(passes[name]) for name in sums}, sums)


def _scores_by(counts: Mapping[str, Counts], sums: Mapping[str, Sums]) -> Scores:
    shape = next(iter(sums.values())).failed.T.shape
    columns = dict.fromkeys(_NUMBERS, np.full(shape, np.nan))
    failed = np.zeros(shape, dtype=np.bool_)
    for name, added in sums.items():
        for score, values in _SCORES[name](counts[name], added).items():
            columns[score] = values.T
        failed |= added.failed.T
    return Scores(**columns, failed=failed)


_NUMBERS = tuple(field.name for field in fields(Scores) if field.name != "failed")


def _tracking_scores(counts: Counts, sums: Sums) -> dict[str, Array]:
    return {
        "position_rmse": np.sqrt(sums.squared_position / counts.positions),
        "heading_rmse": np.sqrt(sums.squared_heading / counts.headings),
        "fix_rmse": np.sqrt(sums.squared_fix / counts.fixes),
        "innovation_nll": (sums.nis + sums.log_determinant) / counts.fixes / 2 + math.log(2 * math.pi),
        "innovation_t": (sums.log_determinant + (INNOVATION_DOF + 2) * sums.log_tail) / counts.fixes / 2
        + math.log(2 * math.pi),
        "mean_nis": sums.nis / counts.fixes,
        "mean_nees": sums.nees / counts.moments,
    }


def _outage_scores(counts: Counts, sums: Sums) -> dict[str, Array]:
    return {"outage_drift": np.sqrt(sums.squared_position / counts.positions)}


def _forecast_scores(counts: Counts, sums: Sums) -> dict[str, Array]:
    return {
        "forecast_rmse": np.sqrt(sums.squared_forecast / counts.hidden),
        "forecast_t": sums.forecast_t / counts.hidden + math.log(2 * math.pi),
    }


_SCORES = {"tracking": _tracking_scores, "outages": _outage_scores, "forecasts": _forecast_scores}
"""Scores from the sums of each pass, each of shape (n_drives, n_sets)."""
