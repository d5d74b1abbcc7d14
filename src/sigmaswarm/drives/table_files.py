"""Read one table of a drive, CSV or Parquet, and locate its errors."""

import csv
import mmap
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import IMU_AXES, RECORDS
from sigmaswarm.errors import DriveError
from sigmaswarm.file_sizes import MAX_CELLS, MAX_COLUMNS, require_regular, require_text
from sigmaswarm.wording import list_names, printable, quoted

MAX_VALUE = 1e7  # largest accepted magnitude; values of a car's sensors are smaller, even in mm, mg or mdeg/s
_METERS = "convert it to meters from a nearby origin"
_NO_STD = "omit the column if no standard deviation is stated"
_DAMAGED = "the value is damaged or in a wrong unit; delete the row or correct the unit"
# Lowest and highest allowed value of a column, and the remedy.
RANGES: dict[str, tuple[float, float, str]] = {
    "lat": (-90.0, 90.0, "convert it to degrees north; lat and lon may be exchanged"),
    "alt": (-MAX_VALUE, MAX_VALUE, "convert it to meters above the ellipsoid"),
    "lon": (-180.0, 180.0, "convert it to degrees east; subtract 360 if the values are between 0 and 360"),
    **dict.fromkeys(("x", "y"), (-MAX_VALUE, MAX_VALUE, _METERS)),
    **dict.fromkeys(("std_x", "std_y", "std_heading"), (1e-6, MAX_VALUE, _NO_STD)),
    "std_theta": (1e-9, MAX_VALUE, _NO_STD),
    **dict.fromkeys(
        (*IMU_AXES, "speed", "course", "heading", "vx", "vy", "theta"), (-MAX_VALUE, MAX_VALUE, _DAMAGED)
    ),
}

# Longest allowed interval, in median intervals: 300 years at 100 Hz. The jump of a clock that is set is shorter.
_LONGEST_LEAP = 1e12

CSV, PARQUET = FORMS = ".csv", ".parquet"
TABLES = tuple(f"{name}{form}" for name in RECORDS for form in FORMS)

POLARS_ERRORS = (pl.exceptions.PolarsError, pl.exceptions.PanicException)  # for damaged tables


def one_file(path: Path) -> dict[str, Any]:
    """Return arguments with which polars' readers take a file name such as run[1].csv literally, not as a pattern."""
    return {"source": path.absolute(), "glob": False}


@dataclass(frozen=True)
class TableFile:
    """The cells of a table, and the number of each row (n,), from 1: line of a CSV file, or row of a Parquet file.

    If all cells of a CSV file are finite numbers, they are stored as numbers, which need a fifth of the memory of
    texts. Otherwise they are stored as texts (None if empty) for messages to quote. A table in memory has a name
    instead of a path, and its rows are numbered from 0.
    """

    path: Path
    cells: pl.DataFrame
    lines: NDArray[np.int64]

    @classmethod
    def read(cls, path: Path) -> "TableFile":
        """Read a file. Rows of a CSV file must have as many cells as the header. Blank lines are ignored."""
        require_regular(path)
        if not path.is_file():
            raise DriveError(
                f"{path} is missing; a drive needs this table, as CSV with a header line and one row per sample, "
                "or as Parquet"
            )
        if path.suffix == PARQUET:
            cells = _parquet(path)
            return cls(path, cells, np.arange(1, len(cells) + 1))
        head, lines = require_text(path)
        _require_size(path, lines, head.count(b",") + 1)
        cells = _plain_numbers(path)
        return cls._text(path) if cells is None else cls(path, cells, np.arange(2, len(cells) + 2))

    @classmethod
    def _text(cls, path: Path) -> "TableFile":
        try:
            cells = pl.read_csv(**one_file(path), infer_schema=False)
        except pl.exceptions.NoDataError:
            raise _empty(path) from None
        except POLARS_ERRORS:
            raise _shape_fault(path) from None
        filled = cells.select(~pl.all_horizontal(pl.all().is_null())).to_series().arg_true()
        if filled.is_empty():
            raise _empty(path)
        # polars appends "_duplicated_" to repeated names
        names = [name.strip().split("_duplicated_")[0] for name in cells.columns]
        if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
            raise DriveError(
                f"{path}, row 1: column {quoted(twice)} appears twice; delete or rename one of them"
            )
        cells.columns = names
        # a copy would take a gigabyte for a day of data
        rows = cells if len(filled) == len(cells) else cells[filled]
        return cls(path, rows, filled.to_numpy() + 2)  # the header is line 1

    def columns(
        self, required: Sequence[str], optional: Sequence[str], remarks: list[str]
    ) -> dict[str, Array]:
        """Return the known columns, (n,), with ``t`` renamed ``time``. Add a message on unknown columns to remarks."""
        new: list[str] = []
        try:
            known = self._known_columns(required, optional, new)
        except DriveError:
            if self.path.suffix != CSV or self.cells.dtypes[0] == pl.String:
                raise
            return self._text(self.path).columns(required, optional, remarks)
        remarks += new
        return known

    def _known_columns(
        self, required: Sequence[str], optional: Sequence[str], remarks: list[str]
    ) -> dict[str, Array]:
        known, names = (*required, *optional), self.cells.columns
        header = f"{self.path}, row 1" if self.path.suffix == CSV else f"{self.path}"
        for name in required:
            if name not in names:
                if len(names) == 1 and (";" in names[0] or "\t" in names[0]):
                    what = f"{quoted(names[0])} is one cell; separate cells by commas"
                    raise DriveError(f"{header}: {what}, and write decimals with a dot")
                in_memory = f"rename one with columns={{'its name': '{name}'}}"
                remedy = "rename a column" if self.path.suffix else in_memory
                raise DriveError(f"{header}: no column {name}, only {list_names(names)}; add it, or {remedy}")
        if unknown := [name for name in names if name not in known]:
            self._require_one_line(unknown)
            ignored = list_names(unknown, "'")
            remarks.append(f"{self.path}: ignoring {ignored}; the known columns are {', '.join(known)}")
        numbers = {name: self._numbers(name) for name in known if name in names}
        self._require_increasing(numbers["t"])
        return {"time" if name == "t" else name: values for name, values in numbers.items()}

    def _require_one_line(self, columns: Sequence[str]) -> None:
        """Refuse cells with a line break, since a quote that is not closed includes all rows after it."""
        for name in (name for name in columns if self.cells[name].dtype == pl.String):
            broken = self.cells[name].str.contains("\n", literal=True).fill_null(False)
            if broken.any():
                what = "contains a line break"
                raise self._fault(
                    int(broken.arg_max() or 0), name, what, 'close the quote (") before the line break'
                )

    def _numbers(self, column: str) -> Array:
        text = self.cells[column]
        if text.dtype == pl.String and self.path.suffix == CSV:
            text = text.str.strip_chars()
        elif not text.dtype.is_numeric():
            what = f"contains {printable(text.dtype)}, not numbers; write it as 64-bit floats"
            raise DriveError(f"{self.path}, column {column}: {what}")
        values = text.cast(pl.Float64, strict=False)
        if values.null_count() or not values.is_finite().all():
            i = int(values.is_finite().fill_null(False).arg_min() or 0)
            if text[i] is None or text[i] == "":
                empty = self._fault(i, column, "is empty", "fill it in or delete the row")
                raise empty if self.path.suffix == PARQUET else _shape_fault(self.path, empty)
            remedy = "write a number with a decimal point, or delete the row"
            if not self.path.suffix:
                remedy = f"drop such rows, for example with dropna(subset=['{column}'])"
            raise self._fault(i, column, "is not a finite number", remedy)
        low, high, remedy = RANGES.get(column, (-np.inf, np.inf, ""))
        within = values.is_between(low, high)
        if not within.all():
            raise self._fault(int(within.arg_min() or 0), column, f"is outside {low:g} to {high:g}", remedy)
        return values.to_numpy()

    def _require_increasing(self, time: Array) -> None:
        interval = np.diff(time)
        wrong = np.flatnonzero(interval <= 0)
        what, remedy = "is not after", "sort the rows by time and delete repeated rows"
        if not wrong.size and interval.size > 1:
            wrong = np.flatnonzero(interval > _LONGEST_LEAP * float(np.median(interval)))
            what, remedy = "lies too far after", "delete the row with the damaged time"
        if wrong.size:
            i = int(wrong[0]) + 1
            before = f"{printable(self.cells['t'][i - 1])} in row {self.lines[i - 1]}"
            raise self._fault(i, "t", f"{what} {before}", remedy)

    def _fault(self, i: int, column: str, what: str, remedy: str) -> DriveError:
        cell = self.cells[column][i]
        value = "" if cell is None else str(cell)
        where = f"{self.path}, row {self.lines[i]}, column {printable(column)}"
        return DriveError(f"{where}: {quoted(value)} {what}; {remedy}")


def _require_size(path: Path, rows: int, columns: int) -> None:
    if columns > MAX_COLUMNS:
        what = f"has {columns} columns; the limit is {MAX_COLUMNS}"
        raise DriveError(f"{path}: {what}; omit columns that a drive does not need")
    if rows * columns > MAX_CELLS:
        raise DriveError(
            f"{path}: has {rows} rows of {columns} columns; the limit is {MAX_CELLS} cells; omit "
            "columns that a drive does not need, or divide the log before the import"
        )


def _parquet(path: Path) -> pl.DataFrame:
    """Read the numeric columns of a Parquet file; other columns are read as null."""
    try:
        scan = pl.scan_parquet(**one_file(path), hive_partitioning=False)
        schema = scan.collect_schema()
        _require_size(path, 0, len(schema))
        _require_size(path, int(scan.select(pl.len()).collect().item()), len(schema))
        kept = [pl.col(n) if kind.is_numeric() else pl.lit(None, kind).alias(n) for n, kind in schema.items()]
        cells = scan.select(kept).collect()
    except (*POLARS_ERRORS, OSError):
        raise DriveError(f"{path} is not a readable Parquet file; write the file again") from None
    if cells.is_empty():
        raise DriveError(f"{path} contains no rows; the table needs one row per sample")
    return cells


def _plain_numbers(path: Path) -> pl.DataFrame | None:
    """Read a CSV file of finite numbers with unquoted names. Return None for other files."""
    if _has_lone_quote(path):
        return None
    try:
        names = pl.read_csv(**one_file(path), n_rows=0).columns
        floats = dict.fromkeys(names, pl.Float64)
        cells = pl.read_csv(**one_file(path), schema_overrides=floats, low_memory=True)
    except (*POLARS_ERRORS, OSError, UnicodeDecodeError):
        return None
    plain = all(name == name.strip() and "_duplicated_" not in name for name in names)
    whole = len(cells) > 0 and all(column.null_count() == 0 and column.is_finite().all() for column in cells)
    return cells if plain and whole else None


def _has_lone_quote(path: Path) -> bool:
    """Return True if a cell consists of one double quotation mark; polars prints a stack trace for such a cell."""
    if path.stat().st_size == 0:
        return False
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
        return text.find(b'"') >= 0 and re.search(rb'(?:^|[,\r\n])"(?:[,\r\n]|$)', text) is not None


def _empty(path: Path) -> DriveError:
    what = "is empty" if path.stat().st_size == 0 else "contains no rows"
    return DriveError(f"{path} {what}; the file needs a header line and one row per sample")


def _shape_fault(path: Path, otherwise: DriveError | None = None) -> DriveError:
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.reader(file)
        try:
            width = len(next(rows))
            for row in rows:
                if row and len(row) != width:
                    return DriveError(
                        f"{path}, row {rows.line_num}: {quoted(','.join(row))} has {len(row)} cells, "
                        f"but the header has {width}; complete or delete the row, and write decimals with a dot"
                    )
        except csv.Error:  # a quote that is not closed
            return DriveError(f'{path}, row {rows.line_num}: a quote (") is not closed; close or delete it')
    return otherwise or DriveError(
        f"{path} is not comma-separated text in UTF-8; export the file in this format"
    )
