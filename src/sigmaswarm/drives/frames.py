"""Drives from arrays and data frames: the columns of a drive's files, checked in the same way."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.checks import remarks_of, shortage_of
from sigmaswarm.drives.description import Frame, Origin
from sigmaswarm.drives.drive import Array, Drive, Gps, Imu, Odometer, Truth
from sigmaswarm.drives.reader import COLUMNS, place_on_plane
from sigmaswarm.drives.table_files import RANGES, leap
from sigmaswarm.errors import DriveError, DriveWarning, SigmaswarmWarning
from sigmaswarm.wording import names_shown, quoted, shown

Table = Any
"""A pandas or polars data frame, or a mapping of column names to arrays of one length."""

_SORT = "sort the rows by time and drop repeated times"
_TIMES = ("t", "time")


def drive_from_tables(
    imu: Table,
    gps: Table,
    truth: Table | None = None,
    odometer: Table | None = None,
    *,
    name: str = "drive",
    origin: Origin | None = None,
    columns: Mapping[str, str] | None = None,
) -> Drive:
    """Make a drive of tables in memory; ``Drive.from_frames`` documents the parameters."""
    given = {"imu": imu, "gps": gps, "truth": truth, "odometer": odometer}
    tables = {
        key: _columns_of(table, key, columns or {}) for key, table in given.items() if table is not None
    }
    start = _to_seconds(tables)
    frame: Frame = "wgs84" if "x" not in tables["gps"] else "enu"
    known = {
        "imu": COLUMNS["imu"],
        "gps": COLUMNS[frame],
        "truth": COLUMNS["truth"],
        "odometer": COLUMNS["odometer"],
    }
    numbers = {key: _checked(table, key, *known[key]) for key, table in tables.items()}
    if frame == "wgs84":
        origin = place_on_plane(numbers["gps"], origin)
    drive = Drive(
        name,
        Imu(**numbers["imu"]),
        Gps(**numbers["gps"]),
        Truth(**numbers["truth"]) if "truth" in numbers else None,
        frame,
        origin,
        {} if start is None else {"time_origin_s": start},
        Odometer(**numbers["odometer"]) if "odometer" in numbers else None,
    )
    if shortage := shortage_of(drive):
        raise DriveError(f"{name}: {shortage.replace('.csv', '')}")
    for remark in remarks_of(drive):
        warnings.warn(DriveWarning(f"{name}: {str(remark).replace('.csv', '')}", remark.code), stacklevel=3)
    return drive


def _columns_of(table: Table, name: str, renamed: Mapping[str, str]) -> dict[str, NDArray[Any]]:
    """The columns of a table (n,), under a drive's names; a pandas index that holds times is a column, too."""
    if isinstance(table, str | Path):
        raise DriveError(f"{name} is a path, {quoted(str(table))}; read it with read_drive or import_log")
    if not hasattr(table, "keys") and not hasattr(table, "columns"):
        raise DriveError(f"{name} is a {type(table).__name__}; give a data frame or a mapping of columns")
    found = {
        str(key): _values(table[key])
        for key in (table.keys() if isinstance(table, Mapping) else table.columns)
    }
    found = {renamed.get(key, key): values for key, values in found.items()}
    time = next((key for key in _TIMES if key in found), None)
    if time is None and hasattr(table, "iloc"):  # pandas: times often are the index
        index = cast("Any", table).index
        if (
            index.dtype.kind == "M"
            or hasattr(index.dtype, "tz")
            or renamed.get(index.name, index.name) in _TIMES
        ):
            found["t"] = _values(index.to_series())
    elif time is not None:
        found["t"] = found.pop(time)
    rows = np.shape(found["t"]) if "t" in found else (0,)
    for key, values in found.items():
        if "t" in found and (values.ndim != 1 or values.shape != rows):
            what = f"column {quoted(key)} has shape {values.shape}, the times {rows}"
            raise DriveError(f"{name}: {what}; give arrays of one dimension and equal length")
    return found


def _values(column: Any) -> NDArray[Any]:
    """A column as an array; times with a zone become UTC."""
    if getattr(getattr(column, "dtype", None), "tz", None) is not None:  # pandas would give objects
        column = column.dt.tz_convert("UTC").dt.tz_localize(None)
    return np.asarray(column.to_numpy() if hasattr(column, "to_numpy") else column)


def _to_seconds(tables: dict[str, dict[str, NDArray[Any]]]) -> float | None:
    """Replace dates by seconds since the first IMU sample; return that sample's Unix time, s, or None.

    Seconds since 1970 as float64 resolve no better than 0.2 us; since the first sample they are exact.
    """
    dated = {key for key, table in tables.items() if "t" in table and table["t"].dtype.kind == "M"}
    if not dated:
        return None
    if plain := [key for key in tables if key not in dated]:
        raise DriveError(
            f"{plain[0]}: times are {tables[plain[0]]['t'].dtype if 't' in tables[plain[0]] else 'missing'}, but "
            f"those of {min(dated)} are dates; give all tables dates, or all of them seconds of one clock"
        )
    start = tables["imu"]["t"][0].astype("datetime64[ns]")
    for table in tables.values():
        since = (table["t"].astype("datetime64[ns]") - start).astype(np.float64) * 1e-9
        table["t"] = np.where(np.isnat(table["t"]), np.nan, since)
    return float(start.astype(np.int64)) * 1e-9


def _checked(
    table: dict[str, NDArray[Any]], name: str, required: tuple[str, ...], optional: tuple[str, ...]
) -> dict[str, Array]:
    """The known columns as finite numbers within their ranges, times increasing; a warning names the others."""
    for column in required:
        if column not in table:
            raise DriveError(
                f"{name}: no column {column}, only {names_shown(list(table))}; add it, or rename one with "
                f"columns={{'its name': '{column}'}}"
            )
    known = (*required, *optional)
    if unknown := [column for column in table if column not in known]:
        ignored = names_shown(unknown, "'")
        what = f"{name}: ignoring {ignored}; the known columns are {', '.join(known)}"
        warnings.warn(SigmaswarmWarning(what), stacklevel=4)
    numbers = {column: _numbers(table[column], name, column) for column in known if column in table}
    time = numbers.pop("t")
    late = np.flatnonzero(np.diff(time) <= 0)
    if late.size:
        i = int(late[0]) + 1
        raise DriveError(
            f"{name}, row {i}: t = {time[i]:.9g} s is not after {time[i - 1]:.9g} s in row {i - 1}; {_SORT}"
        )
    if i := leap(time):
        what = f"t = {time[i]:.9g} s lies absurdly far after {time[i - 1]:.9g} s in row {i - 1}"
        raise DriveError(f"{name}, row {i}: {what}; drop the row with the damaged time")
    return {"time": time, **numbers}


def _numbers(values: NDArray[Any], name: str, column: str) -> Array:
    """A column (n,) as finite float64 within its range."""
    if values.dtype.kind == "m":
        values = values / np.timedelta64(1, "s")
    where = f"{name}: column {column}"
    if values.dtype.kind not in "fiub" and not (values.dtype.kind == "O" and _all_numbers(values)):
        raise DriveError(f"{where} holds {shown(values.dtype)}, not numbers; convert it to float64")
    numbers = values.astype(np.float64)
    if len(bad := np.flatnonzero(~np.isfinite(numbers))):
        rows = f"row {bad[0]}" if len(bad) == 1 else f"{len(bad)} rows, the first row {bad[0]},"
        remedy = f"drop such rows, as with dropna(subset=['{column}'])"
        raise DriveError(f"{where}: {rows} {'is' if len(bad) == 1 else 'are'} not finite; {remedy}")
    low, high, remedy = RANGES.get(column, (-np.inf, np.inf, ""))
    if len(bad := np.flatnonzero((numbers < low) | (numbers > high))):
        value = numbers[bad[0]]
        raise DriveError(f"{where}, row {bad[0]}: {value:g} is outside {low:g} to {high:g}; {remedy}")
    return numbers


def _all_numbers(values: NDArray[Any]) -> bool:
    return all(v is None or isinstance(v, int | float) for v in cast("list[Any]", values.tolist()))
