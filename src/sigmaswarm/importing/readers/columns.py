"""CSV and Parquet: a file, or a folder of them, each file a table. Rows stream through polars."""

from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from sigmaswarm.drives.sheet import one_file
from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import guess_roles
from sigmaswarm.importing.source import Batch, Choice, Guess, Source, Table, first_bytes

SUFFIXES = (".csv", ".tsv", ".txt", ".parquet", ".pq")
SAMPLE = 2000
"""Rows by which units are guessed."""
CHUNK = 100_000
"""Rows of a batch."""


def recognizes(path: Path) -> bool:
    """Whether it is a table file by its name, or a folder that holds one."""
    return bool(_files(path))


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
            except pl.exceptions.PolarsError as error:
                raise broken_table(self.path, table, error) from None

    def guess(self, choice: Choice) -> Guess:
        """As the format says, or by the columns' names, and units by their first rows."""
        if self.guessed is not None:
            return self.guessed
        samples: dict[str, pl.DataFrame] = {}
        for name, rows in self.scans.items():
            try:
                samples[name] = rows.head(SAMPLE).collect()
            except pl.exceptions.PolarsError as error:
                raise broken_table(self.path, name, error) from None
        return guess_roles(samples, choice.tables)


@contextmanager
def open_log(path: Path) -> Generator[Source]:
    """Open a table file or a folder of them."""
    files = _files(path) if path.is_dir() else [path]
    scans: dict[str, pl.LazyFrame] = {}
    for file in files:
        scans[file.name] = scan(file)
    tables = {name: Table(tuple(s.collect_schema().names()), "columns") for name, s in scans.items()}
    yield ColumnFiles(path, scans, tables)


def scan(file: Path) -> pl.LazyFrame:
    """A table file, not yet read; the kinds of a CSV's columns are found over all its rows."""
    try:
        if first_bytes(file, 4) == b"PAR1":
            frame = pl.scan_parquet(**one_file(file))
        else:
            frame = pl.scan_csv(
                **one_file(file), separator=_separator(file), infer_schema_length=None, comment_prefix="#"
            )
        names = frame.collect_schema().names()
    except (pl.exceptions.PolarsError, OSError) as error:
        raise broken_table(file, file.name, error) from None
    if len(names) < 2:
        raise InputError(
            f"{file}: is one column, {names[0][:40]!r}; name the format, or separate cells by commas"
        )
    return frame.rename({name: name.strip() for name in names if name.strip() != name})


def _separator(file: Path) -> str:
    """The separator that the header line has most of."""
    lines = [
        line for line in first_bytes(file).decode("utf-8", "replace").splitlines() if not line.startswith("#")
    ]
    head = lines[0] if lines else ""
    return max(",;\t|", key=head.count)


def _expected_rows(file: Path) -> int:
    """About how many rows a file holds, by the length of its first ones."""
    head = first_bytes(file, 65536)
    return int(file.stat().st_size / max(len(head) / max(head.count(b"\n"), 1), 1.0)) if file.is_file() else 1


def broken_table(path: Path, table: str, error: Exception) -> InputError:
    where = path if path.name == table else path / table
    said = " ".join(str(error).split("\n")[0].split())[:160]
    return InputError(f"{where}: can't be read as a table ({said}); mend or export it again")
