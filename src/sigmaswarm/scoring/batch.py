"""Scores of many parameter sets on many drives, computed in parallel jobs."""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, wait
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.datasets.dataset import LocalDataset
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepare_drive
from sigmaswarm.drives.tables import Indices, Mask
from sigmaswarm.filters.compiled.layout import WIDEST, most_lanes
from sigmaswarm.filters.constants import INNOVATION_DOF
from sigmaswarm.filters.kernel_array import KernelArray, KernelSums, group_tables
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, run_array
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, forecast_pass, outage_pass, tracking_pass

Result = TypeVar("Result")

MAX_SETS = 64  # largest number of parameter sets in a job if there is only one worker, to limit the memory
MIN_JOB_STEPS = 20_000  # filter steps; drives with fewer steps share a job unless workers would be idle


@dataclass(frozen=True)
class Job:
    """A range of drives of the pass ``name``, and a range of parameter sets."""

    name: str
    drives: range
    sets: range
    steps: int

    @property
    def work(self) -> int:
        return self.steps * len(self.sets)


def jobs_for(steps: Mapping[str, Sequence[int]], n_sets: int, kernel: str, workers: int) -> list[Job]:
    """Divide a batch into jobs. ``steps`` contains the number of steps on each drive, by pass."""
    total = sum(map(sum, steps.values()))
    parts = list(_parts(steps, total if workers == 1 else min(MIN_JOB_STEPS, total / workers)))
    most = MAX_SETS if workers == 1 else most_lanes(kernel)
    # The number of parts may not be a multiple of the number of workers. Therefore, the parameter sets of the shortest
    # parts, which remain for the last round, are divided among the workers.
    left_over = sorted(parts, key=lambda part: part.steps)[: len(parts) % workers]
    narrow = min(most, -(-n_sets // workers // WIDEST) * WIDEST)
    widths = [(part, narrow if part in left_over else most) for part in parts]
    return [
        replace(part, sets=range(first, min(first + width, n_sets)))
        for part, width in widths
        for first in range(0, n_sets, width)
    ]


def _parts(steps: Mapping[str, Sequence[int]], least: float) -> Iterator[Job]:
    """Group consecutive drives of each pass into parts of at least ``least`` steps. The last part may be shorter."""
    for name, lengths in steps.items():
        first, total = 0, 0
        for last, length in enumerate(lengths):
            total += length
            if total >= least or last == len(lengths) - 1:
                yield Job(name, range(first, last + 1), range(0), total)
                first, total = last + 1, 0


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_jobs(
    function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]], executor: Executor | None
) -> list[Result]:
    """Call a function with each tuple of arguments, in ``executor`` or in this thread.

    After an exception or an interrupt, no further job starts, and the function waits for running jobs.
    """
    if executor is None:
        return [function(*job) for job in jobs]
    futures = list[Future[Result]]()
    try:
        for job in jobs:
            futures.append(executor.submit(function, *job))
        # Jobs start in order. If a job has not started when its result is needed, the executor is busy with other
        # work, perhaps in this thread, so the job runs in this thread.
        pairs = zip(jobs, futures, strict=True)
        return [function(*job) if future.cancel() else future.result() for job, future in pairs]
    finally:
        begun = [future for future in futures if not future.cancel()]
        try:
            wait(begun)
        except BaseException:  # a second interrupt must not leave jobs running
            wait(begun)
            raise


T = TypeVar("T")
LOG_2PI = math.log(2 * math.pi)


NAMES = tuple(each.name for each in fields(Score))  # the last one is "failed"


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of every parameter set on every drive.

    ``numbers`` has the shape (n_scores, n_sets, n_drives), in the order of the fields of `Score`. Undefined scores are
    NaN. Each score is also an attribute, (n_sets, n_drives): ``scores.position_rmse``.
    """

    numbers: Array

    def __getattr__(self, name: str) -> Array:
        if name not in NAMES:
            raise AttributeError(name)
        return self.numbers[NAMES.index(name)]

    def __getitem__(self, at: tuple[int, int]) -> Score:
        *numbers, failed = self.numbers[(slice(None), *at)].tolist()
        return Score(*numbers, failed=bool(failed))

    @property
    def failed(self) -> Mask:
        return self.numbers[-1] != 0.0


@dataclass(frozen=True)
class PassOptions:
    """The passes of a scorer in addition to the pass with all fixes.

    - ``outages``: a pass with outages of ``outage_length`` s.
    - ``forecasts``: a pass in which fixes are hidden in windows of 3 to 5 s.

    With ``branched``, these passes are branches of the pass with all fixes, which takes less time: see `FilterPass`.
    For ``as_recorded`` see `PreparedDrive`. It has no effect on drives that are already prepared.
    """

    outages: bool = False
    forecasts: bool = False
    outage_length: float = OUTAGE_LENGTH
    outage_seed: int = 0
    branched: bool = False
    as_recorded: bool = False


ALL_FIXES = PassOptions()


@dataclass(frozen=True, eq=False)
class BatchScorer:
    """Prepared drives and passes over them, for any number of parameter sets."""

    ready: tuple[PreparedDrive, ...]
    passes: dict[str, tuple[FilterPass, ...]]

    @classmethod
    def prepare(
        cls, drives: Sequence[Drive | PreparedDrive], options: PassOptions = ALL_FIXES
    ) -> "BatchScorer":
        ready = tuple(prepare_drive(drive, as_recorded=options.as_recorded) for drive in drives)
        passes, seed = {"tracking": tuple(map(tracking_pass, ready))}, options.outage_seed
        if options.outages:
            length = options.outage_length
            passes["outages"] = tuple(outage_pass(one, length=length, seed=seed) for one in ready)
        if options.forecasts:
            passes["forecasts"] = tuple(forecast_pass(one, seed=seed) for one in ready)
        if options.branched and len(passes) > 1:
            tracking, *others = passes.values()
            passes["tracking"] = tuple(
                replace(one, branches=tuple(branches))
                for one, *branches in zip(tracking, *others, strict=True)
            )
        return cls(ready, passes)

    @classmethod
    def joined(cls, parts: Sequence["BatchScorer"]) -> "BatchScorer":
        """Join scorers with the same passes, without preparing drives again."""
        passes = {name: tuple(chain(*(part.passes[name] for part in parts))) for name in parts[0].passes}
        return cls(tuple(chain(*(part.ready for part in parts))), passes)

    def subset(self, drives: Sequence[int]) -> "BatchScorer":
        if list(drives) == list(range(len(self.ready))):
            return self
        passes = {name: tuple(replays[i] for i in drives) for name, replays in self.passes.items()}
        return BatchScorer(tuple(self.ready[i] for i in drives), passes)

    @cached_property
    def drives(self) -> tuple[Drive, ...]:
        return tuple(ready.drive for ready in self.ready)

    @cached_property
    def initial(self) -> tuple[InitialState, ...]:
        return tuple(ready.initial for ready in self.ready)

    @property
    def dataset(self) -> LocalDataset:
        return LocalDataset(self.drives)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Number of filter steps of one parameter set on each drive, summed over all passes, shape (n_drives,)."""
        return np.sum(np.array([*self._steps.values()], dtype=np.int64), axis=0)

    @cached_property
    def _separate(self) -> dict[str, tuple[FilterPass, ...]]:
        """Passes that are not branches, by name."""
        branched = any(one.branches for one in self.passes["tracking"])
        return {"tracking": self.passes["tracking"]} if branched else self.passes

    @cached_property
    def _steps(self) -> dict[str, list[int]]:
        return {name: [one.n_steps for one in passes] for name, passes in self._separate.items()}

    @cached_property
    def _divisors(self) -> dict[str, Array]:
        return {name: _divisors_of(replays) for name, replays in self.passes.items()}

    @cached_property
    def _jobs(self) -> dict[tuple[int, str, int], list[Job]]:
        """Cache the results of `jobs_for`, since all generations of a search have the same jobs."""
        return {}

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Return the scores of the parameter sets. The scores do not depend on the executor."""
        if not parameter_sets or not self.drives:
            return Scores(_no_numbers(len(self.drives), len(parameter_sets)))
        sums = self._run(parameter_sets, executor)
        missing = self.passes.keys() - sums.keys()
        sums |= dict.fromkeys(missing, sums["tracking"].of_branches) if missing else {}
        return _scores_by(self._divisors, sums)

    def measured(
        self,
        take: Callable[[Scores], Array],
        parameter_sets: Sequence[FilterParameters],
        executor: Executor | None = None,
    ) -> Array:
        """Score the parameter sets. Return the result of ``take``, shape (n_sets, n_drives)."""
        return np.asfortranarray(take(self.scores(parameter_sets, executor)))

    def map_prepared(
        self, function: Callable[[PreparedDrive], T], executor: Executor | None = None
    ) -> list[T]:
        return run_jobs(function, [(one,) for one in self.ready], executor)

    def _run(
        self, parameter_sets: Sequence[FilterParameters], executor: Executor | None
    ) -> dict[str, KernelSums]:
        workers = cores() if executor else 1
        work: list[tuple[Job, Indices, KernelArray]] = []
        for places, table in group_tables(parameter_sets):
            key = len(table), table.like.kernel, workers
            if key not in self._jobs:
                self._jobs[key] = jobs_for(self._steps, *key)
            sets = {job.sets: slice(job.sets.start, job.sets.stop) for job in self._jobs[key]}
            arrays = {of: KernelArray(table[at]) for of, at in sets.items()}
            for array in arrays.values():
                array.compute_starts(self.initial)
            work += [(job, places[sets[job.sets]], arrays[job.sets]) for job in self._jobs[key]]
        # The longest jobs start first, so that all workers end at about the same time.
        work.sort(key=lambda item: item[0].work, reverse=True)
        tasks = [(self.passes[job.name][job.drives.start : job.drives.stop], array) for job, _, array in work]
        sums = {name: KernelSums.empty(len(self.drives), len(parameter_sets)) for name in self._separate}
        for (job, places, _), part in zip(work, run_jobs(run_array, tasks, executor), strict=True):
            sums[job.name].put(slice(job.drives.start, job.drives.stop), places, part)
        return sums


def scores_from_sums(passes: Mapping[str, Sequence[FilterPass]], sums: Mapping[str, KernelSums]) -> Scores:
    return _scores_by({name: _divisors_of(passes[name]) for name in sums}, sums)


def _divisors_of(replays: Sequence[FilterPass]) -> Array:
    """Return the divisors of the sums of a pass over each drive, shape (5, n_drives, 1). NaN replaces 0.

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
    numbers = _no_numbers(*next(iter(sums.values())).failed.shape)
    for name, added in sums.items():
        for score, values in _pass_scores(name, divisors[name], added).items():
            numbers[NAMES.index(score)] = values.T
        numbers[-1] += added.failed.T
    return Scores(numbers)


def _no_numbers(n_drives: int, n_sets: int) -> Array:
    """Return an array of undefined scores.

    The sets of a drive are adjacent in memory, which affects the rounding of sums.
    """
    numbers = np.full((len(NAMES), n_drives, n_sets), np.nan).swapaxes(1, 2)
    numbers[-1] = 0.0
    return numbers


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
