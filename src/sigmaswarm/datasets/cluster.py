"""Connect to a Dask cluster, check the versions of its workers, and run tasks there, with a cache of drives per worker.

Errors of Dask become one-line messages.
"""

import asyncio
import json
import logging
import pickle
import re
import threading
from collections.abc import Callable, Generator, Hashable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError, SigmaswarmError, SigmaswarmWarning, not_installed
from sigmaswarm.file_sizes import MAX_TOML_BYTES, read_bounded
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

ANSWER_TIMEOUT = 30.0  # s, for a request to the scheduler
CONNECT_TIMEOUT = 10.0  # s


class ClusterError(SigmaswarmError):
    """A cluster can't be reached, or can't run a task."""


@dataclass(frozen=True, eq=False)
class Cluster:
    """A Dask client, and the requests that this library sends to its cluster."""

    client: "Client"

    def __post_init__(self) -> None:
        if self.client.asynchronous:
            raise InputError("cluster is an asynchronous client; make a client with asynchronous=False")

    @property
    def address(self) -> str:
        scheduler: Any = self.client.scheduler
        return str(scheduler.address if scheduler is not None else "?")

    def workers(self) -> dict[str, int]:
        """Return the number of threads of each connected worker, by address."""
        if self.client.status != "running":
            raise self.lost_scheduler()

        async def identity() -> dict[str, Any]:
            scheduler: Any = self.client.scheduler
            return await asyncio.wait_for(scheduler.identity(n_workers=-1), ANSWER_TIMEOUT)

        try:
            identities = cast("dict[str, Any]", self.client.sync(identity))["workers"]
        except Exception:  # communication errors, timeouts, a client that was closed meanwhile
            raise self.lost_scheduler() from None
        return {address: int(worker["nthreads"]) for address, worker in identities.items()}

    def version_errors(self, addresses: list[str]) -> dict[str, ClusterError]:
        """Return an error for each worker whose software versions may lead to different results."""
        try:
            run: Any = self.client.run
            answers: dict[str, Any] = run(versions, workers=addresses, on_error="return") if addresses else {}
        except OSError:
            raise self.lost_scheduler() from None
        own, errors = versions(), dict[str, ClusterError]()
        for address, found in sorted(answers.items()):
            if not isinstance(found, Mapping):
                reason = f"sigmaswarm can't be imported ({type(found).__name__}: {found}); install it on this worker"
                errors[address] = ClusterError(f"worker {address}: {reason}")
                continue
            for name in ("sigmaswarm", "numpy", "numba", "scipy"):
                if found.get(name) != own[name] and address not in errors:
                    errors[address] = ClusterError(
                        f"worker {address}: has {name} {found.get(name)}, but this machine has {own[name]}; "
                        "results would differ, so install the same version on both"
                    )
        return errors

    def require_same_versions(self) -> None:
        for error in self.version_errors(list(self.workers())).values():
            raise error

    def lost_scheduler(self) -> ClusterError:
        return ClusterError(
            f"the scheduler at {self.address} no longer answers; if --out was specified, the results so far are "
            "saved: continue with --resume and another cluster"
        )


@contextmanager
def connected(address: str) -> Generator["Client"]:
    """Connect to the cluster at an address until the block ends.

    The address is ``tcp://host:8786`` (or another protocol without certificates, such as ws), the path of a scheduler
    file, or ``local:4`` for four single-threaded processes on this machine.

    Raises
    ------
    InputError
        If Dask is not installed, or the address is invalid.
    ClusterError
        If no scheduler answers at the address.
    """
    try:
        import distributed
    except ImportError:
        raise not_installed(f"--cluster {address}", "Dask", "'sigmaswarm[cluster]'") from None
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # errors are reported here, in one line
    with ExitStack() as stack:
        kind, _, count = address.partition(":")
        where: Any = stack.enter_context(_local(address, count)) if kind == "local" else _scheduler(address)
        options: dict[str, Any] = {"timeout": CONNECT_TIMEOUT, "set_as_default": False}
        try:
            client = distributed.Client(where, name="sigmaswarm", **options)
        except Exception as error:  # errors of sockets, addresses, protocols
            reason = " ".join(str(error).split())[:150]
            raise ClusterError(
                f"--cluster {address}: no scheduler answers at this address ({type(error).__name__}: {reason}); "
                "start one with `dask scheduler`"
            ) from None
        try:
            yield client
        finally:
            try:
                client.close(timeout=5)
            except Exception:  # the cluster is gone; its error was already reported
                logging.getLogger(__name__).debug("the client did not close", exc_info=True)


def _scheduler(address: str) -> str:
    """Return the address of a scheduler, which may be in a scheduler file."""
    if "://" in address:
        if not re.fullmatch(r"(?!tls)\w+://.+:\d+", address):
            raise InputError(
                f"--cluster {address}: is not an address like tcp://host:8786; write it in this form or, for a cluster "
                "with certificates, create a Client in Python and pass it as cluster="
            )
        return address
    if not Path(address).is_file():
        raise InputError(
            f"--cluster {address}: is not an existing scheduler file; specify one, or write an address like "
            "tcp://host:8786, or local:N for N processes"
        )
    try:
        return str(json.loads(read_bounded(Path(address), MAX_TOML_BYTES))["address"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(
            f"--cluster {address}: is not a scheduler file; `dask scheduler --scheduler-file` writes one"
        ) from None


@contextmanager
def _local(address: str, count: str) -> Generator[Any]:
    from tempfile import TemporaryDirectory

    import distributed

    if not count.isdecimal() or int(count) < 1:
        raise InputError(f"--cluster {address}: specify the number of processes, for example local:4")
    with TemporaryDirectory(prefix="sigmaswarm-", ignore_cleanup_errors=True) as scratch:
        local: Any = distributed.LocalCluster  # the type stubs lack dashboard_address=None
        cluster = local(
            n_workers=int(count),
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            local_directory=scratch,
        )
        try:
            yield cluster
        finally:
            cluster.close(timeout=10)


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
    """The drives of a worker. If their size exceeds ``memory`` (bytes), the least recently used drives are dropped."""

    def __init__(self, worker: str, threads: int, memory: float) -> None:
        self.pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._worker, self._memory = worker, memory
        self._drives: dict[str, CachedDrive] = {}  # most recently used drive last
        self._lock = threading.Lock()

    def get(self, sources: Mapping[str, Source | None]) -> list[CachedDrive] | None:
        """Return the drives with the keys of ``sources``, or None if a drive is not cached and has no source.

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
"""Caches by the address of the worker. In a cluster whose workers are threads, a process has several workers."""
_caches_lock = threading.Lock()


def run_task(call: bytes, sources: bytes, address: str) -> Any:
    """Call a function with drives of this worker. Return None if it needs sources that were not sent."""
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
    """Apply a function to each drive. An `InputError` becomes a `Failure`."""

    def attempt(drive: CachedDrive) -> Any:
        try:
            return function(drive)
        except InputError as error:
            return Failure(error)

    return list((pool.map if pool else map)(attempt, drives))
