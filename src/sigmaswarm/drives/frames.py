"""Make the tables of a drive from arrays and data frames, with the same checks as for files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.drives.description import Frame, Origin, place_on_plane
from sigmaswarm.drives.table_files import TableFile
from sigmaswarm.drives.tables import COLUMNS, RECORDS
from sigmaswarm.errors import DriveError, SigmaswarmWarning
from sigmaswarm.wording import printable, quoted

_TIMES = ("t", "time")


def tables_from_frames(
    frames: Mapping[str, Any], renamed: Mapping[str, str], origin: Origin | None
) -> tuple[dict[str, Any], dict[str, Any], list[SigmaswarmWarning]]:
    """Return tables, other arguments of `Drive`, and warnings about ignored columns."""
    arrays = {name: _columns_of(frame, name, renamed) for name, frame in frames.items()}
    start = _to_seconds(arrays)
    frame: Frame = "wgs84" if "x" not in arrays["gps"] else "enu"
    records: dict[str, Any] = {}
    ignored: list[str] = []
    for name, table in arrays.items():
        required, optional = COLUMNS[frame if name == "gps" else name]
        known, rows = (*required, *optional), len(table.get("t", ()))
        cells = {k: _numbers(v, name, k) if k in known else np.zeros(len(v)) for k, v in table.items()}
        whole = pl.DataFrame(cells if "t" in table else dict.fromkeys(table, ()))
        columns = TableFile(Path(name), whole, np.arange(rows)).columns(required, optional, ignored)
        if name == "gps" and frame == "wgs84":
            origin = place_on_plane(columns, origin)
        records[name] = RECORDS[name](**columns)
    metadata = {} if start is None else {"time_origin_s": start}
    about = {"frame": frame, "origin": origin, "metadata": metadata}
    return records, about, [SigmaswarmWarning(message) for message in ignored]


def _columns_of(table: Any, name: str, renamed: Mapping[str, str]) -> dict[str, NDArray[Any]]:
    """Return the columns (n,) under the names that a drive uses. A pandas index of times becomes a column."""
    if isinstance(table, str | Path):
        raise DriveError(f"{name} is a path, {quoted(str(table))}; read it with read_drive or import_log")
    if not hasattr(table, "keys") and not hasattr(table, "columns"):
        raise DriveError(f"{name} is a {type(table).__name__}; pass a data frame or a mapping of columns")
    keys = table.keys() if isinstance(table, Mapping) else table.columns
    columns = {renamed.get(str(key), str(key)): _values(table[key]) for key in keys}
    time = next((key for key in _TIMES if key in columns), None)
    if time is not None:
        columns["t"] = columns.pop(time)
    elif hasattr(table, "iloc"):  # pandas: times often are the index
        index = cast("Any", table).index
        dated = index.dtype.kind == "M" or hasattr(index.dtype, "tz")
        if dated or renamed.get(index.name, index.name) in _TIMES:
            columns["t"] = _values(index.to_series())
    if "t" in columns:
        rows = np.shape(columns["t"])
        for key, values in columns.items():
            if values.ndim != 1 or values.shape != rows:
                what = f"column {quoted(key)} has shape {values.shape}, but the times have shape {rows}"
                raise DriveError(f"{name}: {what}; pass arrays of one dimension and equal length")
    return columns


def _values(column: Any) -> NDArray[Any]:
    """Convert a column to an array. Times with a time zone become UTC."""
    if getattr(getattr(column, "dtype", None), "tz", None) is not None:  # pandas would return objects
        column = column.dt.tz_convert("UTC").dt.tz_localize(None)
    return np.asarray(column.to_numpy() if hasattr(column, "to_numpy") else column)


def _to_seconds(tables: dict[str, dict[str, NDArray[Any]]]) -> float | None:
    """Replace dates by seconds since the first IMU sample. Return the Unix time of this sample (s) or None.

    Unix time as float64 has a resolution of 0.2 us; seconds since the first sample are exact.
    """
    dated = {key for key, table in tables.items() if "t" in table and table["t"].dtype.kind == "M"}
    if not dated:
        return None
    if plain := [key for key in tables if key not in dated]:
        raise DriveError(
            f"{plain[0]}: times are {tables[plain[0]]['t'].dtype if 't' in tables[plain[0]] else 'missing'}, but "
            f"those of {min(dated)} are dates; use dates in all tables, or seconds of one clock in all"
        )
    start = tables["imu"]["t"][0].astype("datetime64[ns]")
    for table in tables.values():
        since = (table["t"].astype("datetime64[ns]") - start).astype(np.float64) * 1e-9
        table["t"] = np.where(np.isnat(table["t"]), np.nan, since)
    return float(start.astype(np.int64)) * 1e-9


def _numbers(values: NDArray[Any], name: str, column: str) -> NDArray[np.float64]:
    if values.dtype.kind == "m":
        values = values / np.timedelta64(1, "s")
    plain = values.dtype.kind == "O" and all(v is None or isinstance(v, int | float) for v in values.tolist())
    if values.dtype.kind not in "fiub" and not plain:
        raise DriveError(
            f"{name}: column {column} contains {printable(values.dtype)}, not numbers; convert it to float64"
        )
    return values.astype(np.float64)
