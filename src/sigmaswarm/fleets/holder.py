"""What runs on a worker: it reads drives, keeps them, and has functions look at them. A Dask actor, one a worker."""

import pickle
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.fleets.held import Kept
from sigmaswarm.fleets.sources import Source, need_of


@dataclass(frozen=True)
class Refused:
    """Why something can't be done on a drive, as the user is to read it."""

    error: InputError


@dataclass(frozen=True)
class Loaded:
    """What is told of a drive that a worker has read."""

    need: float
    """Bytes of the worker's memory."""
    warned: list[SigmaswarmWarning] = field(default_factory=list[SigmaswarmWarning])


Asked = Callable[..., Any]
"""A function of a module: of the drives that are kept, of threads to share the work, and of what else was sent."""


class Holder:
    """Drives that a worker holds, by their index in the fleet.

    Parameters
    ----------
    threads : int
        Of the worker, which share what one call asks for.
    """

    def __init__(self, threads: int) -> None:
        self._kept: dict[int, Kept] = {}
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def load(self, sources: Mapping[int, Source]) -> dict[int, Loaded | Refused]:
        """Read drives, and keep them."""
        found = (self._pool.map if self._pool else map)(_read, sources.values())
        told: dict[int, Loaded | Refused] = {}
        for i, one in zip(sources, found, strict=True):
            if isinstance(one, Refused):
                told[i] = one
                continue
            drive, warned = one
            self._kept[i] = Kept(drive)
            told[i] = Loaded(need_of(drive), warned)
        return told

    def drop(self, drives: Sequence[int]) -> None:
        """Let go of drives that another worker holds now."""
        for i in drives:
            self._kept.pop(i, None)

    def ask(self, packed: bytes, drives: Sequence[int]) -> "Any | Raised":
        """What a function says of some of the drives; it comes pickled with what is sent to it."""
        if any(i not in self._kept for i in drives):
            return Raised(Elsewhere())
        try:
            function, sent = pickle.loads(packed)
        except Exception as error:  # a module that is not here
            return Raised(Unknown(f"{type(error).__name__}: {error}"))
        try:
            return function([self._kept[i] for i in drives], self._pool, *sent)
        except Exception as error:
            return Raised(error)


class Unknown(Exception):
    """What was asked can't be loaded on a worker."""


class Elsewhere(Exception):
    """A drive was handed over to another worker before the question came."""


@dataclass(frozen=True)
class Raised:
    """What a function raised: an answer, too, while an error of a call is one of the cluster's."""

    error: Exception


def _read(source: Source) -> tuple[Drive, list[SigmaswarmWarning]] | Refused:
    try:
        return source.read()
    except InputError as error:
        return Refused(error)
    except OSError as error:
        return Refused(InputError(f"{error.filename or source}: {error.strerror or error}"))


def of_each(kept: Sequence[Kept], pool: Executor | None, function: Callable[[Drive], Any]) -> list[Any]:
    """What a function says of each drive, or why it can't."""
    return list((pool.map if pool else map)(partial(tried, function), [one.drive for one in kept]))


def tried(function: Callable[[Any], Any], drive: Any) -> Any:
    """What a function says of a drive, or why it can't."""
    try:
        return function(drive)
    except InputError as error:
        return Refused(error)
