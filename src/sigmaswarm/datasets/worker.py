"""Code for the workers of a cluster: one task function, and a cache of drives for each worker."""

import pickle
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeVar

from sigmaswarm.datasets.cluster import ClusterError
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError, SigmaswarmWarning

T = TypeVar("T")
Source = Callable[[], tuple[Drive, list[SigmaswarmWarning]]]
"""Picklable function that returns a drive and the warnings about it."""

USABLE_MEMORY = 0.8  # fraction of a worker's memory above which Dask pauses the worker
BASE_MEMORY = 350e6  # bytes without drives: interpreter, Numba, polars
BYTES_PER_COLUMN_BYTE = 3.3  # memory of a prepared drive / size of its columns (`benchmarks/fleet.py`)


@dataclass(frozen=True)
class Failure:
    """An exception that is returned instead of raised, since Dask would log a failed task."""

    error: Exception


@dataclass(frozen=True, eq=False)
class CachedDrive:
    """A drive on a worker, and results that functions have stored for it."""

    drive: Drive
    warned: list[SigmaswarmWarning]
    results: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any])

    @property
    def size(self) -> float:
        """Estimated size of the drive and of all data prepared from it, bytes."""
        columns = [c for table in self.drive.tables.values() for c in vars(table).values() if c is not None]
        return BYTES_PER_COLUMN_BYTE * sum(column.nbytes for column in columns)

    def once(self, key: Hashable, make: Callable[[Drive], T]) -> T:
        if key not in self.results:
            self.results[key] = make(self.drive)
        return self.results[key]


class DriveCache:
    """The drives of a worker; if their size exceeds ``memory`` (bytes), the least recently used drives are dropped."""

    def __init__(self, worker: str, threads: int, memory: float) -> None:
        self.pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._worker, self._memory = worker, memory
        self._drives: dict[str, CachedDrive] = {}  # most recently used drive last
        self._lock = threading.Lock()

    def get(self, sources: Mapping[str, Source | None]) -> list[CachedDrive] | None:
        """Return the drives with the keys of ``sources``; return None if a drive is not cached and has no source.

        Raises
        ------
        InputError
            If a drive can't be read.
        ClusterError
            If the total size of these drives exceeds the memory.
        """
        known = {key: drive for key in sources if (drive := self._drives.get(key))}
        missing = {key: source for key, source in sources.items() if key not in known and source}
        if len(known) + len(missing) < len(sources):
            return None
        known |= zip(missing, (self.pool.map if self.pool else map)(_read, missing.values()), strict=True)
        needed = sum(drive.size for drive in known.values())
        with self._lock:
            self._drives = {k: d for k, d in self._drives.items() if k not in known} | known
            total = sum(drive.size for drive in self._drives.values())
            while total > max(self._memory, needed):
                total -= self._drives.pop(next(iter(self._drives))).size
        if needed > self._memory:
            raise ClusterError(
                f"worker {self._worker}: its {len(sources)} drives need about {in_gb(needed)} of memory, but it has "
                f"{in_gb(max(self._memory, 0.0))} for drives; start more workers, or increase their memory"
            )
        return [known[key] for key in sources]


def _read(source: Source) -> CachedDrive:
    try:
        return CachedDrive(*source())
    except OSError as error:
        raise InputError(f"{error.filename or source}: {error.strerror or error}") from None


def in_gb(size: float) -> str:
    return f"{size / 1e9:.2g} GB"


_caches: dict[str, DriveCache] = {}
"""Caches by the address of the worker; in a cluster whose workers are threads, a process has several workers."""
_caches_lock = threading.Lock()


def run_task(call: bytes, sources: bytes, address: str) -> Any:
    """Call a function with drives of this worker; return None if it needs sources that were not sent."""
    from distributed import get_worker
    from distributed.system import MEMORY_LIMIT

    with _caches_lock:
        if address not in _caches:
            worker: Any = get_worker()
            memory = USABLE_MEMORY * (worker.memory_manager.memory_limit or MEMORY_LIMIT) - BASE_MEMORY
            _caches[address] = DriveCache(address, worker.state.nthreads, memory)
    cache = _caches[address]
    try:
        (function, arguments), wanted = pickle.loads(call), pickle.loads(sources)
    except Exception as error:  # a module may be missing on this worker
        message = f"worker {address}: can't run the task ({type(error).__name__}: {error})"
        return Failure(ClusterError(message))
    try:
        drives = cache.get(wanted)
        return None if drives is None else function(drives, cache.pool, *arguments)
    except Exception as error:
        return Failure(error)


def apply_to_each(
    drives: Sequence[CachedDrive], pool: Executor | None, function: Callable[[CachedDrive], Any]
) -> list[Any]:
    """Apply a function to each drive; an `InputError` becomes a `Failure`."""

    def attempt(drive: CachedDrive) -> Any:
        try:
            return function(drive)
        except InputError as error:
            return Failure(error)

    return list((pool.map if pool else map)(attempt, drives))
