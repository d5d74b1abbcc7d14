"""Reading a drive's folder. Every fault is one sentence: file, row, column, value, what is wrong, remedy."""

import csv
import tomllib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.drives.checks import shortage_of, warnings_of
from sigmaswarm.drives.drive import Array, Drive, Gps, Imu, Truth
from sigmaswarm.errors import DriveError, SigmaswarmWarning
from sigmaswarm.geodesy import geodetic_to_enu

Frame = Literal["enu", "wgs84"]
Place = tuple[float, float, float]

_POSITIONS: dict[Frame, tuple[str, str]] = {"enu": ("x", "y"), "wgs84": ("lat", "lon")}
_GPS_EXTRAS = ("alt", "std_x", "std_y", "speed", "course")

_IMU = ("t", "ax", "ay", "gz"), ("az", "gx", "gy")
_GPS = {"enu": (("t", "x", "y"), ("lat", "lon", *_GPS_EXTRAS)), "wgs84": (("t", "lat", "lon"), _GPS_EXTRAS)}
_TRUTH = ("t", "x", "y", "vx", "vy", "theta"), ()
"""The columns of each file: the required and the optional ones."""

_NO_STD = "leave the column out where the receiver states no deviation"
_RANGES: dict[str, tuple[float, float, str]] = {
    "lat": (-90.0, 90.0, "give degrees north; perhaps lat and lon are exchanged"),
    "lon": (-180.0, 180.0, "give degrees east; take 360 off where they run from 0 to 360"),
    "std_x": (1e-6, np.inf, _NO_STD),
    "std_y": (1e-6, np.inf, _NO_STD),
}
"""Lowest and highest value allowed in a column, and the remedy."""


def read_drive(path: str | Path) -> Drive:
    """Read and validate a drive: a folder with imu.csv, gps.csv, drive.toml and perhaps truth.csv.

    Parameters
    ----------
    path : str or Path
        The folder. Where drive.toml gives no ``name``, the folder's name serves; where it gives no ``frame``,
        the columns of gps.csv decide.

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
        Unknown columns (ignored), gaps, and values that look like other units or axes.
    """
    folder = Path(path)
    if not folder.is_dir():
        what = "is a file, not a folder" if folder.exists() else "does not exist"
        raise DriveError(f"{folder} {what}; name a folder that holds imu.csv, gps.csv and drive.toml")
    remarks: list[str] = []
    about = _read_description(folder / "drive.toml")
    name = about.pop("name", folder.resolve().name)

    imu = _Sheet.read(folder / "imu.csv").columns(*_IMU, remarks)
    sheet = _Sheet.read(folder / "gps.csv")
    frame = _frame(about.pop("frame", None), folder, sheet.cells.columns)
    gps = sheet.columns(*_GPS[frame], remarks)
    origin = about.pop("origin", None)
    if frame == "wgs84":
        origin = _place_on_plane(gps, origin)
    truth = None
    if (folder / "truth.csv").exists():
        truth = Truth(**_Sheet.read(folder / "truth.csv").columns(*_TRUTH, remarks))

    drive = Drive(name, Imu(**imu), Gps(**gps), truth, frame, origin, about)
    if shortage := shortage_of(drive):
        raise DriveError(f"{folder}/{shortage}")
    for message in [*remarks, *(f"{folder}/{w}" for w in warnings_of(drive))]:
        warnings.warn(message, SigmaswarmWarning, stacklevel=2)
    return drive


def _read_description(path: Path) -> dict[str, Any]:
    """The keys of drive.toml; ``name`` and ``origin`` are checked, ``frame`` needs gps.csv and is not yet."""
    if not path.is_file():
        raise DriveError(
            f'{path} is missing; write one with the line frame = "enu" (x, y) or frame = "wgs84" (lat, lon)'
        )
    try:
        about = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DriveError(f"{path} is not valid TOML: {error}; mend that line (text needs quotes)") from None
    name = about.get("name", "unnamed")
    if not isinstance(name, str) or not name.strip():
        raise DriveError(f'{path}: name = {name!r} is not text; write for example name = "monday"')
    if "origin" in about:
        about["origin"] = _origin(about["origin"], path)
    return about


def _origin(value: Any, path: Path) -> Place:
    """A stated origin as latitude (deg), longitude (deg), altitude (m)."""
    if isinstance(value, list) and [type(v) in (int, float) for v in cast("list[Any]", value)] == [True] * 3:
        latitude, longitude, altitude = (float(v) for v in cast("list[float]", value))
        if abs(latitude) <= 90 and abs(longitude) <= 180 and np.isfinite(altitude):
            return latitude, longitude, altitude
    raise DriveError(
        f"{path}: origin = {value!r} is not a place; write origin = [latitude deg, longitude deg, altitude m]"
    )


def _frame(stated: Any, folder: Path, columns: Sequence[str]) -> Frame:
    """The frame of the fixes, as stated or else as the columns of gps.csv say; both must agree."""
    if stated not in (None, *_POSITIONS):
        raise DriveError(f'{folder / "drive.toml"}: frame = {stated!r} is unknown; write "enu" or "wgs84"')
    present = [frame for frame, pair in _POSITIONS.items() if set(pair) <= set(columns)]
    if not present:
        raise DriveError(
            f"{folder / 'gps.csv'}, row 1: has neither columns x, y nor lat, lon, only {', '.join(columns)}; "
            "name the positions x, y (m east, north) or lat, lon (deg)"
        )
    frame = cast("Frame", stated or present[0])
    if frame not in present:
        x, y = _POSITIONS[frame]
        raise DriveError(
            f'{folder / "drive.toml"}: frame = "{frame}", but gps.csv lacks columns {x}, {y}; '
            f'write frame = "{present[0]}", as its columns say'
        )
    return frame


def _place_on_plane(gps: dict[str, Array], origin: Place | None) -> Place:
    """Add x and y (m) to the columns of a "wgs84" log; return the origin (deg, deg, m) they refer to."""
    if origin is None:
        altitude = float(gps["alt"][0]) if "alt" in gps else 0.0
        origin = float(gps["lat"][0]), float(gps["lon"][0]), altitude
    enu = geodetic_to_enu(gps["lat"], gps["lon"], gps.get("alt", origin[2]), origin)
    gps["x"], gps["y"] = enu[:, 0], enu[:, 1]
    return origin


@dataclass(frozen=True)
class _Sheet:
    """A CSV file's cells, still text (None where empty), and the file's line (n,) that each row stands on."""

    path: Path
    cells: pl.DataFrame
    lines: NDArray[np.int64]

    @classmethod
    def read(cls, path: Path) -> "_Sheet":
        """Read a file whose rows all have as many cells as its header; blank lines don't count."""
        if not path.is_file():
            raise DriveError(
                f"{path} is missing; a drive needs it, with a header line and one row per sample"
            )
        try:
            cells = pl.read_csv(path, infer_schema=False)
        except pl.exceptions.NoDataError:
            raise _empty(path) from None
        except pl.exceptions.ComputeError:
            raise _shape_fault(path) from None
        filled = cells.select(~pl.all_horizontal(pl.all().is_null())).to_series().arg_true()
        if filled.is_empty():
            raise _empty(path)
        names = [
            name.strip().split("_duplicated_")[0] for name in cells.columns
        ]  # polars renames a second one
        for name in names:
            if names.count(name) > 1:
                raise DriveError(
                    f"{path}, row 1: column {name!r} appears twice; delete or rename one of them"
                )
        cells.columns = names
        return cls(path, cells[filled], filled.to_numpy() + 2)  # the header is line 1

    def columns(
        self, required: Sequence[str], optional: Sequence[str], remarks: list[str]
    ) -> dict[str, Array]:
        """The known columns as numbers, each (n,), ``t`` renamed ``time``; others only get a remark."""
        known = (*required, *optional)
        names = self.cells.columns
        for name in required:
            if name not in names:
                raise DriveError(
                    f"{self.path}, row 1: no column {name}, only {', '.join(names)}; add or rename it"
                )
        if unknown := [repr(name) for name in names if name not in known]:
            remarks.append(
                f"{self.path}: ignoring {', '.join(unknown)}; the known columns are {', '.join(known)}"
            )
        numbers = {name: self._numbers(name) for name in known if name in names}
        self._require_increasing(numbers["t"])
        return {"time" if name == "t" else name: values for name, values in numbers.items()}

    def _numbers(self, column: str) -> Array:
        """A column (n,) as finite numbers within its range."""
        text = self.cells[column].str.strip_chars()
        values = text.cast(pl.Float64, strict=False)
        if values.null_count() or not values.is_finite().all():
            i = int(values.is_finite().fill_null(False).arg_min() or 0)
            if not text[i]:
                raise _shape_fault(
                    self.path, self._fault(i, column, "is empty", "fill it in or delete the row")
                )
            raise self._fault(
                i, column, "is not a finite number", "write digits with a dot, or delete the row"
            )
        low, high, remedy = _RANGES.get(column, (-np.inf, np.inf, ""))
        within = values.is_between(low, high)
        if not within.all():
            raise self._fault(int(within.arg_min() or 0), column, f"is outside {low:g} to {high:g}", remedy)
        return values.to_numpy()

    def _require_increasing(self, time: Array) -> None:
        late = np.flatnonzero(np.diff(time) <= 0)
        if late.size:
            i = int(late[0]) + 1
            what = f"is not after {self.cells['t'][i - 1]} in row {self.lines[i - 1]}"
            raise self._fault(i, "t", what, "sort the rows by time and delete repeated ones")

    def _fault(self, i: int, column: str, what: str, remedy: str) -> DriveError:
        value = self.cells[column][i] or ""
        return DriveError(f"{self.path}, row {self.lines[i]}, column {column}: {value!r} {what}; {remedy}")


def _empty(path: Path) -> DriveError:
    return DriveError(f"{path} is empty; it needs a header line and one row per sample")


def _shape_fault(path: Path, otherwise: DriveError | None = None) -> DriveError:
    """The first row whose number of cells is not the header's, looked for only once something is wrong."""
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.reader(file)
        width = len(next(rows))
        for row in rows:
            if row and len(row) != width:
                return DriveError(
                    f"{path}, row {rows.line_num}: {','.join(row)!r} has {len(row)} cells, "
                    f"the header {width}; complete or delete the row, and write decimals with a dot"
                )
    return otherwise or DriveError(f"{path} is not comma-separated text in UTF-8; export it as that")
