"""What phones' exports share: folders or zips of CSVs, and how a phone lies in a vehicle."""

import tempfile
import zipfile
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.readers.columns import ColumnFiles, scan
from sigmaswarm.importing.source import Guess, Table

FLAT = "the phone taken as lying flat, screen up, top edge forward; turn it with --mount"
"""A phone's x points right and y to its top edge (Android's SensorEvent): forward is y, left is -x."""
RADIUS_68 = 1.515
"""A circle with 68% of normal errors has so many standard deviations of one axis: sqrt(-2 ln 0.32)."""


def names_in(path: Path) -> set[str]:
    """The names of a folder's or a zip's files, without their folders."""
    if path.is_dir():
        return {file.name for file in path.iterdir() if file.is_file()}
    if path.suffix.lower() == ".zip" and zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return {Path(name).name for name in archive.namelist()}
    return set()


@contextmanager
def unpacked(path: Path) -> Generator[Path]:
    """The folder with the files: itself, or a temporary one for a zip."""
    if path.is_dir():
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        try:
            with zipfile.ZipFile(path) as archive:
                archive.extractall(folder)
        except (zipfile.BadZipFile, OSError, EOFError) as error:
            raise InputError(f"{path}: is cut short or no zip ({error}); export it again") from None
        csvs = sorted(Path(folder).rglob("*.csv"), key=lambda file: len(file.parts))
        yield csvs[0].parent if csvs else Path(folder)


def phone_files(path: Path, folder: Path, guess: Guess, names: Iterable[str]) -> ColumnFiles:
    """The export's tables that are there, by their file names."""
    scans: dict[str, pl.LazyFrame] = {n: scan(folder / n) for n in names if (folder / n).is_file()}
    tables = {name: Table(tuple(s.collect_schema().names()), "CSV") for name, s in scans.items()}
    return ColumnFiles(path, scans, tables, guess)
