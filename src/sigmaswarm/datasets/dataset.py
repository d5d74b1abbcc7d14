"""A dataset: a sequence of drives, in this process or on a cluster, whose methods apply functions to the drives."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from sigmaswarm.drives.drive import Drive, as_list
from sigmaswarm.drives.reader import Location
from sigmaswarm.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")


class Dataset(Protocol):
    """Drives in a fixed order. Applied functions must be importable by name, for `pickle`."""

    def __len__(self) -> int: ...

    def subset(self, indices: Sequence[int]) -> "Dataset": ...

    def map(self, function: Callable[[Drive], T]) -> list[T]: ...

    def imap(self, function: Callable[[Drive], T]) -> Iterator[T]:
        """Apply a function to one drive after another, for results that are large or slow to compute."""
        ...


Drives = Sequence[Drive | Location] | Drive | Location | Dataset
"""Types of the argument ``drives`` of functions. Paths and URLs are accepted only with a cluster."""


@dataclass(frozen=True, eq=False)
class LocalDataset:
    drives: Sequence[Drive]

    def __len__(self) -> int:
        return len(self.drives)

    def subset(self, indices: Sequence[int]) -> "LocalDataset":
        return LocalDataset([self.drives[i] for i in indices])

    def map(self, function: Callable[[Drive], T]) -> list[T]:
        return [function(drive) for drive in self.drives]

    def imap(self, function: Callable[[Drive], T]) -> Iterator[T]:
        return map(function, self.drives)


def make_datasets(
    *groups: Any,
    cluster: "Client | None" = None,
    executor: Executor | None = None,
    takes: str = "Drives are needed",
) -> list[Dataset]:
    """Make a dataset from each group of drives. The workers of a cluster read the drives in parallel.

    Parameters
    ----------
    *groups
        Each group is a Drive, a sequence of Drives, or a dataset. With a cluster, paths and URLs are also possible.
    takes : str
        The input that the calling function accepts, for messages.

    Raises
    ------
    InputError
        If an item is not a drive, or both an executor and a cluster are given.
    """
    if cluster is not None and executor is not None:
        raise InputError(
            "executor and cluster can't be combined, since a cluster distributes the work itself; omit one option"
        )
    given = [_listed(group, cluster, takes) for group in groups]
    lists = [group for group in given if isinstance(group, list)]
    made: list[Dataset] = [LocalDataset(group) for group in lists] if cluster is None else []
    if cluster is not None:
        from sigmaswarm.datasets.cluster import Cluster
        from sigmaswarm.datasets.remote import remote_datasets

        remote, warned = remote_datasets(Cluster(cluster), lists)
        made = [*remote]
        for warning in warned:
            warnings.warn(warning, stacklevel=3)
    return [made.pop(0) if isinstance(group, list) else group for group in given]


def _listed(given: Any, cluster: "Client | None", takes: str) -> "list[Any] | Dataset":
    if hasattr(given, "imap"):
        return given
    drives: list[Any] = [given] if isinstance(given, str | Path) else as_list(given)
    allowed = Drive if cluster is None else Drive | str | Path
    stray = [thing for thing in drives if not isinstance(thing, allowed)]
    if stray:
        hint = "" if cluster is None else ", and with a cluster their paths and URLs"
        if any(isinstance(thing, str | Path) for thing in stray):
            hint = "; sigmaswarm.read_drive(path) reads a Drive"
        raise InputError(f"got a {type(stray[0]).__name__}; {takes}{hint}")
    return drives
