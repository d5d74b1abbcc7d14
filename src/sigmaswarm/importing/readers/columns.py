"""CSV and Parquet: a file, a folder, or a zip of CSV files. Each file, or each sequence of files, is a table."""

import math
import re
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import count, pairwise
from pathlib import Path, PurePosixPath
from typing import Any, cast

import polars as pl

from sigmaswarm.drives.table_files import POLARS_ERRORS, one_file
from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import SECOND
from sigmaswarm.importing.expressions import time_expression
from sigmaswarm.importing.guess import SAMPLE_ROWS, guess_roles, spread_rows
from sigmaswarm.importing.readers.dialect import BLANKS, Dialect, dialect_of, is_table, uneven_row
from sigmaswarm.importing.readers.packed import paths_in, unpacked
from sigmaswarm.importing.readers.points import with_points
from sigmaswarm.importing.source import (
    FILES,
    Batch,
    Guess,
    Limits,
    Log,
    Table,
    TableChoice,
    Wanted,
    first_bytes,
    is_empty,
    no_log_error,
    require_filled,
)
from sigmaswarm.importing.times import time_of
from sigmaswarm.wording import list_names, printable, quoted

SUFFIXES = (".csv", ".tsv", ".txt", ".parquet", ".pq")
OTHER_SUFFIXES = (".dat", ".asc", ".log")
CHUNK = 100_000
MAX_BREAK = 10.0  # s, longest time between files that are joined


def recognizes(path: Path) -> bool:
    """Return True for a table (by suffix or first lines), a zip or folder of tables, and a folder as in EuRoC."""
    return bool(_files(path) or _packed(path)) or (path.is_file() and is_table(path))


def _packed(path: Path) -> list[PurePosixPath]:
    found = sorted(paths_in(path)) if path.is_file() else []
    return [file for file in found if file.suffix.lower() in (".csv", ".tsv") and file.name[:1] != "."]


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        here = [f for f in path.iterdir() if f.suffix.lower() in SUFFIXES and not is_empty(f)]
        return sorted(here) or files_of_sensors(path) or tables_of_other_names(path)
    return [path] if path.suffix.lower() in SUFFIXES else []


def files_of_sensors(folder: Path) -> list[Path]:
    """Return the data.csv of each sensor in a folder as in EuRoC."""
    found = [*folder.glob("*/data.csv"), *folder.glob("mav0/*/data.csv")]
    names = "imu|gps|gnss|rtk|cam|leica|vicon|baro|mag|odom|wheel|state_groundtruth_estimate"
    sensors = [file for file in found if re.fullmatch(rf"(?:{names})\d", file.parent.name)]
    return sorted(file for file in sensors if file.is_file() and file.stat().st_size)


def tables_of_other_names(folder: Path) -> list[Path]:
    """Return the text tables in a folder whose suffix is none of `SUFFIXES`, such as imu.dat."""
    found = (file for file in folder.iterdir() if file.suffix.lower() in OTHER_SUFFIXES and file.is_file())
    return sorted(file for file in found if is_table(file))


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    if packed := _packed(path):
        folders = dict.fromkeys(file.parent for file in packed)
        outer = [folder for folder in folders if len(folder.parts) == min(len(f.parts) for f in folders)]
        if len(outer) > 1:
            raise InputError(
                f"{path}: contains tables in several folders ({list_names(map(str, outer))}); unpack it, import one "
                "folder or file, and name other files with --gps, --truth and --odometer"
            )
        names = [*dict.fromkeys(file.name for file in packed)]
        return log_of_names(path, names, limits, stack, None)
    remarks: list[str] = []
    files, folder = [path], path.parent
    if path.is_dir():
        folder, found = path, _files(path)
        files = [file for file in found if not _is_prose(file)]
        remarks += [f"{file.name}: is not a table and is not read" for file in found if file not in files]
        empty = sorted(f.name for f in path.iterdir() if f.suffix.lower() in SUFFIXES and is_empty(f))
        remarks += [f"{name} is empty; copy it again" for name in empty]
        if not files:
            raise no_log_error(path)
    scans = {f.relative_to(folder).as_posix(): scan(f, f, limits, remarks) for f in files}
    return log_of_files(path, _joined(scans, remarks), FILES, None, remarks)


def _joined(scans: Mapping[str, pl.LazyFrame], remarks: list[str]) -> dict[str, pl.LazyFrame]:
    """Join files that continue each other: with equal columns, times in sequence, and names that differ only in digits.

    A file without a header may have any name. It gets the header of the only file that has a header and the same number
    of columns.
    """
    if len(scans) < 2:
        return {**scans}
    heads = {name: rows.collect_schema().names() for name, rows in scans.items()}
    titled = {name: head for name, head in heads.items() if head[0] != "c1"}
    renamed, groups = dict(scans), dict[tuple[str, ...], list[str]]()
    for name, head in heads.items():
        alike = [other for other in titled if len(titled[other]) == len(head) and name not in titled]
        first = alike[0] if len(alike) == 1 else name
        renamed[name] = scans[name].rename(dict(zip(head, heads[first], strict=True)))
        plain = re.sub(r"[\W_]*\d+[\W_]*", "", PurePosixPath(first).stem)
        groups.setdefault((plain, *heads[first]), []).append(name)
    whole: dict[str, pl.LazyFrame] = {}
    for names in groups.values():
        spans = sorted((_span(renamed[name]), name) for name in names) if len(names) > 1 else []
        gaps = [later[0][0] - former[0][1] for former, later in pairwise(spans)]
        if not gaps or not all(0 <= gap < MAX_BREAK for gap in gaps):
            whole |= {name: scans[name] for name in names}
            continue
        names = [name for _, name in spans]
        whole[names[0]] = pl.concat([renamed[name] for name in names], how="vertical_relaxed")
        reason = f"{list_names(names)} are joined, since the times of each file continue those of the previous file"
        remarks[:] = [r for r in remarks if not any(r.startswith(f"{n}: has no header") for n in names)] + [
            reason
        ]
    return whole


def _span(rows: pl.LazyFrame) -> tuple[float, float]:
    """Return the first and the last time of a table, s; NaN if they cannot be read."""
    head = rows.head(SAMPLE_ROWS).collect()
    if (text := time_of(head) or time_of(head, "gps")) is None:
        return math.nan, math.nan
    ends = pl.concat([rows.head(1), rows.tail(1)]).select(time_expression(text, head)).collect()
    first, last = ends.to_series().to_list() if len(ends) == 2 else (None, None)
    return (math.nan, math.nan) if first is None or last is None else (first / SECOND, last / SECOND)


def log_of_names(
    path: Path, names: Collection[str], limits: Limits, stack: ExitStack, guessed: Guess | None
) -> Log:
    """Open those of the named tables that a folder or zip contains; ``guessed``: see `log_of_files`."""
    folder, remarks = unpacked(path, names, limits, stack), list[str]()
    there = [name for name in names if (folder / name).is_file()]
    scans = {name: scan(folder / name, path / name, limits, remarks) for name in there}
    return log_of_files(path, scans if guessed else _joined(scans, remarks), "CSV", guessed, remarks)


def _is_prose(file: Path) -> bool:
    """Return True for a .txt file without columns of numbers, such as notes about a log."""
    if file.suffix.lower() != ".txt" or first_bytes(file, 4) == b"PAR1":
        return False
    dialect = dialect_of(file, file)
    return len(dialect.names) < 2 or not dialect.numeric


def log_of_files(
    path: Path,
    scans: Mapping[str, pl.LazyFrame],
    kind: str,
    guessed: Guess | None = None,
    remarks: Sequence[str] = (),
) -> Log:
    """Make a log of scanned tables; if ``guessed`` is None, roles are guessed from columns."""
    tables = {name: Table(tuple(rows.collect_schema().names()), kind) for name, rows in scans.items()}
    # a logger that loses power leaves zero bytes
    stripped = pl.col(pl.String).str.strip_chars("\0").str.strip_chars()

    def batches(wanted: Wanted) -> Iterator[Batch]:
        for number, (table, columns) in enumerate(wanted.items()):
            size, seen = _expected_rows(path / table if path.is_dir() else path), 0
            rows = scans[table].select(list(columns))
            try:
                for frame in rows.collect_batches(chunk_size=CHUNK, maintain_order=True):
                    seen += len(frame)
                    yield (
                        table,
                        frame.with_columns(stripped),
                        (number + min(seen / max(size, seen), 1.0)) / len(wanted),
                    )
            except POLARS_ERRORS as error:
                raise broken_table(path, table, error) from None

    def guess(choice: TableChoice) -> Guess:
        if guessed is not None:
            return guessed
        for table in choice.tables.values():
            if table not in scans and (joined := [r for r in remarks if table in r and "are joined" in r]):
                raise InputError(f"there is no table {quoted(table)}: {joined[0]}; choose the first of them")
        heads = {name: collect(rows, path, name, spread_rows) for name, rows in scans.items()}
        return guess_roles({name: head.with_columns(stripped) for name, head in heads.items()}, choice.tables)

    return Log(path, tables, batches, guess, list(remarks))


def scan(file: Path, shown_as: Path, limits: Limits, remarks: list[str]) -> pl.LazyFrame:
    """Scan a table file; the types of a CSV's columns are determined from all rows.

    ``shown_as``: name of the file in messages. ``remarks``: receives sentences for the user.
    """
    require_filled(file, shown_as)
    if first_bytes(file, 4) == b"PAR1":
        _require_decodable(file, shown_as, limits)
        try:
            frame = pl.scan_parquet(**one_file(file))
            limits.check_rows(frame.select(pl.len()).collect().item(), shown_as, shown_as.name)
            names = frame.collect_schema().names()
        except (*POLARS_ERRORS, OSError) as error:
            raise broken_table(shown_as, shown_as.name, error) from None
        _check_names(names, shown_as, limits)
    else:
        _require_closed_quotes(file, shown_as)
        dialect = dialect_of(file, shown_as)
        names = dialect.names
        remarks += dialect.remarks
        _check_names(names, shown_as, limits)
        frame = _text(file, dialect, shown_as)
    # the integers that encode categories have no meaning
    frame = frame.with_columns(pl.col(pl.Categorical, pl.Enum).cast(pl.String))
    old = frame.collect_schema().names()
    frame = frame.rename(dict(zip(old, _plain(names, shown_as, remarks), strict=True)))
    try:
        return with_points(frame)
    except POLARS_ERRORS as error:
        raise broken_table(shown_as, shown_as.name, error) from None


_DECODE = """
import sys, polars
rows = polars.scan_parquet(sys.argv[1], glob=False)
count = rows.select(polars.len()).collect().item()
sys.exit(count <= int(sys.argv[2]) and count != sum(map(len, rows.collect_batches())))
"""


def _require_decodable(file: Path, shown_as: Path, limits: Limits) -> None:
    """Decode a Parquet file in another process, since damaged bytes may abort polars, or make it omit rows silently."""
    words = [sys.executable, "-c", _DECODE, str(file), str(limits.rows)]
    ended = subprocess.run(words, capture_output=True, check=False)
    if ended.returncode:
        raise InputError(f"{shown_as}: can't be decoded as a Parquet file; export it again")


def _check_names(names: Sequence[str], shown_as: Path, limits: Limits) -> None:
    if len(names) < 2:
        raise InputError(
            f"{shown_as}: has only one column, {quoted(''.join(names))}; specify the format with --format, or separate "
            "cells by commas"
        )
    limits.first_columns(iter(names), shown_as)


def _text(file: Path, dialect: Dialect, shown_as: Path) -> pl.LazyFrame:
    """Scan the rows of a text table as columns c1, c2, ..., with decimal points and without thousands separators."""
    columns = [f"c{k}" for k in range(1, len(dialect.names) + dialect.surplus + 1)]
    try:
        if dialect.separator == BLANKS:
            cells = (
                pl.col("line").str.strip_chars().str.replace_all(r"\s+", " ").str.splitn(" ", len(columns))
            )
            lines = text_lines(file, dialect.skip, comment_prefix="#", encoding="utf8")
            frame = lines.select(cells.struct.rename_fields(columns).alias("cells")).unnest("cells")
        else:
            frame = _separated(file, dialect, columns)
        there = frame.collect_schema()
        last = [
            pl.col(c).cast(pl.String).str.strip_chars().ne("").any() for c in columns[len(dialect.names) :]
        ]
        if last and any(frame.select(pl.any_horizontal(last)).collect().row(0)):
            raise pl.exceptions.ComputeError("a row has more cells than the header")
    except pl.exceptions.NoDataError:
        return pl.LazyFrame(schema=dict.fromkeys(columns[: len(dialect.names)], pl.String))
    except (*POLARS_ERRORS, OSError) as error:
        if (uneven := uneven_row(file, dialect)) is not None:
            row, cells = uneven
            raise InputError(
                f"{shown_as}, row {row}: has {cells} cells, but the header has {len(dialect.names)}; delete the row, "
                "or write a header with a name for each column"
            ) from None
        try:  # some rows may end with surplus empty cells
            frame = _separated(file, dialect, None, truncate_ragged_lines=True)
            frame = frame.rename(dict(zip(frame.collect_schema(), columns, strict=False)))
            there = frame.collect_schema()
        except POLARS_ERRORS:
            raise broken_table(shown_as, shown_as.name, error) from None
    missing = [pl.lit(None, pl.Float64).alias(c) for c in columns if c not in there]
    texts = [columns[k] for k in dialect.numeric if there.get(columns[k]) == pl.String]
    grouped = _grouped(frame, texts, shown_as)
    commas = {columns[k] for k in dialect.comma_columns if columns[k] in texts}
    commas = commas - grouped.keys() | {c for c, group in grouped.items() if group != ","}
    plain = {c: pl.col(c).str.strip_chars() for c in (*commas, *grouped)}
    plain |= {c: plain[c].str.replace_all(group, "", literal=True) for c, group in grouped.items()}
    plain |= {c: plain[c].str.replace(",", ".", literal=True) for c in commas}
    return frame.with_columns(*missing, *plain.values()).select(columns[: len(dialect.names)])


def _grouped(frame: pl.LazyFrame, columns: Sequence[str], shown_as: Path) -> dict[str, str]:
    """Return the thousands separator of each column with a number such as 1.234,5, so that it can be removed."""
    forms = {
        **{
            group: rf"^[+-]?\d{{1,3}}(?:\{group}\d{{3}})+\{mark}\d+$"
            for group, mark in ((".", ","), (",", "."))
        },
        **{group: rf"^[+-]?\d{{1,3}}(?:{group}\d{{3}})+(?:[.,]\d+)?$" for group in "'’ \u00a0\u202f"},
    }
    two = {group: rf"|^[+-]?\d{{1,3}}(?:\{group}\d{{3}}){{2,}}$" for group in ".,"}
    found = frame.select(
        pl.col(c).str.strip_chars().str.contains(form + two.get(group, "")).any().alias(f"{c}{group}")
        for c in columns
        for group, form in forms.items()
    )
    seen = collect(found, shown_as, shown_as.name).row(0, named=True) if columns else {}
    return {c: group for c in columns for group in forms if seen[f"{c}{group}"]}


def _separated(file: Path, dialect: Dialect, columns: Sequence[str] | None, **options: Any) -> pl.LazyFrame:
    """Scan cells; the types are determined once, since polars would determine them again at each reading."""
    settings: dict[str, Any] = {
        "separator": dialect.separator,
        "has_header": False,
        "skip_lines": dialect.skip,
        "decimal_comma": bool(dialect.comma_columns) and dialect.separator != ",",
        "encoding": dialect.encoding,
        "comment_prefix": "#",
        **options,
    }
    cells = pl.scan_csv(**one_file(file), **settings, new_columns=columns, infer_schema_length=None)
    types = cells.collect_schema()
    return pl.scan_csv(**one_file(file), **settings, schema=types, missing_columns="insert")


def text_lines(file: Path, skip: int, encoding: str = "utf8-lossy", **options: Any) -> pl.LazyFrame:
    """Scan the lines of a text, without the first ``skip``, as a column ``line``; empty lines are null."""
    return pl.scan_csv(
        **one_file(file),
        separator="\x1f",
        has_header=False,
        new_columns=["line"],
        quote_char=None,
        skip_lines=skip,
        infer_schema=False,
        encoding=cast("Any", encoding),
        **options,
    )


def _plain(names: Sequence[str], file: Path, remarks: list[str]) -> list[str]:
    plain: dict[str, None] = {}
    # Next suffix of each name; for 100,000 equal names, a search from 0 would take minutes
    numbers: dict[str, Iterator[int]] = {}
    others: dict[str, list[str]] = {}
    for name in names:
        bare = name.strip().replace("`", "'")  # expressions quote names with backticks
        first = re.sub(r"_duplicated_\d+$", "", bare) if bare not in plain else bare
        if first in plain:
            free = numbers.setdefault(first, count())
            bare = next(other for i in free if (other := f"{first}_duplicated_{i}") not in plain)
            others.setdefault(first, []).append(bare)
        plain[bare] = None
    for first, again in others.items():
        if first:
            often = "twice; the second is" if len(again) == 1 else f"{len(again) + 1} times; the others are"
            called = list_names(again, mark="'")
            remarks.append(f"{file.name}: column {quoted(first)} appears {often} called {called}")
    return list(plain)


def _require_closed_quotes(file: Path, shown_as: Path) -> None:
    """Refuse an odd number of quotes, since everything after an unclosed quote would be read as one cell."""
    with file.open("rb") as stream:
        quotes = sum(block.count(b'"') for block in iter(lambda: stream.read(1 << 20), b""))
    if quotes % 2:
        raise InputError(f'{shown_as}: a quote (") is not closed; close or delete it')


def _expected_rows(file: Path) -> int:
    head = first_bytes(file, 65536)
    return int(file.stat().st_size / max(len(head) / max(head.count(b"\n"), 1), 1.0)) if file.is_file() else 1


def collect(
    rows: pl.LazyFrame,
    path: Path,
    table: str,
    read: Callable[[pl.LazyFrame], pl.DataFrame] = pl.LazyFrame.collect,
) -> pl.DataFrame:
    """Return the rows that ``read`` selects, by default all; convert errors of polars to one-line errors."""
    try:
        return read(rows)
    except POLARS_ERRORS as error:
        raise broken_table(path, table, error) from None


def broken_table(path: Path, table: str, error: Exception) -> InputError:
    where = path if path.name == table else path / table
    reason = printable(" ".join(str(error).split("\n")[0].split()), 160)
    return InputError(f"{where}: can't be read as a table ({reason}); export it again")
