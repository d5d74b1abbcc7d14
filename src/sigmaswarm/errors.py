"""What can go wrong, each as one sentence that says where and what to do."""


class SigmaswarmError(Exception):
    """Base of every error that this library raises on purpose."""


class InputError(SigmaswarmError, ValueError):
    """Something the user handed in can't be used: a file, a value, an option."""


class DriveError(InputError):
    """A drive's folder or record is unusable; the message names file, row, column, value and remedy."""


class AlignmentError(DriveError):
    """The drive never moves far enough for a filter to find its heading."""


class SigmaswarmWarning(UserWarning):
    """Something looks wrong, but work goes on."""


class DriveWarning(SigmaswarmWarning):
    """A drive looks implausible; ``code`` is the doctor's for that fault, and ``doctor`` looks closer."""

    def __init__(self, said: str, code: str = "") -> None:
        super().__init__(said)
        self.code = code
