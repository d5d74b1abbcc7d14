"""What was imported can be read: told by reading it, before anybody is told that there is a drive."""

import tempfile
import warnings
from pathlib import Path

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import DriveError, InputError, SigmaswarmWarning


def require_readable(drive: Drive) -> None:
    """Write a drive to a temporary folder, and read it.

    Raises
    ------
    InputError
        ``read_drive`` refuses it; the message names the file, row, column and value that it would have had.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "drive"
        try:
            write_drive(drive, folder)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SigmaswarmWarning)  # the doctor tells what only looks wrong
                read_drive(folder)
        except DriveError as error:
            said = str(error).replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")
            raise InputError(f"{drive.name}: the drive could not be read back: {said}") from None
