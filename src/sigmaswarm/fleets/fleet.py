"""Drives that the workers of a cluster hold: read there once, asked about again and again, read again where one dies.

A worker has one actor (`Holder`) with its share of the drives, and each question is one call a worker: what travels is
the question, and an answer for each drive. A drive is on one worker at a time. Which one that is changes no answer, for
each is made of one drive alone and put in the drives' order here; so a fleet on one worker, on two hundred, or on those
that are left gives the same bits.

Dask does not bring a dead worker's actor back. A call that ends in an error of the connection, or whose worker the
scheduler no longer knows, means that the worker is lost: what it held is read by others, and only its part of the
question is asked again. A worker that comes later takes over its share.
"""

import asyncio
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.places import is_url
from sigmaswarm.errors import DriveError, InputError, SigmaswarmWarning
from sigmaswarm.fleets.connection import Cluster, ClusterError, Worker
from sigmaswarm.fleets.holder import Asked, Elsewhere, Holder, Loaded, Raised, Refused, Unknown, of_each
from sigmaswarm.fleets.sources import At, Given, Source

T = TypeVar("T")
Told = Callable[[int, int], None]
"""Takes how many drives are read, and of how many."""

LOOK = 2.0
"""s between two looks at who is there, while answers are waited for or between questions."""
NOTICED = 5.0
"""s after which a scheduler knows that a worker is dead whose connection is broken."""
COMES = 60.0
"""s that a worker may take to load this library."""
ALLOWED = 3
"""Workers that may die, a worker that is there, without one answer in between: then the drives kill them."""
UNREADABLE_SHOWN = 10
"""Drives in one message."""


@dataclass(eq=False)
class _Host:
    """A worker with its actor."""

    worker: Worker
    future: Any
    actor: Any
    held: set[int] = field(default_factory=set[int])

    def load(self, sizes: Sequence[float]) -> float:
        """Bytes that its drives take."""
        return sum(sizes[i] for i in self.held)


class _Lost(Exception):
    """A worker does not answer any more."""


class _Yard:
    """What all views of a fleet share: who holds what. Its lock is held while drives change hands."""

    def __init__(self, cluster: Cluster, sources: Sequence[Source], progress: Told | None) -> None:
        self.cluster, self.sources, self.progress = cluster, sources, progress
        self.sizes = [max(source.size(), 1.0) for source in sources]
        self.told: dict[int, Loaded] = {}
        self.hosts: dict[str, _Host] = {}
        self._lock = threading.RLock()
        self._looked = -LOOK
        self._waiting = False
        self._direct: bool | None = None
        self._deaths = 0
        self._refused: set[str] = set()

    # Who holds what

    def placed(self, drives: Iterable[int]) -> list[tuple[_Host, list[int]]]:
        """The drives by the worker that holds them, each read by one where nobody does."""
        wanted = sorted(drives)
        with self._lock:
            if time.monotonic() - self._looked > LOOK:
                self._look()
            while missing := [i for i in wanted if not any(i in host.held for host in self.hosts.values())]:
                self._read(missing)
            found = [(host, [i for i in wanted if i in host.held]) for host in self.hosts.values()]
            return [(host, own) for host, own in found if own]

    def lost(self, host: _Host) -> None:
        """Forget a worker, and what it held."""
        with self._lock:
            if self.hosts.get(host.worker.address) is host:
                allowed = ALLOWED * len(self.hosts)
                del self.hosts[host.worker.address]
                self._deaths += 1
                self._looked = -LOOK
                if self._deaths > allowed:
                    raise ClusterError(
                        f"{self._deaths} workers died one after the other over these drives, which need "
                        f"{_gb(sum(self.sizes))} in all; give the workers more memory, or start more of them"
                    )

    def answered(self) -> None:
        """The workers are well."""
        self._deaths = 0

    def _look(self) -> None:
        """See who came and who went; a newcomer takes over its share."""
        while True:
            there = self.cluster.workers()
            for address in [a for a in self.hosts if a not in there]:
                del self.hosts[
                    address
                ]  # taken away, it may be all at once; that is no fault of what they held
            new = [w for a, w in there.items() if a not in self.hosts and a not in self._refused]
            self._adopt(new)
            self._looked = time.monotonic()
            if self.hosts:
                break
            if not self._waiting:
                self._waiting = True
                said = "no worker is left" if self.told else "there is no worker yet"
                said = f"{said} at {self.cluster.address}: waiting for one to come"
                warnings.warn(said, SigmaswarmWarning, stacklevel=2)
            time.sleep(LOOK / 4)
        self._waiting = False
        if new and any(host.held for host in self.hosts.values()):
            self._spread()

    def _adopt(self, new: Sequence[Worker]) -> None:
        """Start the actors of newcomers that have the same versions."""
        unlike = self.cluster.unlike([worker.address for worker in new])
        for address, error in unlike.items():
            if not self.told:
                raise error  # at the start the user is to hear of it
            self._refused.add(address)
            warnings.warn(f"{error}; it gets nothing to do", SigmaswarmWarning, stacklevel=2)
        client = self.cluster.client
        with client.as_current():  # which actors look for
            begun = [(w, self._actor(w)) for w in new if w.address not in unlike]
            if self._direct is None and begun:
                self._direct = self.cluster.reaches(begun[0][0].address)
            for worker, future in begun:
                with suppress(Exception):  # it died while it came
                    self.hosts[worker.address] = _Host(worker, future, future.result(timeout=COMES))

    def _actor(self, worker: Worker) -> Any:
        alone: dict[str, Any] = {"workers": [worker.address], "allow_other_workers": False}
        return self.cluster.client.submit(Holder, worker.threads, actor=True, pure=False, **alone)

    def _spread(self) -> None:
        """Hand drives over to those that have less, as long as nobody then has more than the one that had most."""
        for poor, taken in self._moves():
            self._load(poor, taken)
            for rich in list(self.hosts.values()):
                if rich is not poor and (given := sorted(rich.held & poor.held)):
                    rich.held -= set(given)
                    with suppress(_Lost):  # whoever asks next will notice
                        self.wait(rich, self.call(rich, "drop", given))

    def _moves(self) -> list[tuple[_Host, list[int]]]:
        """Who is to take over which drives."""
        hosts = list(self.hosts.values())
        held = {host.worker.address: set(host.held) for host in hosts}

        def busy(host: _Host, more: float = 0.0) -> float:
            return (sum(self.sizes[i] for i in held[host.worker.address]) + more) / host.worker.threads

        while True:
            rich, poor = max(hosts, key=busy), min(hosts, key=busy)
            own = sorted(held[rich.worker.address], key=lambda i: (-self.sizes[i], i))
            fit = [i for i in own if busy(poor, self.sizes[i]) < busy(rich)]
            if not fit:
                break
            held[rich.worker.address].remove(fit[0])
            held[poor.worker.address].add(fit[0])
        new = [(host, sorted(held[host.worker.address] - host.held)) for host in hosts]
        return [(host, drives) for host, drives in new if drives]

    # Reading

    def _read(self, drives: Sequence[int]) -> None:
        """Have drives read that nobody holds, by those that have the most room."""
        if not self.hosts:
            self._look()
        shares = self._shares(drives)
        with ThreadPoolExecutor(max(len(shares), 1)) as pool:
            found = pool.map(self._load, *zip(*shares, strict=True)) if shares else ()
            refused = [one for part in found for one in part]
        for host, own in shares:
            if not host.held.issuperset(set(own) - {i for i, _ in refused}):
                self.lost(host)
        if refused:
            raise all_refused([error for _, error in sorted(refused, key=lambda pair: pair[0])])

    def _shares(self, drives: Sequence[int]) -> list[tuple[_Host, list[int]]]:
        """Longest first, each to the worker that has the least to do so far, where it fits."""
        hosts = list(self.hosts.values())
        load = {host.worker.address: host.load(self.sizes) for host in hosts}
        shares: dict[str, list[int]] = {host.worker.address: [] for host in hosts}
        for i in sorted(drives, key=lambda i: -self.sizes[i]):
            fitting = [h for h in hosts if load[h.worker.address] + self.sizes[i] <= h.worker.room]
            if not fitting:
                room = sum(max(h.worker.room, 0.0) for h in hosts)
                raise ClusterError(
                    f"the drives need about {_gb(sum(self.sizes))} of the workers' memory, and {len(hosts)} of them "
                    f"have {_gb(room)} to spare; start more workers, or give them more memory"
                )
            best = min(fitting, key=lambda h: load[h.worker.address] / h.worker.threads)
            shares[best.worker.address].append(i)
            load[best.worker.address] += self.sizes[i]
        return [(host, sorted(shares[host.worker.address])) for host in hosts if shares[host.worker.address]]

    def _load(self, host: _Host, drives: Sequence[int]) -> list[tuple[int, InputError]]:
        """Have a worker read drives, a few at a time; those that it can't."""
        refused: list[tuple[int, InputError]] = []
        step = max(host.worker.threads, 1)
        for k in range(0, len(drives), step):
            try:
                found = self.wait(
                    host, self.call(host, "load", {i: self.sources[i] for i in drives[k : k + step]})
                )
            except _Lost:  # the caller sees what is missing
                break
            self.answered()
            for i, one in found.items():
                if isinstance(one, Refused):
                    refused.append((i, one.error))
                    continue
                host.held.add(i)
                self.sizes[i] = one.need
                self.told.setdefault(i, one)
                if self.progress:
                    self.progress(len(self.told), len(self.sources))
        return refused

    # Calls

    def call(self, host: _Host, method: str, *sent: Any) -> "Future[Any]":
        """Begin a call of a worker's actor.

        By the actor's connection, not by its methods: their futures wait for ever where a call can't be made at all.
        """
        from distributed.protocol.serialize import to_serialize

        async def made() -> Any:
            # directly where that goes: by way of the scheduler a call takes twice as long
            rpc = self.cluster.client.rpc(host.worker.address) if self._direct else host.actor._worker_rpc
            packed = [to_serialize(one) for one in sent]
            return await rpc.actor_execute(function=method, actor=host.actor.key, args=packed, kwargs={})

        loop: Any = self.cluster.client.loop
        return asyncio.run_coroutine_threadsafe(made(), loop.asyncio_loop)

    def wait(self, host: _Host, future: "Future[Any]") -> Any:
        """The answer, or `_Lost`."""
        while not future.done():
            try:
                future.result(timeout=LOOK)
            except TimeoutError:
                if not future.done() and host.worker.address not in self.cluster.workers():
                    future.cancel()
                    raise _Lost from None
            except (Exception, CancelledError):
                break  # it is done
        try:
            answer: dict[str, Any] = future.result()
            if answer["status"] == "OK":
                return answer["result"]
            error: BaseException = answer["exception"]
        except (OSError, CancelledError):  # of the connection: what functions raise is an answer
            self._sure(host)
            raise _Lost from None
        except Exception as raised:
            error = raised
        if not self._sure(host):
            raise _Lost
        raise ClusterError(f"worker {host.worker.address} can't be asked ({type(error).__name__}: {error})")

    def _sure(self, host: _Host) -> bool:
        """Whether a worker is still there, once the scheduler would know otherwise; else it seems a newcomer."""
        until = time.monotonic() + NOTICED
        while host.worker.address in self.cluster.workers():
            if time.monotonic() > until:
                return True
            time.sleep(0.1)
        return False


@dataclass(frozen=True, eq=False)
class Fleet:
    """Drives on the workers of a cluster, or some of them; made by `Fleet.read`."""

    yard: _Yard
    drives: tuple[int, ...]

    @classmethod
    def read(
        cls,
        cluster: Cluster,
        sources: Iterable[Source],
        *,
        progress: Told | None = None,
    ) -> "Fleet":
        """Have a cluster's workers read drives, and hold them.

        Raises
        ------
        DriveError
            Naming all drives that can't be read.
        ClusterError
            If a worker has other versions, or the drives don't fit into the workers' memory.
        """
        wanted = list(sources)
        yard = _Yard(cluster, wanted, progress)
        fleet = cls(yard, tuple(range(len(wanted))))
        yard.placed(fleet.drives)
        return fleet

    def __len__(self) -> int:
        return len(self.drives)

    def subset(self, drives: Sequence[int]) -> "Fleet":
        """Some of the drives, by index; they stay where they are."""
        return Fleet(self.yard, tuple(self.drives[i] for i in drives))

    def ask(self, function: Asked, *sent: Any) -> list[tuple[list[int], Any]]:
        """Have the workers call a function on the drives that they hold: places of drives in this fleet, and answers.

        Parameters
        ----------
        function : callable
            Of a module that workers can import: of the `Kept` drives, of an Executor or None, and of what is sent.
        *sent
            The same for all.
        """
        from distributed.protocol.pickle import dumps

        packed = dumps((function, sent))  # once for all workers
        answers: list[tuple[list[int], Any]] = []
        missing = {drive: place for place, drive in enumerate(self.drives)}
        while missing:
            begun: list[tuple[_Host, list[int], Any]] = []
            for host, own in self.yard.placed(missing):
                begun.append((host, own, self.yard.call(host, "ask", packed, own)))
            for host, own, future in begun:
                try:
                    answer = self.yard.wait(host, future)
                except _Lost:
                    self.yard.lost(host)
                    continue
                if isinstance(answer, Raised):
                    if isinstance(answer.error, Elsewhere):
                        continue
                    if isinstance(answer.error, Unknown):
                        raise ClusterError(f"worker {host.worker.address} can't be asked ({answer.error})")
                    raise answer.error
                self.yard.answered()
                answers.append(([missing.pop(i) for i in own], answer))
        return answers

    def of_each(self, function: Callable[[Drive], T]) -> list[T]:
        """What a function of a module says of each drive, in their order.

        Raises
        ------
        DriveError
            Naming all drives of which it can't.
        """
        return told_of_each(self.ask(of_each, function))

    def one_by_one(self, function: Callable[[Drive], T]) -> Iterator[T]:
        """The same in answers of one drive each, so that none is large and a lost worker costs little."""

        def one(place: int) -> T:
            return self.subset([place]).of_each(function)[0]

        ahead = max(2 * len(self.yard.hosts), 2)  # so that no more answers wait here than are looked at
        with ThreadPoolExecutor(ahead) as pool:
            begun = deque[Future[T]]()
            for place in range(len(self)):
                begun.append(pool.submit(one, place))
                if len(begun) >= ahead:
                    yield begun.popleft().result()
            for future in begun:
                yield future.result()

    @property
    def warned(self) -> list[SigmaswarmWarning]:
        """What was told of the drives while they were read, in their order."""
        return [warning for i in self.drives for warning in self.yard.told[i].warned]


def told_of_each(answers: Iterable[tuple[list[int], Sequence[Any]]]) -> list[Any]:
    """Answers, one a drive, in the order of the drives; an error that names all that were refused."""
    pairs = sorted(
        (pair for places, each in answers for pair in zip(places, each, strict=True)),
        key=lambda pair: pair[0],
    )
    if refused := [one.error for _, one in pairs if isinstance(one, Refused)]:
        raise all_refused(refused)
    return [one for _, one in pairs]


def all_refused(errors: Sequence[InputError]) -> InputError:
    if len(errors) == 1:
        return errors[0]
    shown = "; ".join(f"({k}) {error}" for k, error in enumerate(errors[:UNREADABLE_SHOWN], 1))
    more = f"; and {len(errors) - UNREADABLE_SHOWN} more" if len(errors) > UNREADABLE_SHOWN else ""
    return DriveError(f"{len(errors)} drives can't be used: {shown}{more}")


def _gb(size: float) -> str:
    return f"{size / 1e9:.2g} GB"


def fleet_groups(
    cluster: Cluster, groups: Sequence[Sequence[Any]], *, progress: Told | None = None
) -> list[Fleet]:
    """Groups of drives, paths or URLs, all read at once: a view of one fleet for each group."""
    fleet = Fleet.read(cluster, sources_of([drive for group in groups for drive in group]), progress=progress)
    ends = [sum(map(len, groups[: k + 1])) for k in range(len(groups))]
    return [fleet.subset(range(end - len(group), end)) for group, end in zip(groups, ends, strict=True)]


def sources_of(drives: Iterable[Any]) -> list[Source]:
    """Where the workers get drives from that were given as drives, paths or URLs.

    A worker may stand in another folder, so a path goes out as a whole one.
    """
    return [
        Given(one) if isinstance(one, Drive) else At(one if is_url(one) else Path(one).absolute())
        for one in drives
    ]
