"""Interface of readers: a log as named tables of columns, read in batches."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Protocol

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.wording import quoted

Role = Literal["imu", "gps", "truth", "odometer"]
ROLES: tuple[Role, ...] = ("imu", "gps", "truth", "odometer")

CHUNK = 5000
"""Rows of a batch, where they are decoded one by one."""

Progress = Callable[[float], None]
"""Called with the share of the log that is read, 0 to 1."""


FILES = "columns"
"""The kind of tables that are files of columns, named as the files are."""


@dataclass(frozen=True)
class Table:
    """A table of a log: its columns, its type in the terms of the format, and its number of rows where known."""

    columns: tuple[str, ...]
    kind: str = ""
    rows: int | None = None


@dataclass(frozen=True)
class Batch:
    """Some rows of one table, in the log's order.

    Attributes
    ----------
    table : str
    rows : DataFrame with the wanted columns
    done : share of the log that is read, 0 to 1
    """

    table: str
    rows: pl.DataFrame
    done: float


@dataclass(frozen=True)
class Part:
    """One table's share in a role: a drive's columns (``t`` among them) as expressions over the table's columns."""

    table: str
    columns: Mapping[str, str]


@dataclass(frozen=True)
class Fault:
    """Reason not to use a column unchanged, with the remedy: an unknown unit, raw counts."""

    role: Role
    column: str
    table: str
    sentence: str


@dataclass(frozen=True)
class Guess:
    """Recipe of a reader for a log, and its assumptions, one sentence each.

    Attributes
    ----------
    roles : the parts of each role; the first part's times count, further parts are interpolated to them
    notes : sentences for the user
    origin : latitude (deg), longitude (deg), altitude (m) of the frame that the truth is in, where the format fixes it
    metadata : keys for drive.toml
    downward : a sentence where the IMU's vertical axis points down, if its mounting is not given
    fixed : expression over the fixes' first table: where carrier phases are fixed; empty where the format can't say
    faults : reasons not to use columns unchanged, unless the user maps them
    """

    roles: Mapping[Role, tuple[Part, ...]]
    notes: tuple[str, ...] = ()
    origin: tuple[float, float, float] | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict[str, Any])
    downward: str = ""
    fixed: str = ""
    faults: tuple[Fault, ...] = ()

    def said(self, *, mounted: bool) -> list[str]:
        """The sentences, once it is known whether the user said how the IMU sits in the vehicle."""
        return [*self.notes, *([self.downward] if self.downward and not mounted else [])]


@dataclass(frozen=True)
class Choice:
    """Choices of the user among the tables of a log.

    Attributes
    ----------
    tables : by role, the table that was named
    receive_times : times of receipt are taken, not the stamps of headers
    mapped : roles whose columns the user maps, so that their table may hold anything
    """

    tables: Mapping[str, str] = field(default_factory=dict[str, str])
    receive_times: bool = False
    mapped: frozenset[str] = frozenset()


class Source(Protocol):
    """An open log."""

    @property
    def path(self) -> Path:
        """The file or folder."""
        ...

    @property
    def tables(self) -> Mapping[str, Table]:
        """The tables."""
        ...

    @property
    def remarks(self) -> Sequence[str]:
        """Remarks of the reading, one sentence each."""
        ...

    def batches(self, wanted: Mapping[str, Collection[str]]) -> Iterator[Batch]:
        """The wanted columns of the wanted tables, in the order in which the log has them."""
        ...

    def guess(self, choice: Choice) -> Guess:
        """How to make a drive of this log."""
        ...


@dataclass(frozen=True)
class Frames:
    """A source whose tables fit into memory, as of most readers."""

    path: Path
    frames: Mapping[str, pl.DataFrame]
    guessed: Guess
    kinds: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def tables(self) -> dict[str, Table]:
        """The tables, as any source tells them."""
        return {k: Table(tuple(f.columns), self.kinds.get(k, ""), len(f)) for k, f in self.frames.items()}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Nothing: all was noticed when the guess was made."""
        return ()

    def batches(self, wanted: Mapping[str, Collection[str]]) -> Iterator[Batch]:
        """Each table as one batch."""
        for number, (table, columns) in enumerate(wanted.items(), 1):
            yield Batch(table, self.frames[table].select(list(columns)), number / len(wanted))

    def guess(self, choice: Choice) -> Guess:
        """The reader's guess; there is nothing to choose."""
        return self.guessed


@dataclass(frozen=True)
class Rows:
    """A source of one table whose rows are decoded one after the other, as of streams of receivers.

    Attributes
    ----------
    read : yields rows in the order of ``columns``, and the share of the file that is read
    """

    path: Path
    table: str
    columns: tuple[str, ...]
    read: Callable[[], Iterator[tuple[tuple[float, ...], float]]]
    guessed: Guess
    remarks: list[str] = field(default_factory=list[str])

    @property
    def tables(self) -> dict[str, Table]:
        """The one table."""
        return {self.table: Table(self.columns, "decoded")}

    def batches(self, wanted: Mapping[str, Collection[str]]) -> Iterator[Batch]:
        """Some thousand rows at a time."""
        rows: list[tuple[float, ...]] = []
        for row, done in self.read():
            rows.append(row)
            if len(rows) >= CHUNK:
                yield Batch(self.table, self._frame(rows), done)
                rows = []
        if rows:
            yield Batch(self.table, self._frame(rows), 1.0)

    def _frame(self, rows: list[tuple[float, ...]]) -> pl.DataFrame:
        return pl.DataFrame(rows, schema=dict.fromkeys(self.columns, pl.Float64), orient="row", strict=False)

    def guess(self, choice: Choice) -> Guess:
        """The reader's guess; there is nothing to choose."""
        return self.guessed


EXTRAS = {"ros": "rosbags mcap mcap-protobuf-support", "logs": "pyubx2 pynmeagps pyulog pymavlink"}
"""Packages of the extras, by their names for pip."""


def library(name: str, extra: str) -> Any:
    """Import a format's library, or raise an error that explains its installation."""
    try:
        return import_module(name)
    except ImportError:
        top = name.split(".")[0]
        raise InputError(
            f"this format needs {top}, which is not installed; run: pip install {EXTRAS[extra]}"
        ) from None


def require_distinct(columns: Sequence[str], path: Path) -> None:
    """Refuse a header that names a column twice, since it is ambiguous."""
    for name in columns:
        if columns.count(name) > 1:
            raise InputError(f"{path}: column {quoted(name)} appears twice; delete or rename one of them")


def first_bytes(path: Path, count: int = 4096) -> bytes:
    """The beginning of a file, empty for a folder, by which formats are recognized."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(count)
