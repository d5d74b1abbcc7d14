"""A Dask cluster: reached by an address, its workers checked, and what goes wrong with it told in one line."""

import asyncio
import json
import logging
import re
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

PATIENCE = 30.0
"""s that a scheduler may take to answer."""
REACH = 2.0
"""s that a worker may take to answer directly."""
CONNECT = 10.0
"""s that it may take to be reached."""
FREE = 0.8
"""Share of a worker's memory that drives may fill: Dask pauses a worker there, and ends it at 0.95."""
BASE = 350e6
"""Bytes of a worker that holds nothing: the interpreter, Numba, polars."""


class ClusterError(SigmaswarmError):
    """A cluster that can't be reached, or can't do the work; told in one line."""


@dataclass(frozen=True)
class Worker:
    """What the scheduler says of a worker: address, name, threads, and the bytes that it has for drives."""

    address: str
    name: str
    threads: int
    room: float


@dataclass(frozen=True, eq=False)
class Cluster:
    """A Dask client, and what this library asks of it.

    Parameters
    ----------
    client : distributed.Client
    """

    client: "Client"

    def __post_init__(self) -> None:
        if self.client.asynchronous:
            raise InputError("cluster: is an asynchronous client; make one with asynchronous=False")

    @property
    def address(self) -> str:
        """The scheduler's."""
        scheduler: Any = self.client.scheduler
        return str(scheduler.address if scheduler is not None else "?")

    def workers(self) -> dict[str, Worker]:
        """Those that are there now, by address.

        Raises
        ------
        ClusterError
            If the scheduler is gone.
        """
        found = self._identity()["workers"]
        return {
            address: Worker(address, str(about["name"]), int(about["nthreads"]), _room(about["memory_limit"]))
            for address, about in found.items()
        }

    def unlike(self, addresses: list[str]) -> dict[str, ClusterError]:
        """Workers on which the same numbers need not have the same bits, and what to say of each."""
        own, found = versions(), dict[str, ClusterError]()
        for address, theirs in sorted(self._run(versions, addresses).items() if addresses else ()):
            if not isinstance(theirs, Mapping):
                found[address] = ClusterError(
                    f"worker {address}: sigmaswarm can't be used there ({type(theirs).__name__}: {theirs}); install it"
                )
                continue
            for name in ("sigmaswarm", "numpy", "numba", "scipy"):
                if theirs.get(name) != own[name]:
                    found[address] = ClusterError(
                        f"worker {address}: has {name} {theirs.get(name)}, this machine {own[name]}; results would "
                        "differ, so install the same on both"
                    )
                    break
        return found

    def reaches(self, worker: str) -> bool:
        """Whether a worker answers without the scheduler in between, which many networks do not allow."""

        async def ask() -> None:
            rpc: Any = self.client.rpc(worker)
            await asyncio.wait_for(rpc.identity(), REACH)

        try:
            self.client.sync(ask)
        except Exception:  # comm errors, timeouts
            return False
        return True

    def check(self) -> None:
        """Refuse to begin where a worker has other versions, for what goes without a `Fleet`.

        Raises
        ------
        ClusterError
            Naming the first of them.
        """
        for error in self.unlike(list(self.workers())).values():
            raise error

    def gone(self) -> ClusterError:
        """What to say where the scheduler does not answer."""
        return ClusterError(
            f"the scheduler at {self.address} is gone; what was told so far is saved where there is an --out: go on "
            "with --resume and another cluster"
        )

    def _identity(self) -> dict[str, Any]:
        if self.client.status != "running":
            raise self.gone()

        async def ask() -> dict[str, Any]:
            scheduler: Any = self.client.scheduler
            return await asyncio.wait_for(scheduler.identity(n_workers=-1), PATIENCE)

        try:
            return cast("dict[str, Any]", self.client.sync(ask))
        except Exception:  # comm errors, timeouts, a client that was closed meanwhile
            raise self.gone() from None

    def _run(self, function: Any, addresses: list[str] | None) -> dict[str, Any]:
        try:
            return cast("dict[str, Any]", self.client.run(function, workers=addresses, on_error="return"))
        except OSError:
            raise self.gone() from None


def _room(limit: float | None) -> float:
    """What drives may take of a worker's memory; a limit of 0 is none."""
    return FREE * limit - BASE if limit else float("inf")


@contextmanager
def connected(address: str) -> Generator["Client"]:
    """A client of the cluster at an address; what was started for it ends with the block.

    Parameters
    ----------
    address : str
        ``tcp://host:8786`` (or tls, ws ...), the path of a scheduler file, or ``local:4`` for so many processes of one
        thread on this machine.

    Raises
    ------
    InputError
        If dask is not installed, or the address is none.
    ClusterError
        If nobody answers there.
    """
    try:
        import distributed
    except ImportError:
        raise InputError(f"--cluster {address} needs Dask; run: pip install 'sigmaswarm[cluster]'") from None
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what goes wrong is told in one line, here
    kind, _, count = address.partition(":")
    if kind == "local":
        if not count.isdecimal() or int(count) < 1:
            raise InputError(f"--cluster {address}: say how many processes, for example local:4")
        with _local(int(count)) as client:
            yield client
        return
    where: dict[str, Any] = {"address": address}
    if "://" not in address:
        if not Path(address).is_file():
            raise InputError(
                f"--cluster {address}: is no address like tcp://host:8786, no scheduler file that is there, and not "
                "local:N"
            )
        where = {"address": _address_in(Path(address))}
    elif not re.fullmatch(r"(?!tls)\w+://.+:\d+", address):
        raise InputError(
            f"--cluster {address}: write it as tcp://host:8786; for a cluster with certificates make a Client in "
            "Python, and give it as cluster="
        )
    try:
        client = distributed.Client(**where, timeout=CONNECT, set_as_default=False, name="sigmaswarm")
    except Exception as error:  # of sockets, addresses, protocols
        said = " ".join(str(error).split())[:150]
        raise ClusterError(
            f"--cluster {address}: no scheduler answers there ({type(error).__name__}: {said}); "
            "start one with `dask scheduler`"
        ) from None
    try:
        yield client
    finally:
        _closed(client)


def _address_in(file: Path) -> str:
    """What a scheduler file says."""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"--cluster {file}: is no scheduler file; `dask scheduler --scheduler-file` writes one"
        ) from None


@contextmanager
def _local(count: int) -> Generator["Client"]:
    """Processes on this machine."""
    from tempfile import TemporaryDirectory

    import distributed

    with TemporaryDirectory(prefix="sigmaswarm-", ignore_cleanup_errors=True) as scratch:
        local: Any = distributed.LocalCluster  # whose types know of no cluster without a dashboard
        cluster = local(
            n_workers=count,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            local_directory=scratch,
        )
        client = distributed.Client(cluster, set_as_default=False)
        try:
            yield client
        finally:
            _closed(client)
            cluster.close(timeout=10)


def _closed(client: "Client") -> None:
    try:
        client.close(timeout=5)
    except Exception:  # of a cluster that is gone, which was told
        logging.getLogger(__name__).debug("the client did not close", exc_info=True)
