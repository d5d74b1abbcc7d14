"""Reading a drive from a folder or a URL. Every fault is one sentence: file, row, column, value, fault, remedy."""

import warnings
from collections.abc import Iterable
from pathlib import Path

from sigmaswarm.drives.checks import remarks_of, shortage_of
from sigmaswarm.drives.description import Origin, frame_of, read_description
from sigmaswarm.drives.drive import Array, Drive, Gps, Imu, Odometer, Truth
from sigmaswarm.drives.table_files import CSV, FORMS, TableFile
from sigmaswarm.drives.urls import drive_urls, is_url, local_copy, without_secrets
from sigmaswarm.errors import DriveError, DriveWarning, SigmaswarmWarning
from sigmaswarm.geodesy import geodetic_to_enu

Location = str | Path
"""A folder, or a URL that fsspec reads."""

_GPS_EXTRAS = ("alt", "std_x", "std_y", "speed", "course")

COLUMNS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "imu": (("t", "ax", "ay", "gz"), ("az", "gx", "gy")),
    "enu": (("t", "x", "y"), ("lat", "lon", *_GPS_EXTRAS)),
    "wgs84": (("t", "lat", "lon"), _GPS_EXTRAS),
    "odometer": (("t", "speed"), ()),
    "truth": (("t", "x", "y", "vx", "vy", "theta"), ("std_x", "std_y", "std_theta")),
}
"""The required and the optional columns of each table; those of gps by its frame."""


def drive_locations(location: Location) -> list[Location]:
    """Return a drive itself, or all drives in a folder or below a URL, sorted by name.

    Raises
    ------
    DriveError
        If a folder contains no drive, or a URL can't be listed.
    """
    return [*drive_urls(str(location))] if is_url(location) else [*drive_folders(Path(location))]


def all_drive_locations(locations: Iterable[Location]) -> list[Location]:
    """Return the drives of several folders and URLs."""
    return [drive for location in locations for drive in drive_locations(location)]


def drive_folders(path: Path) -> list[Path]:
    """Return a drive folder itself, or all drive folders inside a folder, sorted by name."""
    if not path.is_dir() or has_table(path, "imu") or has_table(path, "gps"):
        return [path]  # read_drive reports its faults
    inside = sorted(folder for folder in path.iterdir() if has_table(folder, "imu"))
    if not inside:
        raise DriveError(f"{path}: holds no drive; a drive is a folder with imu.csv, gps.csv and drive.toml")
    return inside


def has_table(folder: Path, name: str) -> bool:
    """Return whether a folder contains a table, such as ``imu``, in any format."""
    return any((folder / f"{name}{form}").exists() for form in FORMS)


def _table(folder: Path, name: str) -> Path:
    """Return the file of a table; that of CSV if there is none."""
    there = [folder / f"{name}{form}" for form in FORMS if (folder / f"{name}{form}").exists()]
    if len(there) > 1:
        raise DriveError(f"{folder} holds both {there[0].name} and {there[1].name}; delete one of them")
    return there[0] if there else folder / f"{name}{CSV}"


def read_drive(path: str | Path) -> Drive:
    """Read and validate a drive: a folder with imu.csv, gps.csv, drive.toml, perhaps odometer.csv, truth.csv.

    Each of the tables may be a Parquet file instead, with the same columns: imu.parquet.

    Parameters
    ----------
    path : str or Path
        The folder, or a URL that fsspec reads: s3, gs, abfs, sftp, https ... Without a ``name`` in drive.toml, the name
        is that of the folder; without a ``frame``, the columns of gps.csv decide.

    Returns
    -------
    Drive
        Fixes of a "wgs84" drive are in m too, about its ``origin``: the one in drive.toml, else the
        first fix. Without a column ``alt`` they count as level with the origin. Keys of drive.toml other than
        name, frame and origin are ``metadata``.

    Raises
    ------
    DriveError
        The folder, a file, a cell or a key is unusable; one line says where, why and what to do.

    Warns
    -----
    SigmaswarmWarning
        Unknown columns (ignored).
    DriveWarning
        Gaps, and values that look like other units or axes.
    """
    drive, warned = read_with_warnings(path)
    for warning in warned:
        warnings.warn(warning, stacklevel=2)
    return drive


def read_with_warnings(location: Location) -> tuple[Drive, list[SigmaswarmWarning]]:
    """Read a drive and return its warnings: `warnings.catch_warnings` would act on all threads."""
    if not is_url(location):
        return _read_folder(Path(location))
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


def _read_folder(folder: Path) -> tuple[Drive, list[SigmaswarmWarning]]:
    if not folder.is_dir():
        what = "is a file, not a folder" if folder.exists() else "does not exist"
        raise DriveError(f"{folder} {what}; name a folder that holds imu.csv, gps.csv and drive.toml")
    inside = [f.name for f in folder.iterdir() if has_table(f, "imu")]
    if inside and not has_table(folder, "imu"):
        raise DriveError(f"{folder} is no drive but holds {len(inside)}; name one of them, say {min(inside)}")
    ignored: list[str] = []
    about = read_description(folder / "drive.toml")
    name = about.pop("name", folder.resolve().name)

    files = {name: _table(folder, name) for name in ("imu", "gps", "truth", "odometer")}
    imu = TableFile.read(files["imu"]).columns(*COLUMNS["imu"], ignored)
    table = TableFile.read(files["gps"])
    frame = frame_of(about.pop("frame", None), files["gps"], table.cells.columns)
    gps = table.columns(*COLUMNS[frame], ignored)
    origin = about.pop("origin", None)
    if frame == "wgs84":
        origin = place_on_plane(gps, origin)
    truth = None
    if files["truth"].exists():
        truth = _truth(TableFile.read(files["truth"]).columns(*COLUMNS["truth"], ignored), files["truth"])

    odometer = None
    if files["odometer"].exists():
        odometer = Odometer(**TableFile.read(files["odometer"]).columns(*COLUMNS["odometer"], ignored))

    drive = Drive(name, Imu(**imu), Gps(**gps), truth, frame, origin, about, odometer)
    if shortage := shortage_of(drive):
        raise DriveError(f"{folder}/{_as_filed(shortage, files)}")
    warned = [SigmaswarmWarning(message) for message in ignored]
    warned += [
        DriveWarning(f"{folder}/{_as_filed(str(remark), files)}", remark.code) for remark in remarks_of(drive)
    ]
    return drive, warned


def _truth(columns: dict[str, Array], path: Path) -> Truth:
    try:
        return Truth(**columns)
    except DriveError as error:
        raise DriveError(f"{path}: {error}") from None


def _as_filed(said: str, files: dict[str, Path]) -> str:
    """Replace the names of tables in a message by those of the files."""
    for name, file in files.items():
        said = said.replace(f"{name}{CSV}", file.name)
    return said


def place_on_plane(gps: dict[str, Array], origin: Origin | None) -> Origin:
    """Add x and y (m) to the columns of a "wgs84" log; return the origin (deg, deg, m) they refer to."""
    if origin is None:
        altitude = float(gps["alt"][0]) if "alt" in gps else 0.0
        origin = float(gps["lat"][0]), float(gps["lon"][0]), altitude
    enu = geodetic_to_enu(gps["lat"], gps["lon"], gps.get("alt", origin[2]), origin)
    gps["x"], gps["y"] = enu[:, 0], enu[:, 1]
    return origin
