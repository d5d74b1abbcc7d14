"""A log as named tables that are read in batches, and the parts of these tables that become a drive."""

import re
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.expressions import is_valid_expression
from sigmaswarm.wording import list_names, printable, quoted

Role = Literal["imu", "gps", "truth", "odometer", "mag"]
ROLES: tuple[Role, ...] = ("imu", "gps", "truth", "odometer", "mag")
CHUNK = 5000  # rows of a batch
SAMPLE_ROWS = 2000  # number of first rows from which units are guessed, if rows are decoded one by one
FILES = "columns"
ImportProgress = Callable[[float], None]  # receives the fraction of the log that has been read, 0 to 1
Wanted = Mapping[str, Collection[str]]
# A table, rows with its wanted columns, and the fraction of the log that has been read, 0 to 1
Batch = tuple[str, pl.DataFrame, float]


@dataclass(frozen=True)
class Limits:
    rows: int = 10_000_000  # of a table; 10 million are 28 hours at 100 Hz
    columns: int = 100_000  # of all tables of a log
    # MB in memory at once: a bag's chunk, a MATLAB variable, a JSON file, or the required files of a zip
    unpacked_mb: int = 500

    def check_rows(self, count: int, path: Path, table: str) -> None:
        if count > self.rows:
            where = path if path.name == table else f"{path}, {table}"
            raise InputError(
                f"{where}: contains more than {self.rows} rows; split the log, or raise --max-rows"
            )

    def check_unpacked(self, count: int, path: Path) -> None:
        if count > self.unpacked_mb * 1_000_000:
            raise InputError(
                f"{path}: needs at least {count / 1e6:.0f} MB in memory at once, but the limit is {self.unpacked_mb} "
                "MB; raise --max-unpacked-mb, divide the log, or unpack a zip yourself and import its folder"
            )

    def first_columns(self, names: Iterator[str], path: Path) -> tuple[str, ...]:
        """Return the names that are not empty. Empty names also count toward the limit, since each name takes time."""
        found = list(islice(names, self.columns + 1))
        if len(found) > self.columns:
            raise InputError(
                f"{path}: has more than {self.columns} columns; raise --max-columns if the log is not damaged"
            )
        return tuple(name for name in found if name)

    def less(self, columns: int) -> "Limits":
        """Return the limits that remain for the other tables."""
        return replace(self, columns=self.columns - columns)


@dataclass(frozen=True)
class Table:
    """A table of a log: its columns, its kind in the terms of the format, and its number of rows if known."""

    columns: tuple[str, ...]
    kind: str = ""
    rows: int | None = None


@dataclass(frozen=True)
class Part:
    """Columns of a drive (with ``t``), as expressions over the columns of one table."""

    table: str
    columns: Mapping[str, str]


def texts_of(parts: Iterable[Part]) -> dict[str, str]:
    """Return the expressions of parts, by column of the drive."""
    return {name: text for part in parts for name, text in part.columns.items()}


@dataclass(frozen=True)
class Fault:
    """Reason not to use a column unchanged (an unknown unit, raw counts), with the remedy."""

    role: Role
    column: str
    table: str
    sentence: str


@dataclass(frozen=True)
class Placement:
    """Mounting of the IMU, and lever arm, as stated in a log."""

    mount: str  # roll, pitch and yaw of the IMU in the vehicle, deg: see `parse_mount`
    lever_arm: tuple[float, float, float] | None  # m forward, left, up from IMU to antenna
    frames: tuple[str, str, str]  # names of the frames of the vehicle, the IMU and the antenna

    def notes(self, mount: str, lever_arm: Any) -> Iterator[str]:
        base, imu, antenna = self.frames
        if mount == self.mount:
            yield f"mounting {mount} deg (roll, pitch, yaw) is taken from tf_static ({imu} in {base})"
        if self.lever_arm and lever_arm == self.lever_arm:
            x, y, z = self.lever_arm
            yield f"lever arm {x:.4g},{y:.4g},{z:.4g} m is taken from tf_static, from {imu} to {antenna} in {base}"
        elif not self.lever_arm:
            yield f"tf_static does not contain the position of {antenna or 'the antenna'}; specify it with --lever-arm"


@dataclass(frozen=True)
class TickRate:
    """Rate of a counter (Hz), the expression of the clock from which the rate was computed, and the table of both."""

    rate: float
    clock: str
    table: str


@dataclass(frozen=True)
class Guess:
    """The recipe that a reader guesses for a log, and its assumptions."""

    roles: Mapping[Role, tuple[Part, ...]]  # times are those of the first part; other parts are interpolated
    notes: tuple[str, ...] = ()  # sentences for the user
    origin: tuple[float, float, float] | None = None  # deg, deg, m, of the truth's frame
    metadata: Mapping[str, Any] = field(default_factory=dict[str, Any])  # keys for drive.toml
    flat: str = ""  # assumption on a phone's mounting, for an import without a mounting
    downward: str = ""  # sentence if the IMU's vertical axis points down, for an import without a mounting
    fixed: str = ""  # expression over the fixes' first table, true for integer ambiguities
    faults: tuple[Fault, ...] = ()  # reasons not to use columns unchanged, unless the user maps them
    placed: Placement | None = None
    # Columns of the IMU's table whose unit is unknown, as text of expressions, by column of the drive
    unitless: Mapping[str, str] = field(default_factory=dict[str, str])
    # Counters whose unit is guessed from their steps, as text of expressions, by role; rates of counters
    ticks: Mapping[Role, str] = field(default_factory=dict[Role, str])
    rates: Mapping[str, TickRate] = field(default_factory=dict[str, TickRate])
    # Roles and columns to which notes refer; such a note is for recipes that read a column as guessed
    about: Mapping[str, Sequence[tuple[Role, str]]] = field(
        default_factory=dict[str, Sequence[tuple["Role", str]]]
    )

    def notes_on(self, read: Callable[[Role, str, str], bool]) -> Iterator[str]:
        """Yield the notes, without those on columns that are not read as guessed.

        ``read`` receives role, column and guessed expression. It returns True if the column is read as guessed.
        """
        guessed = {role: texts_of(parts) for role, parts in self.roles.items()}
        for note in self.notes:
            about = self.about.get(note, ())
            if not about or any(read(r, n, guessed.get(r, {}).get(n, "")) for r, n in about):
                yield note


@dataclass(frozen=True)
class TableChoice:
    tables: Mapping[str, str] = field(default_factory=dict[str, str])  # by role
    receive_times: bool = False  # True to use receive times instead of header stamps
    mapped: frozenset[str] = frozenset()  # roles with mapped columns; any table can be chosen for them


@dataclass(frozen=True)
class Log:
    path: Path
    tables: Mapping[str, Table]
    batches: Callable[[Wanted], Iterator[Batch]]  # reads the wanted columns, in the order of the log
    guess: Callable[[TableChoice], Guess]
    remarks: list[str] = field(
        default_factory=list[str]
    )  # for the user; some are added while batches are read
    mixed: bool = False  # True if rows of the tables alternate, so that all tables occur near the beginning

    def guessed(self, guess: Guess) -> "Log":
        return Log(self.path, self.tables, self.batches, lambda _: guess, self.remarks, self.mixed)

    def first_rows(self, table: str) -> pl.DataFrame:
        """Return the first batch of a table with all columns, or an empty frame if the table has no rows."""
        batches = self.batches({table: self.tables[table].columns})
        return next((rows for _, rows, _ in batches if len(rows)), pl.DataFrame())


def log_of_frames(
    path: Path, frames: Mapping[str, pl.DataFrame], kind: str, guess: Callable[[TableChoice], Guess]
) -> Log:
    tables = {name: Table(tuple(f.columns), kind, len(f)) for name, f in frames.items()}

    def batches(wanted: Wanted) -> Iterator[Batch]:
        for number, (table, columns) in enumerate(wanted.items(), 1):
            yield table, frames[table].select(list(columns)), number / len(wanted)

    return Log(path, tables, batches, guess)


def log_of_rows(
    path: Path,
    table: str,
    columns: tuple[str, ...],
    read: Callable[[], Iterator[tuple[tuple[float, ...], float]]],
    guess: Guess,
    remarks: list[str],
) -> Log:
    """Make a log of one table. ``read`` yields its rows, each with the fraction of the file that has been read."""

    def batches(wanted: Wanted) -> Iterator[Batch]:
        rows: list[tuple[float, ...]] = []
        schema = dict.fromkeys(columns, pl.Float64)
        for row, done in read():
            rows.append(row)
            if len(rows) >= CHUNK:
                yield table, pl.DataFrame(rows, schema, orient="row", strict=False), done
                rows = []
        if rows:
            yield table, pl.DataFrame(rows, schema, orient="row", strict=False), 1.0

    return Log(path, {table: Table(columns, "decoded")}, batches, lambda _: guess, remarks)


def roles_of(
    parts: Iterable[tuple[Role, str, Mapping[str, str | tuple[str, ...]]]], tables: Wanted
) -> dict[Role, tuple[Part, ...]]:
    """Return the parts of existing tables, by role. Of several expressions, use the first whose columns exist."""
    roles: dict[Role, tuple[Part, ...]] = {}
    for role, table, columns in parts:
        if table in tables:
            found = {
                name: text
                if isinstance(text, str)
                else next((t for t in text if is_valid_expression(t, tables[table])), "")
                for name, text in columns.items()
            }
            part = Part(table, {name: text for name, text in found.items() if text})
            roles[role] = (*roles.get(role, ()), part)
    return roles


# Packages of the extras, as arguments of pip
EXTRAS = {"ros": "rosbags mcap mcap-protobuf-support pyyaml", "logs": "pyubx2 pynmeagps pyulog pymavlink"}


def import_library(name: str, extra: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        top = name.split(".")[0]
        raise InputError(
            f"this format needs {top}, which is not installed; run: pip install {EXTRAS[extra]}"
        ) from None


def require_distinct(columns: Sequence[str], path: Path) -> None:
    for name in columns:
        if columns.count(name) > 1:
            raise InputError(f"{path}: column {quoted(name)} appears twice; delete or rename one of them")


def first_bytes(path: Path, count: int = 4096) -> bytes:
    """Return the beginning of a file; empty for a folder."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(count)


def is_empty(path: Path) -> bool:
    """Return True for a file without bytes, or with blank lines only."""
    head = first_bytes(path)
    return (
        path.is_file() and path.stat().st_size == len(head) and not head.removeprefix(b"\xef\xbb\xbf").strip()
    )


def require_filled(file: Path, shown_as: Path) -> None:
    if is_empty(file):
        raise InputError(f"{shown_as} is empty; copy it again")


def no_log_error(folder: Path) -> InputError:
    remedy = "specify a log file or the folder of a log"
    if not (files := sorted(entry.name for entry in folder.iterdir())):
        return InputError(f"{folder}: is an empty folder; {remedy}")
    return InputError(
        f"{folder}: contains no log of a known format (it contains {list_names(files)}); {remedy}"
    )


@contextmanager
def errors_as_damage(path: Path, what: str = "", remedy: str = "record or copy it again") -> Generator[None]:
    """Convert any exception that a library raises on damaged bytes to a one-line error."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise damage_error(path, error, what, remedy) from None


def damage_error(
    path: Path, error: Exception, what: str = "", remedy: str = "record or copy it again"
) -> InputError:
    reason = " ".join(str(error).split()) or type(error).__name__
    reason = printable(re.sub(r"^b'(.*)'$", r"\1", reason), 160)
    return InputError(f"{path}: {what or 'is cut short or broken'} ({reason}); {remedy}")
