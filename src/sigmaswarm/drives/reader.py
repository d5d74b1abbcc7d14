"""Read a drive from a folder or a URL. Each error is one sentence: file, row, column, value, fault, remedy."""

import re
import warnings
from collections.abc import Iterable
from pathlib import Path
from shlex import quote
from typing import Any

from sigmaswarm.drives.checks import check_tables
from sigmaswarm.drives.description import (
    WRITE_IT,
    frame_of,
    ineffective_keys,
    place_on_plane,
    read_description,
)
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.table_files import CSV, FORMS, TableFile
from sigmaswarm.drives.tables import COLUMNS, RECORDS
from sigmaswarm.drives.urls import A_DRIVE, drive_urls, is_url, local_copy, without_secrets
from sigmaswarm.errors import DriveError, SigmaswarmWarning
from sigmaswarm.wording import count_of

Location = str | Path
TEXTS = (".csv", ".tsv", ".txt")
# Words that show the content of a table, in its name or first line
_AXES = re.compile(r"(?<![a-z])[ag]_?[xyz](?![a-z])", re.IGNORECASE)
_MOTION = re.compile(r"acc(?!urac)|gyro|angular|imu", re.IGNORECASE)
_PLACE = re.compile(r"lat|lon|gps|gnss|east|north|utm|posi", re.IGNORECASE)
_XY = re.compile(r"(?<![a-z])[xy](?![a-z])", re.IGNORECASE)


def all_drive_locations(locations: Iterable[Location]) -> list[Location]:
    """Return the given drives, and all drives in given folders or below given URLs, sorted by name."""
    return [
        drive
        for location in locations
        for drive in (drive_urls(str(location)) if is_url(location) else drive_folders(Path(location)))
    ]


def drive_folders(path: Path) -> list[Path]:
    """Return the folder if it is a drive, otherwise all drive folders in it, sorted by name."""
    if not path.is_dir() or has_table(path, "imu") or has_table(path, "gps"):
        return [path]  # read_drive reports its faults
    inside = sorted(folder for folder in path.iterdir() if has_table(folder, "imu"))
    if not inside:
        raise _no_drive(path)
    return inside


def _no_drive(path: Path) -> DriveError:
    remedy = f"{A_DRIVE}; {import_remedy(path)}" if any(path.iterdir()) else A_DRIVE
    return DriveError(f"{path}: contains no drive; {remedy}")


def has_table(folder: Path, table: str) -> bool:
    return bool(_files_of(folder, table))


def table_file(folder: Path, table: str) -> Path:
    return _files_of(folder, table)[0]


def _files_of(folder: Path, table: str) -> list[Path]:
    return [folder / f"{table}{form}" for form in FORMS if (folder / f"{table}{form}").exists()]


def read_drive(path: str | Path) -> Drive:
    """Read and validate a drive: a folder with imu.csv, gps.csv, drive.toml, optionally odometer.csv, truth.csv.

    Each table may also be a Parquet file with the same columns, such as imu.parquet.

    Parameters
    ----------
    path : str or Path
        The folder, or a URL that fsspec reads: s3, gs, abfs, sftp, https ... Without a ``name`` in drive.toml, the name
        is the folder's name; without a ``frame``, the frame follows from the columns of gps.csv.

    Returns
    -------
    Drive
        Fixes of a "wgs84" drive are also converted to m, relative to the ``origin`` of drive.toml or to the first fix.
        Without a column ``alt`` the origin's altitude is used. Keys other than name, frame and origin are ``metadata``.

    Raises
    ------
    DriveError
        If the folder, a file, a cell or a key is unusable. The message states place, fault and remedy.

    Warns
    -----
    SigmaswarmWarning
        For unknown columns, and for keys of drive.toml that have no effect.
    DriveWarning
        For gaps, and values that suggest other units or axes.
    """
    drive, warned = read_with_warnings(path)
    for warning in warned:
        warnings.warn(warning, stacklevel=2)
    return drive


def read_with_warnings(location: Location) -> tuple[Drive, list[SigmaswarmWarning]]:
    """Read a drive. Return the drive and its warnings, since `warnings.catch_warnings` would affect all threads."""
    if not is_url(location):
        folder, about = Path(location), Path(location) / "drive.toml"
        if folder.is_dir() and not (about.exists() or _drives_in(folder)) and any(folder.iterdir()):
            if not (has_table(folder, "imu") or has_table(folder, "gps")):
                raise _no_drive(folder)
            own = f"if the tables in the folder have the columns of a drive, {WRITE_IT}"
            raise DriveError(f"{about} is missing; {import_remedy(folder)}; {own}")
        return _read_folder(folder)
    url = str(location).rstrip("/")
    with local_copy(url) as folder:

        def with_url(message: object) -> str:
            return str(message).replace(str(folder), without_secrets(url))

        try:
            drive, warned = _read_folder(folder)
        except DriveError as error:
            raise type(error)(with_url(error)) from None
    for warning in warned:
        warning.args = (with_url(warning),)
    return drive, warned


def _drives_in(folder: Path) -> list[str]:
    return [f.name for f in folder.iterdir() if has_table(f, "imu")]


def _read_folder(folder: Path) -> tuple[Drive, list[SigmaswarmWarning]]:
    if not folder.is_dir():
        if folder.is_file():
            place = folder.parent
            remedy = (
                f"specify the folder {place}" if (place / "drive.toml").exists() else import_remedy(folder)
            )
            raise DriveError(f"{folder} is a file, not a folder; {A_DRIVE}; {remedy}")
        raise DriveError(
            f"{folder} does not exist; specify a folder that contains imu.csv, gps.csv and drive.toml"
        )
    inside = _drives_in(folder)
    if inside and not has_table(folder, "imu"):
        raise DriveError(
            f"{folder} is not a drive but contains {count_of(len(inside), 'drive')}; specify one of them, for "
            f"example {min(inside)}"
        )
    about = read_description(folder / "drive.toml")
    name = about.pop("name", folder.resolve().name)
    stated, origin = about.pop("frame", None), about.pop("origin", None)
    files: dict[str, Path] = {}
    for table in RECORDS:
        there = _files_of(folder, table)
        if len(there) > 1:
            raise DriveError(
                f"{folder} contains both {there[0].name} and {there[1].name}; delete one of them"
            )
        files[table] = there[0] if there else folder / f"{table}{CSV}"

    frame, records, ignored = "enu", dict[str, Any](), list[str]()
    for table, file in files.items():
        if table not in ("imu", "gps") and not file.exists():
            continue
        cells = TableFile.read(file)
        if table == "gps":
            frame = frame_of(stated, file, cells.cells.columns)
        columns = cells.columns(*COLUMNS[frame if table == "gps" else table], ignored)
        if table == "gps" and frame == "wgs84":
            origin = place_on_plane(columns, origin)
        try:
            records[table] = RECORDS[table](**columns)
        except DriveError as error:
            raise DriveError(f"{file}: {error}") from None

    def as_filed(message: str) -> str:
        for table, file in files.items():
            message = message.replace(f"{table}{CSV}", file.name)
        return f"{folder}/{message}"

    drive = Drive(name, frame=frame, origin=origin, metadata=about, **records)
    ignored += ineffective_keys(about, folder / "drive.toml")
    warned = [SigmaswarmWarning(message) for message in ignored]
    return drive, [*warned, *check_tables(drive.imu, drive.gps, drive.truth, as_filed)]


def import_remedy(log: Path) -> str:
    """Return, as the remedy of an error, the command that imports a log or its whole folder."""
    log = _whole_log(log)
    out = Path("drives") / log.resolve().name.removesuffix(log.suffix)
    return f"to make a drive from a log: sigmaswarm import {quote(str(log))} --out {quote(str(out))}"


def _whole_log(file: Path) -> Path:
    """Return a file, or its folder if the file contains only IMU samples or only fixes and the folder contains both."""
    if file.suffix.lower() not in TEXTS or not file.is_file():
        return file
    tables = [table for table in sorted(file.parent.iterdir()) if table.suffix.lower() in TEXTS]
    content = {table: _content(table) for table in tables[:100]}
    together = {kind for names in content.values() for kind in names}
    return file.parent if len(content.get(file, ())) == 1 and len(together) == 2 else file


def _content(table: Path) -> set[str]:
    """Return the sensors ("imu", "gps") that the name and the first line of a table indicate."""
    with table.open(encoding="utf-8", errors="replace") as lines:
        title = lines.readline(4096)
    text = f"{table.stem},{title}"
    axes = _AXES.search(title) is not None
    imu = axes or _MOTION.search(text) is not None
    # x and y are axes of the IMU, unless the table has other columns for the axes
    gps = _PLACE.search(text) is not None or (_XY.search(title) is not None and (axes or not imu))
    return {kind for kind, present in (("imu", imu), ("gps", gps)) if present}
