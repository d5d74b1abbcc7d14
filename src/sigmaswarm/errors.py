"""What can go wrong, each as one sentence that says where and what to do."""

import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from pydantic import ValidationError


class SigmaswarmError(Exception):
    """Base of every error that this library raises on purpose."""


class InputError(SigmaswarmError, ValueError):
    """Something the user handed in can't be used: a file, a value, an option."""


class DriveError(InputError):
    """A drive's folder or record is unusable; the message names file, row, column, value and remedy."""


class AlignmentError(DriveError):
    """No filter can start on the drive: too slow, too few fixes, or fixes that go another way than the IMU felt."""


class SigmaswarmWarning(UserWarning):
    """Something looks wrong, but work goes on."""


class Mistake(NamedTuple):
    """What pydantic found wrong first.

    Attributes
    ----------
    key : str
        Where, with dots; empty for the whole.
    value
        What stands there.
    kind : str
        Pydantic's word for what is wrong.
    message : str
        The same in one line.
    """

    key: str
    value: Any
    kind: str
    message: str


def first_mistake(error: "ValidationError") -> Mistake:
    """The first thing that pydantic found wrong, as one line."""
    first = error.errors()[0]
    message = " ".join(first["msg"].removeprefix("Value error, ").split()).replace("Input should", "should")
    return Mistake(".".join(str(part) for part in first["loc"]), first["input"], first["type"], message)


class DriveWarning(SigmaswarmWarning):
    """A drive looks implausible; ``code`` is the doctor's for that fault, and ``doctor`` looks closer."""

    def __init__(self, said: str, code: str = "") -> None:
        super().__init__(said)
        self.code = code


def warn_deprecated(old: str, new: str) -> None:
    """Warn that a name is deprecated and will be removed in 0.5.0."""
    warnings.warn(f"{old} is deprecated, use {new}", SigmaswarmWarning, stacklevel=4)
