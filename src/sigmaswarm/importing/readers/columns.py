"""CSV and Parquet: a file, a folder, or a zip of CSV files. Each file, or each sequence of files, is a table."""

import math
import re
import shutil
import tempfile
import zipfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path, PurePosixPath

import polars as pl

from sigmaswarm.drives.table_files import POLARS_ERRORS
from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import require_text
from sigmaswarm.importing.dates import SECOND
from sigmaswarm.importing.expressions import time_expression
from sigmaswarm.importing.guess import guess_roles, spread_rows
from sigmaswarm.importing.readers.dialect import dialect_of, is_table
from sigmaswarm.importing.readers.scanning import broken_table, collect, scan
from sigmaswarm.importing.source import (
    FILES,
    SAMPLE_ROWS,
    Batch,
    Guess,
    Limits,
    Log,
    Table,
    TableChoice,
    Wanted,
    errors_as_damage,
    first_bytes,
    is_empty,
    no_log_error,
)
from sigmaswarm.importing.times import time_of
from sigmaswarm.wording import list_names, quoted

SUFFIXES = (".csv", ".tsv", ".txt", ".parquet", ".pq")
OTHER_SUFFIXES = (".dat", ".asc", ".log")
CHUNK = 100_000
MAX_BREAK = 10.0  # s, longest time between files that are joined


def recognizes(path: Path) -> bool:
    """Return True for a table (by suffix or first lines), a zip or folder of tables, or a folder like EuRoC's."""
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
    """Return the data.csv of each sensor in a folder with the layout of EuRoC."""
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
                "folder or file, and specify other files with --gps, --truth and --odometer"
            )
        names = [*dict.fromkeys(file.name for file in packed)]
        return log_of_names(path, names, limits, stack, None)
    remarks: list[str] = []
    found, folder = (_files(path), path) if path.is_dir() else ([path], path.parent)
    texts, files = {file: _as_utf8(file, stack) for file in found}, found
    if path.is_dir():
        files = [file for file in found if not _is_prose(texts[file], file)]
        remarks += [f"{file.name}: is not a table and is not read" for file in found if file not in files]
        empty = sorted(f.name for f in path.iterdir() if f.suffix.lower() in SUFFIXES and is_empty(f))
        remarks += [f"{name} is empty; copy it again" for name in empty]
        if not files:
            raise no_log_error(path)
    scans = {f.relative_to(folder).as_posix(): scan(texts[f], f, limits, remarks) for f in files}
    return log_of_files(path, _joined(scans, remarks), FILES, None, remarks)


def _as_utf8(file: Path, stack: ExitStack) -> Path:
    """Return a file, or a temporary copy in UTF-8 of a text in UTF-16, as spreadsheets write "Unicode text"."""
    head = first_bytes(file, 4)
    if head[:2] not in (b"\xff\xfe", b"\xfe\xff") or head[2:] == b"\0\0":
        return file
    copy = Path(stack.enter_context(tempfile.TemporaryDirectory())) / file.name
    with (
        errors_as_damage(file, "is damaged text in UTF-16", "export it again"),
        file.open(encoding="utf-16") as text,
        copy.open("w", encoding="utf-8") as new,
    ):
        shutil.copyfileobj(text, new)
    return copy


def _joined(scans: Mapping[str, pl.LazyFrame], remarks: list[str]) -> dict[str, pl.LazyFrame]:
    """Join files that continue each other: with equal columns, times in sequence, and names that differ only in digits.

    A file without a header may have any name. If exactly one file with a header has the same number of columns, it gets
    this header.
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
    """Open those of the named tables that a folder or zip contains. For ``guessed`` see `log_of_files`."""
    folder, remarks = unpacked(path, names, limits, stack), list[str]()
    there = [name for name in names if (folder / name).is_file()]
    scans = {name: scan(_as_utf8(folder / name, stack), path / name, limits, remarks) for name in there}
    return log_of_files(path, scans if guessed else _joined(scans, remarks), "CSV", guessed, remarks)


def _is_prose(file: Path, shown_as: Path) -> bool:
    """Return True for a .txt file without columns of numbers, such as notes about a log."""
    if file.suffix.lower() != ".txt" or first_bytes(file, 4) == b"PAR1":
        return False
    dialect = dialect_of(file, shown_as)
    return len(dialect.names) < 2 or not dialect.numeric


def log_of_files(
    path: Path,
    scans: Mapping[str, pl.LazyFrame],
    kind: str,
    guessed: Guess | None = None,
    remarks: Sequence[str] = (),
) -> Log:
    """Make a log of scanned tables. If ``guessed`` is None, roles are guessed from columns."""
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


def _expected_rows(file: Path) -> int:
    head = first_bytes(file, 65536)
    return int(file.stat().st_size / max(len(head) / max(head.count(b"\n"), 1), 1.0)) if file.is_file() else 1


def names_in(path: Path) -> set[str]:
    """Return the names of the files in a folder or a zip; empty for other files."""
    if path.is_dir():
        return {file.name for file in path.iterdir() if file.is_file()}
    return {inside.name for inside in paths_in(path)}


def paths_in(path: Path) -> list[PurePosixPath]:
    if path.suffix.lower() == ".zip" and zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return [PurePosixPath(name) for name in archive.namelist()]
        except Exception:  # the zip's directory is damaged
            return []
    return []


def unpacked(path: Path, names: Collection[str], limits: Limits, stack: ExitStack) -> Path:
    """Return the folder of the named text files: the given folder, or a temporary folder with the files of a zip."""
    if path.is_dir():
        return path
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    with (
        errors_as_damage(path, "is damaged or not a zip file", "export it again"),
        zipfile.ZipFile(path) as archive,
    ):
        for name, member in _wanted(archive, path, names, limits).items():
            with archive.open(member) as packed, (folder / name).open("wb") as file:
                shutil.copyfileobj(packed, file)
            _, lines = require_text(folder / name, path / name)
            limits.check_rows(lines, path, name)
    return folder


def _wanted(
    archive: zipfile.ZipFile, path: Path, names: Collection[str], limits: Limits
) -> dict[str, zipfile.ZipInfo]:
    """Find the named files in the outermost folder that contains at least one of them."""
    found = [(PurePosixPath(m.filename), m) for m in archive.infolist() if not m.is_dir()]
    found = [(inside, m) for inside, m in found if inside.name in names]
    folders = {inside.parent for inside, _ in found}
    outermost = min(folders, key=lambda f: (len(f.parts), str(f)), default=None)
    wanted = {inside.name: m for inside, m in found if inside.parent == outermost}
    limits.check_unpacked(sum(m.file_size for m in wanted.values()), path)
    for name, member in wanted.items():
        if member.flag_bits & 1:
            raise InputError(
                f"{path}: contains {name}, which is encrypted; unpack the zip, and specify the folder"
            )
    return wanted
