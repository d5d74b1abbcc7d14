"""Scores on drives that the workers of a cluster have read. The workers receive parameter sets and return scores."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property, partial
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.datasets.cluster import CachedDrive, apply_to_each
from sigmaswarm.datasets.dataset import Dataset
from sigmaswarm.datasets.remote import RemoteDataset, results_in_order
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.kernel_array import ParameterTable
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.batch import BatchScorer, PassOptions, Scores

T = TypeVar("T")
DriveCheck = Callable[[BatchScorer], None]
"""Picklable function that raises `InputError` if prepared drives are not usable."""


def make_scorer(dataset: Dataset, passes: PassOptions, check: DriveCheck) -> "AnyBatchScorer":
    """Prepare the drives of a local or remote dataset. ``check`` refuses unusable drives."""
    if isinstance(dataset, RemoteDataset):
        results_in_order(dataset.call(apply_to_each, partial(_checked, passes=passes, check=check)))
        return RemoteBatchScorer(dataset, passes)
    drives = dataset.map(partial(PreparedDrive, as_recorded=passes.as_recorded))
    scorer = BatchScorer.prepare(drives, passes)
    check(scorer)
    return scorer


@dataclass(frozen=True)
class RemoteBatchScorer:
    """A `BatchScorer` of a remote dataset. It ignores executors, since the cluster's workers run the filters."""

    dataset: RemoteDataset
    passes: PassOptions

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        steps = partial(_steps, passes=self.passes)
        return np.array(results_in_order(self.dataset.call(apply_to_each, steps)), np.int64)

    def subset(self, drives: Sequence[int]) -> "RemoteBatchScorer":
        part = RemoteBatchScorer(self.dataset.subset(drives), self.passes)
        part.__dict__["steps"] = self.steps[list(drives)]
        return part

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        return Scores(self.measured(attrgetter("numbers"), parameter_sets))

    def measured(
        self,
        take: Callable[[Scores], Array],
        parameter_sets: Sequence[FilterParameters],
        executor: Executor | None = None,
    ) -> Array:
        """Score the sets and apply ``take`` on the workers. Return an array of shape (..., n_sets, n_drives)."""
        sets = parameter_sets if isinstance(parameter_sets, ParameterTable) else tuple(parameter_sets)
        answers = self.dataset.call(_taken, self.passes, take, sets)
        *more, n_sets, _ = answers[0][1].shape
        # the memory order of `BatchScorer`, since the rounding of sums depends on it
        whole = np.empty((*more, len(self.dataset), n_sets)).swapaxes(-1, -2)
        for indices, part in answers:
            whole[..., indices] = part
        return whole

    def map_prepared(
        self, function: Callable[[PreparedDrive], T], executor: Executor | None = None
    ) -> list[T]:
        return map_prepared(self.dataset, function, as_recorded=self.passes.as_recorded)


AnyBatchScorer = BatchScorer | RemoteBatchScorer


def map_prepared(
    dataset: RemoteDataset, function: Callable[[PreparedDrive], T], *, as_recorded: bool
) -> list[T]:
    return results_in_order(dataset.call(apply_to_each, partial(_with_prepared, function, as_recorded)))


def _with_prepared(function: Callable[[PreparedDrive], Any], as_recorded: bool, drive: CachedDrive) -> Any:
    return function(_prepared(drive, as_recorded))


def _prepared(drive: CachedDrive, as_recorded: bool) -> PreparedDrive:
    return drive.once(("prepared", as_recorded), partial(PreparedDrive, as_recorded=as_recorded))


def _cached_scorer(drive: CachedDrive, passes: PassOptions) -> BatchScorer:
    return drive.once(passes, lambda _: BatchScorer.prepare([_prepared(drive, passes.as_recorded)], passes))


def _checked(drive: CachedDrive, passes: PassOptions, check: DriveCheck) -> None:
    check(_cached_scorer(drive, passes))


def _steps(drive: CachedDrive, passes: PassOptions) -> int:
    return int(_cached_scorer(drive, passes).steps[0])


def _taken(
    drives: Sequence[CachedDrive],
    pool: Executor | None,
    passes: PassOptions,
    take: Callable[[Scores], Array],
    parameter_sets: Sequence[FilterParameters],
) -> Array:
    scorer = BatchScorer.joined([_cached_scorer(drive, passes) for drive in drives])
    return take(scorer.scores(parameter_sets, pool))
