"""CSV and Parquet: a file, or a folder of them, each file a table. Rows stream through polars."""

import re
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, cast

import polars as pl

from sigmaswarm.drives.table_files import BROKEN, one_file
from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import SAMPLE, guess_roles
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.dialect import BLANKS, Dialect, dialect_of, is_table, uneven_row
from sigmaswarm.importing.source import FILES, Batch, Choice, Guess, Source, Table, first_bytes
from sigmaswarm.wording import names_shown, quoted, shown

SUFFIXES = (".csv", ".tsv", ".txt", ".parquet", ".pq")
CHUNK = 100_000
"""Rows of a batch."""


def recognizes(path: Path) -> bool:
    """Return True if it is a table file by its name or its first lines, or a folder that holds one by its name."""
    return bool(_files(path)) or (path.is_file() and is_table(path))


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(f for f in path.iterdir() if f.suffix.lower() in SUFFIXES and f.stat().st_size)
    return [path] if path.suffix.lower() in SUFFIXES else []


@dataclass(frozen=True)
class ColumnFiles:
    """Tables in files, scanned when they are wanted; ``guessed`` where a format says what they are."""

    path: Path
    scans: Mapping[str, pl.LazyFrame]
    tables: Mapping[str, Table]
    guessed: Guess | None = None
    remarks: tuple[str, ...] = ()

    def batches(self, wanted: Mapping[str, Collection[str]]) -> Iterator[Batch]:
        """The files one after the other, some hundred thousand rows at a time."""
        for number, (table, columns) in enumerate(wanted.items()):
            size = _expected_rows(self.path / table if self.path.is_dir() else self.path)
            seen = 0
            rows = self.scans[table].select(list(columns))
            try:
                for frame in rows.collect_batches(chunk_size=CHUNK, maintain_order=True):
                    seen += len(frame)
                    yield Batch(table, frame, (number + min(seen / max(size, seen), 1.0)) / len(wanted))
            except BROKEN as error:
                raise broken_table(self.path, table, error) from None

    def guess(self, choice: Choice) -> Guess:
        """As the format says, or by the columns' names, and units by their first rows."""
        if self.guessed is not None:
            return self.guessed
        samples = {
            name: collect(rows.head(SAMPLE), self.path, name).with_columns(
                pl.col(pl.String).str.strip_chars()
            )
            for name, rows in self.scans.items()
        }
        return guess_roles(samples, choice.tables)


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open a table file or a folder of them."""
    files = _files(path) if path.is_dir() else [path]
    remarks: list[str] = []
    scans = {file.name: scan(file, file, limits, remarks) for file in files}
    yield ColumnFiles(path, scans, tables_of(scans, FILES), remarks=tuple(remarks))


def tables_of(scans: Mapping[str, pl.LazyFrame], kind: str) -> dict[str, Table]:
    """The tables with their columns' names."""
    return {name: Table(tuple(rows.collect_schema().names()), kind) for name, rows in scans.items()}


def scan(file: Path, shown_as: Path, limits: Limits, remarks: list[str]) -> pl.LazyFrame:
    """A table file, not yet read; the kinds of a CSV's columns are found over all its rows.

    Parameters
    ----------
    shown_as : the file's name in messages, where it was unpacked to another place
    remarks : receives columns that share a name
    """
    if first_bytes(file, 4) == b"PAR1":
        frame = _parquet(file, shown_as, limits)
        names: Sequence[str] = frame.collect_schema().names()
    else:
        _require_closed_quotes(file, shown_as)
        dialect = dialect_of(file, shown_as)
        names = dialect.names
        remarks += dialect.remarks
        _require_two(names, shown_as)
        limits.first_columns(iter(names), shown_as)
        frame = _text(file, dialect, shown_as)
    _require_two(names, shown_as)
    limits.first_columns(iter(names), shown_as)
    frame = frame.with_columns(pl.col(pl.Categorical, pl.Enum).cast(pl.String))  # their numbers mean nothing
    old = frame.collect_schema().names()
    return frame.rename(dict(zip(old, _plain(names, shown_as, remarks), strict=True)))


def _require_two(names: Sequence[str], shown_as: Path) -> None:
    if len(names) < 2:
        raise InputError(
            f"{shown_as}: is one column, {quoted(''.join(names))}; name the format, or separate cells by commas"
        )


def _parquet(file: Path, shown_as: Path, limits: Limits) -> pl.LazyFrame:
    try:
        frame = pl.scan_parquet(**one_file(file))
        limits.check_rows(frame.select(pl.len()).collect().item(), shown_as, shown_as.name)
        frame.collect_schema()
    except (*BROKEN, OSError) as error:
        raise broken_table(shown_as, shown_as.name, error) from None
    return frame


def _text(file: Path, dialect: Dialect, shown_as: Path) -> pl.LazyFrame:
    """The rows of a text table under the names of its dialect, as c1, c2, ...; texts of numbers have decimal dots."""
    width = len(dialect.names) + dialect.surplus
    columns = [f"c{k}" for k in range(1, width + 1)]
    try:
        if dialect.separator == BLANKS:
            frame = _parted_by_blanks(file, dialect, columns)
        else:
            frame = pl.scan_csv(
                **one_file(file),
                separator=dialect.separator,
                has_header=False,
                new_columns=columns,
                skip_lines=dialect.skip,
                decimal_comma=bool(dialect.comma_columns) and dialect.separator != ",",
                encoding=cast("Any", dialect.encoding),
                infer_schema_length=None,
                comment_prefix="#",
            )
        there = frame.collect_schema()
        if dialect.surplus and frame.select(pl.col(columns[-1]).is_not_null().any()).collect().item():
            raise pl.exceptions.ComputeError("a row has more cells than the header")
    except pl.exceptions.NoDataError:
        return pl.LazyFrame(schema=dict.fromkeys(columns[: len(dialect.names)], pl.String))
    except (*BROKEN, OSError) as error:
        if (uneven := uneven_row(file, dialect)) is not None:
            row, cells = uneven
            raise InputError(
                f"{shown_as}, row {row}: has {cells} cells and the header {len(dialect.names)}; delete the row, or "
                "write a header with a name for each column"
            ) from None
        raise broken_table(shown_as, shown_as.name, error) from None
    missing = [pl.lit(None, pl.Float64).alias(c) for c in columns if c not in there]
    commas = [columns[k] for k in dialect.comma_columns if there.get(columns[k]) == pl.String]
    dotted = [pl.col(c).str.strip_chars().str.replace(",", ".", literal=True) for c in commas]
    return frame.with_columns(*missing, *dotted).select(columns[: len(dialect.names)])


def _parted_by_blanks(file: Path, dialect: Dialect, columns: Sequence[str]) -> pl.LazyFrame:
    """The cells of lines, which any number of blanks part, as text."""
    lines = pl.scan_csv(
        **one_file(file), separator="\x1f", has_header=False, new_columns=["line"], quote_char=None,
        skip_lines=dialect.skip, infer_schema=False, comment_prefix="#",
    )  # fmt: skip
    cells = pl.col("line").str.strip_chars().str.replace_all(r"\s+", " ").str.splitn(" ", len(columns))
    return lines.select(cells.struct.rename_fields(list(columns)).alias("cells")).unnest("cells")


def _plain(names: Sequence[str], file: Path, remarks: list[str]) -> list[str]:
    """Names without spaces around them; more columns of a name are called as polars calls them."""
    plain: dict[str, None] = {}
    numbers: dict[str, Iterator[int]] = {}  # a header may repeat one name a hundred thousand times
    others: dict[str, list[str]] = {}
    for name in names:
        bare = name.strip().replace("`", "'")  # between backticks stand names in expressions
        first = re.sub(r"_duplicated_\d+$", "", bare) if bare not in plain else bare
        if first in plain:
            free = numbers.setdefault(first, count())
            bare = next(other for i in free if (other := f"{first}_duplicated_{i}") not in plain)
            others.setdefault(first, []).append(bare)
        plain[bare] = None
    for first, again in others.items():
        if first:
            often = "twice; the other is" if len(again) == 1 else f"{len(again) + 1} times; the others are"
            called = names_shown(again, mark="'")
            remarks.append(f"{file.name}: column {quoted(first)} appears {often} {called}")
    return list(plain)


def _require_closed_quotes(file: Path, shown_as: Path) -> None:
    """Refuse a text with an odd number of quotes: the rest of the file would count as one cell."""
    with file.open("rb") as stream:
        count = sum(block.count(b'"') for block in iter(lambda: stream.read(1 << 20), b""))
    if count % 2:
        raise InputError(f'{shown_as}: a quote (") is not closed; close or delete it')


def _expected_rows(file: Path) -> int:
    """About how many rows a file holds, by the length of its first ones."""
    head = first_bytes(file, 65536)
    return int(file.stat().st_size / max(len(head) / max(head.count(b"\n"), 1), 1.0)) if file.is_file() else 1


def collect(rows: pl.LazyFrame, path: Path, table: str) -> pl.DataFrame:
    """Return the rows; errors of polars become one line."""
    try:
        return rows.collect()
    except BROKEN as error:
        raise broken_table(path, table, error) from None


def broken_table(path: Path, table: str, error: Exception) -> InputError:
    """Return the error of polars about a damaged table in one line."""
    where = path if path.name == table else path / table
    said = shown(" ".join(str(error).split("\n")[0].split()), 160)
    return InputError(f"{where}: can't be read as a table ({said}); mend or export it again")
