"""Errors and warnings. Each message is one sentence with the place and the remedy."""

import warnings


class SigmaswarmError(Exception):
    """Base class of the library's errors."""


class InputError(SigmaswarmError, ValueError):
    """A file, a value or an option can't be used."""


class DriveError(InputError):
    """A drive is unusable. The message names file, row, column, value and remedy."""


class AlignmentError(DriveError):
    """No filter can start on a drive: the vehicle is too slow, or the fixes are too few or contradict the IMU."""


class TuningStopped(SigmaswarmError):
    """The progress callback stopped a tuning run. A run with a folder can be resumed."""


class SigmaswarmWarning(UserWarning):
    """Warning of a probable fault. The computation continues."""


class DriveWarning(SigmaswarmWarning):
    """Warning of an implausible drive. ``code`` is the doctor's code of the fault."""

    def __init__(self, message: str, code: str = "") -> None:
        super().__init__(message)
        self.code = code


def warn_deprecated(old: str, new: str) -> None:
    warnings.warn(f"{old} is deprecated, use {new}", SigmaswarmWarning, stacklevel=4)


def not_installed(what: str, package: str, install: str = "") -> InputError:
    """Return the error for a missing package. ``install`` is the argument of pip, by default the package."""
    where = install or package.lower()
    return InputError(f"{what} needs {package}, which is not installed; run: pip install {where}")
