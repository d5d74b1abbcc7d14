"""Where a worker gets a drive from: read where it lies, made by the simulator, or handed over by the client."""

from dataclasses import dataclass
from typing import Protocol

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.places import Place, read_place, sizes_of
from sigmaswarm.errors import SigmaswarmWarning

PER_HELD_BYTE, PER_CSV_BYTE, PER_PARQUET_BYTE = 3.3, 1.7, 8.0
"""Bytes that a worker needs for a byte of a drive's columns, and for one on disk; with truth, `benchmarks/fleet.py`."""


class Source(Protocol):
    """Where a drive comes from; small enough to travel, but for drives that the client holds."""

    def read(self) -> tuple[Drive, list[SigmaswarmWarning]]:
        """The drive, and what is told of it."""
        ...

    def size(self) -> float:
        """Bytes that a worker will need for it, about; 0 where that can't be said."""
        ...


@dataclass(frozen=True)
class At:
    """A drive that all workers can read: in a folder, or behind a URL."""

    place: Place

    def read(self) -> tuple[Drive, list[SigmaswarmWarning]]:
        """Read it."""
        return read_place(self.place)

    def size(self) -> float:
        """By the size of its files."""
        each = sizes_of(self.place).items()
        return sum(n * (PER_PARQUET_BYTE if name.endswith(".parquet") else PER_CSV_BYTE) for name, n in each)


@dataclass(frozen=True, eq=False)
class Given:
    """A drive that the client holds, and sends."""

    drive: Drive

    def read(self) -> tuple[Drive, list[SigmaswarmWarning]]:
        """Nothing is read."""
        return self.drive, []

    def size(self) -> float:
        """By its numbers."""
        return need_of(self.drive)


def need_of(drive: Drive) -> float:
    """Bytes that a worker needs for a drive: its columns, and what is made of them for filters."""
    tables = (drive.imu, drive.gps, drive.truth, drive.odometer)
    columns = [c for table in tables if table is not None for c in vars(table).values() if c is not None]
    return PER_HELD_BYTE * sum(column.nbytes for column in columns)
