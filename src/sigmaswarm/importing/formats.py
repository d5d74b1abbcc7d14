"""The formats that can be read: one file and one line each, in the order in which they are looked for."""

import difflib
from contextlib import AbstractContextManager
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.source import Source, first_bytes
from sigmaswarm.limits import require_regular, require_text

READERS: dict[str, tuple[str, str]] = {
    "mcap": ("mcap", "an MCAP file: ROS 1, ROS 2 or JSON messages"),
    "ros": ("ros", "a ROS 1 bag, or a ROS 2 bag's folder or file"),
    "kitti": ("kitti", "a drive of KITTI raw, its OXTS texts"),
    "nclt": ("nclt", "a session of NCLT"),
    "comma2k19": ("comma2k19", "a segment of comma2k19"),
    "rtklib": ("rtklib", "a solution of RTKLIB, .pos: fixes or truth"),
    "ubx": ("ubx", "u-blox UBX with NAV-PVT: fixes"),
    "nmea": ("nmea", "NMEA 0183 sentences: fixes"),
    "px4": ("px4", "a flight log of PX4, .ulg"),
    "sensor-logger": ("sensor_logger", "Sensor Logger's export, a folder or .zip"),
    "phyphox": ("phyphox", "phyphox's export as CSV, a folder or .zip"),
    "gnss-logger": ("gnss_logger", "a text of Android's GnssLogger"),
    "csv": ("columns", "CSV or Parquet, a file or a folder of them"),
}
"""By the name for --format: the module in ``readers/``, and what it reads. The most general one comes last."""


_TEXTS = ("rtklib", "nmea", "gnss-logger", "csv")


class Reader(Protocol):
    """What a module in ``readers/`` has."""

    def recognizes(self, path: Path) -> bool:
        """Whether a file or folder looks like the format, by its name or first bytes; needs no library."""
        ...

    def open_log(self, path: Path, limits: Limits) -> AbstractContextManager[Source]:
        """Open the log; InputError where it is broken, or the format's library is missing."""
        ...


def open_log(
    path: Path, form: str | None = None, limits: Limits | None = None
) -> AbstractContextManager[Source]:
    """Open a log of a format that is named, or found out by looking.

    Raises
    ------
    InputError
        Nothing is there, it is empty, or no format fits.
    """
    if not path.exists():
        raise InputError(f"{path} does not exist; name a log file or its folder")
    if path.is_file() and not path.stat().st_size:
        raise InputError(f"{path} is empty; copy the log again")
    require_regular(path)
    form = form or format_of(path)
    for text in _texts(path, form):
        require_text(text)
    return _reader(form).open_log(path, limits or Limits())


def _texts(path: Path, form: str) -> list[Path]:
    """The texts in a log that are read line by line or by polars, which would take any line or unpack any size."""
    if path.is_file():
        return [path] if form in _TEXTS and first_bytes(path, 4) != b"PAR1" else []
    inside = path.rglob("*") if form in ("kitti", "comma2k19") else path.iterdir()
    for file in (files := sorted(file for file in inside if file.suffix.lower() in (".csv", ".tsv", ".txt"))):
        require_regular(file)
    return [file for file in files if file.is_file() and first_bytes(file, 4) != b"PAR1"]


def format_of(path: Path) -> str:
    """The name of the format that a log is in."""
    for name in READERS:
        if _reader(name).recognizes(path):
            return name
    raise InputError(
        f"{path}: is of no format that is known here; name it with --format: {', '.join(READERS)}"
    )


def _reader(name: str) -> Reader:
    if name not in READERS:
        near = difflib.get_close_matches(name, READERS, 1)
        hint = f"perhaps {near[0]}" if near else f"there are {', '.join(READERS)}"
        raise InputError(f"--format {name!r} is unknown; {hint}")
    return cast("Reader", import_module(f"sigmaswarm.importing.readers.{READERS[name][0]}"))
