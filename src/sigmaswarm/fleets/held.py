"""The border between what asks and where drives are: a list in this process, or a fleet on a cluster."""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from sigmaswarm.drives.drive import Drive

T = TypeVar("T")


class Held(Protocol):
    """Drives that somebody holds: asked about, never handed out."""

    def __len__(self) -> int: ...

    def subset(self, drives: Sequence[int]) -> "Held":
        """Some of the drives, by index."""
        ...

    def of_each(self, function: Callable[[Drive], T]) -> list[T]:
        """What a function of a module, which a worker can import, says of each drive, in their order."""
        ...

    def one_by_one(self, function: Callable[[Drive], T]) -> Iterator[T]:
        """The same as it becomes known, for answers that are large or take long."""
        ...


@dataclass(frozen=True, eq=False)
class Here:
    """Drives in this process."""

    drives: Sequence[Drive]

    def __len__(self) -> int:
        return len(self.drives)

    def subset(self, drives: Sequence[int]) -> "Here":
        """Some of the drives, by index."""
        return Here([self.drives[i] for i in drives])

    def of_each(self, function: Callable[[Drive], T]) -> list[T]:
        """What a function says of each drive."""
        return [function(drive) for drive in self.drives]

    def one_by_one(self, function: Callable[[Drive], T]) -> Iterator[T]:
        """The same as it becomes known."""
        return map(function, self.drives)


@dataclass(frozen=True, eq=False)
class Kept:
    """A drive on a worker, and what functions made of it once and keep beside it."""

    drive: Drive
    made: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any])

    def once(self, key: Hashable, make: Callable[[Drive], T]) -> T:
        """What was made of the drive under this key, made where it is missing."""
        if key not in self.made:
            self.made[key] = make(self.drive)
        return self.made[key]
