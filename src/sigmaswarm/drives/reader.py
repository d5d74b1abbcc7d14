"""Reading a drive's folder. Every fault is one sentence: file, row, column, value, what is wrong, remedy."""

import tomllib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, cast

from sigmaswarm.drives.checks import remarks_of, shortage_of
from sigmaswarm.drives.drive import Array, Drive, Gps, Imu, Odometer, Truth
from sigmaswarm.drives.sheet import CSV, FORMS, LARGEST, Sheet
from sigmaswarm.errors import DriveError, DriveWarning, SigmaswarmWarning
from sigmaswarm.geodesy import geodetic_to_enu
from sigmaswarm.limits import read_toml_text
from sigmaswarm.wording import names_shown, quoted, shown

Frame = Literal["enu", "wgs84"]
Place = tuple[float, float, float]

_POSITIONS: dict[Frame, tuple[str, str]] = {"enu": ("x", "y"), "wgs84": ("lat", "lon")}
_GPS_EXTRAS = ("alt", "std_x", "std_y", "speed", "course")

COLUMNS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "imu": (("t", "ax", "ay", "gz"), ("az", "gx", "gy")),
    "enu": (("t", "x", "y"), ("lat", "lon", *_GPS_EXTRAS)),
    "wgs84": (("t", "lat", "lon"), _GPS_EXTRAS),
    "odometer": (("t", "speed"), ()),
    "truth": (("t", "x", "y", "vx", "vy", "theta"), ("std_x", "std_y", "std_theta")),
}
"""The required and the optional columns of each table; those of gps by its frame."""

_NUMBERS: dict[str, tuple[tuple[int, ...], str]] = {
    "gps_lever_arm_m": ((2, 3), "[1.2, 0.0, 0.5]"),
    "gps_std_m": ((0,), "1.5"),
    "accel_noise_density": ((0,), "0.004"),
    "gyro_noise_density": ((0,), "0.0001"),
}
"""Keys of drive.toml that filters look at: how many numbers (0: one, and no list), and an example."""


def drive_folders(path: Path) -> list[Path]:
    """A drive folder itself, or all drive folders inside a folder, in the order of their names."""
    if not path.is_dir() or has_table(path, "imu") or has_table(path, "gps"):
        return [path]  # read_drive says what is wrong with it, if anything
    inside = sorted(folder for folder in path.iterdir() if has_table(folder, "imu"))
    if not inside:
        raise DriveError(f"{path}: holds no drive; a drive is a folder with imu.csv, gps.csv and drive.toml")
    return inside


def has_table(folder: Path, name: str) -> bool:
    """Whether a folder holds a drive's table, ``imu`` for example, in any form."""
    return any((folder / f"{name}{form}").exists() for form in FORMS)


def _table(folder: Path, name: str) -> Path:
    """The file of a drive's table; the CSV file where there is none."""
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
        The folder, or a URL that fsspec reads: s3, gs, abfs, sftp, https ... Where drive.toml gives no ``name``, the
        folder's name serves; where it gives no ``frame``, the columns of gps.csv decide.

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
    from sigmaswarm.drives.places import read_place  # which needs this file

    drive, warned = read_place(path)
    for warning in warned:
        warnings.warn(warning, stacklevel=2)
    return drive


def read_with_warnings(folder: Path) -> tuple[Drive, list[SigmaswarmWarning]]:
    """``read_drive``, whose warnings are given back: muting them would mute those of all threads (and unmute them)."""
    if not folder.is_dir():
        what = "is a file, not a folder" if folder.exists() else "does not exist"
        raise DriveError(f"{folder} {what}; name a folder that holds imu.csv, gps.csv and drive.toml")
    inside = [f.name for f in folder.iterdir() if has_table(f, "imu")]
    if inside and not has_table(folder, "imu"):
        raise DriveError(f"{folder} is no drive but holds {len(inside)}; name one of them, say {min(inside)}")
    ignored: list[str] = []
    about = _read_description(folder / "drive.toml")
    name = about.pop("name", folder.resolve().name)

    files = {name: _table(folder, name) for name in ("imu", "gps", "truth", "odometer")}
    imu = Sheet.read(files["imu"]).columns(*COLUMNS["imu"], ignored)
    sheet = Sheet.read(files["gps"])
    frame = _frame(about.pop("frame", None), files["gps"], sheet.cells.columns)
    gps = sheet.columns(*COLUMNS[frame], ignored)
    origin = about.pop("origin", None)
    if frame == "wgs84":
        origin = place_on_plane(gps, origin)
    truth = None
    if files["truth"].exists():
        truth = _truth(Sheet.read(files["truth"]).columns(*COLUMNS["truth"], ignored), files["truth"])

    odometer = None
    if files["odometer"].exists():
        odometer = Odometer(**Sheet.read(files["odometer"]).columns(*COLUMNS["odometer"], ignored))

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
    """A sentence on a drive's tables with the names that they have in its folder."""
    for name, file in files.items():
        said = said.replace(f"{name}{CSV}", file.name)
    return said


def _read_description(path: Path) -> dict[str, Any]:
    """The keys of drive.toml; ``name`` and ``origin`` are checked, ``frame`` needs gps.csv and is not yet."""
    if not path.is_file():
        raise DriveError(
            f'{path} is missing; write one with the line frame = "enu" (x, y) or frame = "wgs84" (lat, lon)'
        )
    text = _toml_text(path)
    try:
        about = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers of 5000 digits, and lists 3000 deep
        raise DriveError(
            f"{path} is not valid TOML: {shown(error, 160)}; mend that line (text needs quotes)"
        ) from None
    name = about.get("name", "unnamed")
    require_name(name, path)
    if "origin" in about:
        about["origin"] = _origin(about["origin"], path)
    for key, (lengths, example) in _NUMBERS.items():
        if key in about:
            _require_numbers(about[key], key, lengths, example, path)
    return about


def _toml_text(path: Path) -> str:
    try:
        return read_toml_text(path)
    except UnicodeDecodeError as error:
        raise DriveError(f"{path} is not valid TOML: {shown(error, 160)}; write it as UTF-8") from None
    except OSError as error:
        raise DriveError(f"{path} can't be read ({error.strerror})") from None


def require_name(name: object, where: object) -> None:
    """Refuse what can't name a drive, which also names files and folders; ``where`` it was given is told."""
    if not isinstance(name, str) or not name.strip():
        raise DriveError(
            f'{where}: name = {value_shown(name)} is not text; write for example name = "monday"'
        )
    surrogates = any("\ud800" <= c <= "\udfff" for c in name)  # bytes of a file's name that are no UTF-8
    if name in (".", "..") or set(name) & {"/", "\\", "\n", "\0"} or surrogates:
        raise DriveError(f"{where}: name = {quoted(name)} can't name a folder; leave slashes out")


def _require_numbers(value: Any, key: str, lengths: tuple[int, ...], example: str, path: Path) -> None:
    """Refuse a key of drive.toml that filters look at and can't use."""
    numbers = cast("list[Any]", value if isinstance(value, list) else [value])
    plain = all(type(v) in (int, float) and abs(v) <= LARGEST for v in numbers)
    length = len(numbers) if isinstance(value, list) else 0
    said = f"{path}: {key} = {value_shown(value)}"
    if not plain or length not in lengths or not numbers:
        raise DriveError(f"{said} can't be used; write for example {key} = {example}")
    if lengths == (0,) and not numbers[0] > 0:
        raise DriveError(f"{said} must be positive; leave it out where it is not known")


def value_shown(value: object) -> str:
    """A key's value as a message shows it; a whole number of 5000 digits has no text."""
    try:
        return shown(repr(value))
    except (ValueError, RecursionError):
        return "what stands there"


def _origin(value: Any, path: Path) -> Place:
    """A stated origin as latitude (deg), longitude (deg), altitude (m)."""
    if isinstance(value, list) and [type(v) in (int, float) for v in cast("list[Any]", value)] == [True] * 3:
        latitude, longitude, altitude = cast("list[float]", value)
        if abs(latitude) <= 90 and abs(longitude) <= 180 and abs(altitude) <= 1e7:
            return float(latitude), float(longitude), float(altitude)
    raise DriveError(
        f"{path}: origin = {value_shown(value)} is not a place; "
        "write origin = [latitude deg, longitude deg, altitude m]"
    )


def _frame(stated: Any, gps: Path, columns: Sequence[str]) -> Frame:
    """The frame of the fixes, as stated or else as the columns of their file say; both must agree."""
    description = gps.parent / "drive.toml"
    if stated not in (None, *_POSITIONS):
        raise DriveError(f'{description}: frame = {value_shown(stated)} is unknown; write "enu" or "wgs84"')
    present = [frame for frame, pair in _POSITIONS.items() if set(pair) <= set(columns)]
    if not present:
        raise DriveError(
            f"{gps}{', row 1' if gps.suffix == CSV else ''}: has neither columns x, y nor lat, lon, only "
            f"{names_shown(columns)}; name the positions x, y (m east, north) or lat, lon (deg)"
        )
    frame = cast("Frame", stated or present[0])
    if frame not in present:
        x, y = _POSITIONS[frame]
        raise DriveError(
            f'{description}: frame = "{frame}", but {gps.name} lacks columns {x}, {y}; '
            f'write frame = "{present[0]}", as its columns say'
        )
    return frame


def place_on_plane(gps: dict[str, Array], origin: Place | None) -> Place:
    """Add x and y (m) to the columns of a "wgs84" log; return the origin (deg, deg, m) they refer to."""
    if origin is None:
        altitude = float(gps["alt"][0]) if "alt" in gps else 0.0
        origin = float(gps["lat"][0]), float(gps["lon"][0]), altitude
    enu = geodetic_to_enu(gps["lat"], gps["lon"], gps.get("alt", origin[2]), origin)
    gps["x"], gps["y"] = enu[:, 0], enu[:, 1]
    return origin
