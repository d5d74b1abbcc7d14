"""Connect to a Dask cluster, check the versions of its workers, and convert its errors to one-line messages."""

import asyncio
import json
import logging
import re
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from sigmaswarm.errors import InputError, SigmaswarmError, not_installed
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
                f"--cluster {address}: is not an address like tcp://host:8786; write it in this form, or for a cluster "
                "with certificates create a Client in Python and pass it as cluster="
            )
        return address
    if not Path(address).is_file():
        raise InputError(
            f"--cluster {address}: is not an existing scheduler file; name one, or write an address like "
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
