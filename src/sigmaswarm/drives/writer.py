"""Write the folder of a drive atomically."""

from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import polars as pl
import tomli_w

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import has_table, read_with_warnings
from sigmaswarm.drives.table_files import TABLES
from sigmaswarm.errors import DriveError
from sigmaswarm.files import atomic_folder, make_folder

Form = Literal["csv", "parquet"]
FILES = frozenset({"drive.toml", *TABLES})
"""Files of a drive. ``write_drive`` replaces a folder only if it contains no other files."""


def write_drive(drive: Drive, path: str | Path, *, overwrite: bool = False, form: Form = "csv") -> Path:
    """Write a drive as a folder from which ``read_drive`` reads identical data.

    The same drive always gives identical files. The folder is written under another name, read back and then renamed,
    so that a partial or unreadable drive is never visible.

    Parameters
    ----------
    drive : Drive
        A "wgs84" drive is written with lat, lon and alt, from which the reader computes x and y. The name is written if
        it differs from the name of the folder.
    path : str or Path
        The folder to create, including missing parents.
    overwrite : bool
        Replace an existing drive.
    form : {"csv", "parquet"}
        Format of the tables. Parquet files are smaller and read much faster; the data are identical.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    DriveError
        If the folder can't be created or replaced, or the drive has values that can't be written or that ``read_drive``
        rejects.
    """
    folder = Path(path).resolve()  # "." has no name to rename
    require_replaceable(folder, overwrite)
    contents = _contents(drive, folder, form)
    make_folder(folder.parent, "specify another folder")
    with atomic_folder(folder, replace=overwrite) as new:
        new.mkdir()
        for file, content in contents.items():
            (new / file).write_bytes(content)
        try:
            read_with_warnings(new)
        except DriveError as error:
            reason = str(error).removeprefix(f"{new}/").replace(str(new), str(folder))
            raise DriveError(f"{folder}: the drive could not be read back ({reason})") from None
    return folder


def require_replaceable(
    folder: Path, overwrite: bool, remedy: str = "delete it, or specify another folder"
) -> None:
    """Raise an error if the folder exists, unless it is empty or, with ``overwrite``, contains only a drive.

    A folder inside a drive is also refused, since the drive could no longer be replaced or copied.
    """
    if around := drive_around(folder.parent):
        raise DriveError(f"{folder} is inside the drive {around}; specify a folder outside of it")
    if not folder.exists():
        return
    if not folder.is_dir():
        raise DriveError(f"{folder} is a file; specify another folder to write the drive to")
    entries = {entry.name for entry in folder.iterdir()}
    if foreign := entries - FILES:
        raise DriveError(
            f"{folder} contains {min(foreign)!r}, which is not part of a drive; specify another folder"
        )
    if entries and not overwrite:
        raise DriveError(f"{folder} exists and is not empty; {remedy}")


def drive_around(folder: Path) -> Path | None:
    """Return the drive that an absolute path names or is in, or None if there is none."""
    places = (place for place in (folder, *folder.parents) if (place / "drive.toml").is_file())
    return next((place for place in places if has_table(place, "imu")), None)


def _contents(drive: Drive, folder: Path, form: Form) -> dict[str, bytes]:
    wgs84 = drive.frame == "wgs84"
    if wgs84 and (drive.gps.lat is None or drive.gps.lon is None or drive.origin is None):
        raise DriveError(
            f'{folder}: a drive in frame "wgs84" needs gps.lat, gps.lon and origin; set them, or frame = "enu"'
        )
    about: dict[str, Any] = {"name": drive.name, "frame": drive.frame, "origin": drive.origin}
    about |= {key: value for key, value in drive.metadata.items() if key not in about}
    if drive.origin is None:
        del about["origin"]  # TOML has no null
    if drive.name == folder.name:
        del about["name"]  # the reader uses the name of the folder, so a renamed copy has the new name
    try:
        contents = {"drive.toml": tomli_w.dumps(about).encode()}
    except TypeError as error:
        raise DriveError(
            f"{folder / 'drive.toml'}: the metadata can't be written as TOML: {error}; change this value"
        ) from None
    for name, table in drive.tables.items():
        unwritten = {"x", "y"} if wgs84 and name == "gps" else set[str]()
        columns = {k: v for k, v in vars(table).items() if v is not None and k not in unwritten}
        columns = {k: columns[k] for k in sorted(columns, key="gz".__eq__)}  # in files, gz is the last column
        frame = pl.DataFrame(columns).rename({"time": "t"})
        contents[f"{name}.{form}"] = frame.write_csv().encode() if form == "csv" else _parquet(frame)
    return contents


def _parquet(frame: pl.DataFrame) -> bytes:
    file = BytesIO()
    frame.write_parquet(file, compression="zstd", statistics=False)
    return file.getvalue()
