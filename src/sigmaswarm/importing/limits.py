"""Limits on the size of a log: a small file can unpack to more than the memory."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from sigmaswarm.errors import InputError


@dataclass(frozen=True)
class Limits:
    """Limits of an import; they can be raised.

    Attributes
    ----------
    rows : of a table; 10 million are 28 hours at 100 Hz
    columns : of all tables of a log
    unpacked_mb : MB of a chunk, or of the required files of a zip, after unpacking
    """

    rows: int = 10_000_000
    columns: int = 100_000
    unpacked_mb: int = 500

    def check_rows(self, count: int, path: Path, table: str) -> None:
        """Refuse a table of too many rows."""
        if count > self.rows:
            where = path if path.name == table else f"{path}, {table}"
            raise InputError(
                f"{where}: contains more than {self.rows} rows; split the log, or raise --max-rows"
            )

    def check_unpacked(self, count: int, path: Path) -> None:
        """Refuse data of too many bytes."""
        if count > self.unpacked_mb * 1_000_000:
            raise InputError(
                f"{path}: would unpack at least {count / 1e6:.0f} MB at once, more than {self.unpacked_mb}; unpack it "
                "yourself, or raise --max-unpacked-mb"
            )

    def first_columns(self, names: Iterator[str], path: Path) -> tuple[str, ...]:
        """All names but empty ones, which count towards the limit, too, since fields without a number take time."""
        found = list(islice(names, self.columns + 1))
        if len(found) > self.columns:
            raise InputError(
                f"{path}: has more than {self.columns} columns; raise --max-columns if this is right"
            )
        return tuple(name for name in found if name)

    def less(self, columns: int) -> "Limits":
        """Return the limits that remain for the other tables of a log."""
        return replace(self, columns=self.columns - columns)
