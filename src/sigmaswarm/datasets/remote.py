"""A dataset on the workers of a Dask cluster: each worker reads its drives once and caches them.

A call sends each worker one task: the function, its arguments and the keys of the drives. Results do not depend on the
distribution of the drives. Each task runs on the worker that has the drives of the task. If a worker is lost, other
workers read its drives, and only its tasks run again. New workers receive some of the drives.
"""

import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

from sigmaswarm.datasets.cluster import (
    CachedDrive,
    Cluster,
    ClusterError,
    Failure,
    Source,
    apply_to_each,
    in_gb,
    run_task,
)
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import Location, read_with_warnings
from sigmaswarm.drives.urls import is_url
from sigmaswarm.errors import DriveError, InputError, SigmaswarmWarning

T = TypeVar("T")
ReadProgress = Callable[[int, int], None]  # called with the number of read drives and that of all drives

POLL_INTERVAL = 2.0  # s, time between requests to the scheduler for its workers
MAX_RETRIES = 3  # rounds in which all workers are lost; after more, the drives are the likely cause
MAX_NAMED_DRIVES = 10  # largest number of drives named in a message


class Assignment:
    """Assignment of drives to the workers of a cluster, which all subsets of a dataset share."""

    def __init__(self, cluster: Cluster, sources: Sequence[Source]) -> None:
        self.cluster, self.sources = cluster, sources
        self.sizes = [1.0] * len(sources)
        self.workers: dict[str, int] = {}
        self.owners = [""] * len(sources)
        self._keys = [f"{uuid.uuid4().hex}-{i}" for i in range(len(sources))]
        self._refused: set[str] = set()
        self._polled = -float("inf")
        self._lock = threading.RLock()

    def shares(self, drives: Iterable[int]) -> dict[str, list[int]]:
        with self._lock:
            if time.monotonic() - self._polled > POLL_INTERVAL:
                self.poll()
            indices: dict[str, list[int]] = {}
            for i in drives:
                indices.setdefault(self.owners[i], []).append(i)
            return indices

    def poll(self) -> None:
        """Wait for a worker if there is none, and assign the drives again if the workers have changed."""
        with self._lock:
            waited = False
            while not (present := self._usable_workers()):
                if not waited:
                    what = "no worker is left" if self.workers else "there is no worker yet"
                    message = f"{what} at {self.cluster.address}: waiting for a worker"
                    warnings.warn(message, SigmaswarmWarning, stacklevel=2)
                waited = True
                time.sleep(POLL_INTERVAL / 4)
            self._polled = time.monotonic()
            if present != self.workers:
                self.workers = present
                self.assign()

    def assign(self) -> None:
        with self._lock:
            self.owners = assign_drives(self.sizes, self.workers, self.owners)

    def _usable_workers(self) -> dict[str, int]:
        """Return the workers whose software versions are those of the client.

        Raise an error for a worker with other versions if no worker has been used yet. Later, warn and leave this
        worker out.
        """
        present = self.cluster.workers()
        new = [address for address in present if address not in {*self.workers, *self._refused}]
        for address, error in self.cluster.version_errors(new).items():
            if not self.workers:
                raise error
            self._refused.add(address)
            warnings.warn(f"{error}; this worker gets no tasks", SigmaswarmWarning, stacklevel=2)
        return {address: threads for address, threads in present.items() if address not in self._refused}

    def submit(self, worker: str, call: bytes, drives: Sequence[int], *, with_sources: bool = False) -> Any:
        """Submit a task to a worker. Sources are sent only if the worker has requested them."""
        from dask import config
        from distributed.protocol.pickle import dumps

        sources = dumps({self._keys[i]: self.sources[i] if with_sources else None for i in drives})
        where: dict[str, Any] = {"workers": [worker], "allow_other_workers": False, "pure": False}
        # sources may contain drives
        with config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
            return self.cluster.client.submit(run_task, call, sources, worker, **where)

    def result(self, worker: str, call: bytes, drives: Sequence[int], task: Any) -> Any:
        """Wait for the result of a task and return it. Return None if the worker is lost."""
        while True:
            try:
                answer = task.result(timeout=POLL_INTERVAL)
            except (OSError, CancelledError):  # includes a timeout, and broken connections
                self.poll()
                if worker not in self.workers or task.cancelled():
                    task.cancel()
                    return None
                continue
            except Exception as error:
                what = f"worker {worker}: the task failed ({type(error).__name__}: {error})"
                raise ClusterError(what) from None
            if isinstance(answer, Failure):
                raise answer.error
            if answer is not None:
                return answer
            task = self.submit(worker, call, drives, with_sources=True)


def assign_drives(sizes: Sequence[float], threads: Mapping[str, int], before: Sequence[str]) -> list[str]:
    """Assign drives of given sizes to workers in proportion to their threads.

    A drive stays with its previous worker, ``before``, unless this worker would then exceed its share by more than 5%.
    """
    share = sum(sizes) / sum(threads.values())
    load, assigned = dict.fromkeys(threads, 0.0), [""] * len(sizes)
    largest_first = sorted(range(len(sizes)), key=lambda i: (-sizes[i], i))
    for i in largest_first:
        owner = before[i]
        if owner in threads and load[owner] + sizes[i] <= 1.05 * share * threads[owner]:
            assigned[i] = owner
            load[owner] += sizes[i]
    for i in largest_first:
        if not assigned[i]:
            assigned[i] = min(threads, key=lambda w: ((load[w] + sizes[i]) / threads[w], w != before[i]))
            load[assigned[i]] += sizes[i]
    return assigned


@dataclass(frozen=True, eq=False)
class RemoteDataset:
    """Drives on the workers of a cluster; `remote_datasets` makes such datasets."""

    assignment: Assignment
    indices: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.indices)

    def subset(self, indices: Sequence[int]) -> "RemoteDataset":
        return RemoteDataset(self.assignment, tuple(self.indices[i] for i in indices))

    def call(self, function: Callable[..., T], *arguments: Any) -> list[tuple[list[int], T]]:
        """Call a function once on each worker. Return, for each call, the indices of the drives and the result.

        The function takes a list of `CachedDrive`, an Executor or None, and the arguments, and must not return None.
        """
        from distributed.protocol.pickle import dumps

        call, assignment = dumps((function, arguments)), self.assignment
        answers: list[tuple[list[int], T]] = []
        missing, lost = {drive: index for index, drive in enumerate(self.indices)}, 0
        while missing:
            shares = assignment.shares(missing)
            tasks = [(worker, own, assignment.submit(worker, call, own)) for worker, own in shares.items()]
            results = [(own, assignment.result(worker, call, own, task)) for worker, own, task in tasks]
            done = [([missing.pop(i) for i in own], result) for own, result in results if result is not None]
            answers += done
            lost = 0 if done else lost + 1
            if lost > MAX_RETRIES:
                need = in_gb(sum(assignment.sizes[i] for i in self.indices))
                raise ClusterError(
                    f"all workers with these drives died {lost} times in a row; the drives need about {need} of "
                    "memory; increase the memory of the workers, or start more workers"
                )
        return answers

    def map(self, function: Callable[[Drive], T]) -> list[T]:
        """Apply a function to each drive, and return the results in the order of the drives.

        Raises
        ------
        InputError
            If the function raises this error. Several errors become one `DriveError` that names the drives.
        """
        return results_in_order(self.call(apply_to_each, partial(_with_drive, function)))

    def imap(self, function: Callable[[Drive], T]) -> Iterator[T]:
        """Apply a function with one task per drive. Later tasks already run while the caller uses a result."""

        def one(index: int) -> T:
            return self.subset([index]).map(function)[0]

        ahead = 2 * sum(self.assignment.workers.values())
        with ThreadPoolExecutor(ahead) as pool:
            for begin in range(0, len(self), ahead):
                yield from pool.map(one, range(begin, min(begin + ahead, len(self))))


def _with_drive(function: Callable[[Drive], T], cached: CachedDrive) -> T:
    return function(cached.drive)


def remote_datasets(
    cluster: Cluster, groups: Sequence[Iterable[Any]], *, progress: ReadProgress | None = None
) -> tuple[list[RemoteDataset], list[SigmaswarmWarning]]:
    """Let the workers read groups of drives, paths, URLs or `Source`. Return a dataset for each group, and warnings.

    Raises
    ------
    DriveError
        If drives can't be read. The message names all of them.
    ClusterError
        If a worker's software versions differ from those of the client, or the drives of a worker exceed its memory.
    """
    sources = [[source_of(drive) for drive in group] for group in groups]
    assignment = Assignment(cluster, [source for group in sources for source in group])
    assignment.poll()
    dataset = RemoteDataset(assignment, tuple(range(len(assignment.sources))))

    def read(i: int) -> tuple[float, list[SigmaswarmWarning]] | InputError:
        try:
            return dataset.subset([i]).call(apply_to_each, attrgetter("size", "warned"))[0][1][0]
        except InputError as error:
            return error

    failed, warned = list[InputError](), list[SigmaswarmWarning]()
    with ThreadPoolExecutor(2 * sum(assignment.workers.values())) as pool:
        for i, result in enumerate(pool.map(read, dataset.indices)):
            if isinstance(result, InputError):
                failed.append(result)
            else:
                assignment.sizes[i] = result[0]
                warned += result[1]
            if progress:
                progress(i + 1, len(dataset))
    if failed:
        raise _joined_error(failed)
    assignment.assign()
    ends = accumulate(map(len, sources), initial=0)
    return [dataset.subset(range(begin, end)) for begin, end in pairwise(ends)], warned


def source_of(drive: Drive | Location | Source) -> Source:
    """Convert a drive, a path, a URL or a reading function to a function that returns the drive and its warnings.

    Paths become absolute, since workers may run in other folders.
    """
    if isinstance(drive, Drive):
        return partial(_with_no_warnings, drive)
    if isinstance(drive, str | Path):
        return partial(read_with_warnings, drive if is_url(drive) else Path(drive).absolute())
    return drive


def _with_no_warnings(drive: Drive) -> tuple[Drive, list[SigmaswarmWarning]]:
    return drive, []


def results_in_order(answers: Iterable[tuple[list[int], Sequence[Any]]]) -> list[Any]:
    """Return the results of `apply_to_each` in the order of the drives. Raise one error for all failures."""
    by_drive: dict[int, Any] = {}
    for indices, results in answers:
        by_drive |= zip(indices, results, strict=True)
    results = [by_drive[i] for i in sorted(by_drive)]
    if failed := [result.error for result in results if isinstance(result, Failure)]:
        raise _joined_error(failed)
    return results


def _joined_error(errors: Sequence[Exception]) -> Exception:
    if len(errors) == 1:
        return errors[0]
    shown = "; ".join(f"({k}) {error}" for k, error in enumerate(errors[:MAX_NAMED_DRIVES], 1))
    more = f"; and {len(errors) - MAX_NAMED_DRIVES} more" if len(errors) > MAX_NAMED_DRIVES else ""
    return DriveError(f"{len(errors)} drives can't be used: {shown}{more}")
