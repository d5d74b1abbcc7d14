"""Common parts of exports of phones: folders or zips of CSVs, and the mounting of a phone."""

import shutil
import tempfile
import zipfile
from collections.abc import Collection, Generator, Iterable
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.columns import ColumnFiles, scan, tables_of
from sigmaswarm.importing.source import Guess
from sigmaswarm.wording import shown

FLAT = "the phone taken as lying flat, screen up, top edge forward; turn it with --mount"
"""A phone's x points right and y to its top edge (Android's SensorEvent): forward is y, left is -x."""
RADIUS_68 = 1.515
"""A circle with 68% of normal errors has so many standard deviations of one axis: sqrt(-2 ln 0.32)."""


def names_in(path: Path) -> set[str]:
    """The names of a folder's or a zip's files, without their folders."""
    if path.is_dir():
        return {file.name for file in path.iterdir() if file.is_file()}
    if path.suffix.lower() == ".zip" and zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return {PurePosixPath(name).name for name in archive.namelist()}
        except Exception:  # a damaged directory: nothing is known of what is in it
            return set()
    return set()


@contextmanager
def unpacked(path: Path, names: Collection[str], limits: Limits) -> Generator[Path]:
    """The folder with the files: itself, or a temporary one with those of a zip that are wanted, and no others."""
    if path.is_dir():
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        try:
            with zipfile.ZipFile(path) as archive:
                for member in _wanted(archive, path, names, limits):
                    with archive.open(member) as packed, (Path(folder) / _name(member)).open("wb") as file:
                        shutil.copyfileobj(packed, file)
        except InputError:
            raise
        except Exception as error:  # the library raises anything on damaged bytes
            said = shown(" ".join(str(error).split()), 160)
            raise InputError(f"{path}: is cut short or no zip ({said}); export it again") from None
        yield Path(folder)


def _wanted(
    archive: zipfile.ZipFile, path: Path, names: Collection[str], limits: Limits
) -> list[zipfile.ZipInfo]:
    """The files of those names in the outermost folder that has any of them."""
    found = [m for m in archive.infolist() if not m.is_dir() and _name(m) in names]
    outermost = min((_folder(m) for m in found), key=lambda f: (len(f.parts), str(f)), default=None)
    wanted = {_name(m): m for m in found if _folder(m) == outermost}
    limits.check_unpacked(sum(m.file_size for m in wanted.values()), path)
    for name, member in wanted.items():
        if member.flag_bits & 1:
            raise InputError(f"{path}: {name} in it is encrypted; unpack it, and name the folder")
    return list(wanted.values())


def _name(member: zipfile.ZipInfo) -> str:
    return PurePosixPath(member.filename).name


def _folder(member: zipfile.ZipInfo) -> PurePosixPath:
    return PurePosixPath(member.filename).parent


def phone_files(path: Path, folder: Path, guess: Guess, names: Iterable[str], limits: Limits) -> ColumnFiles:
    """The export's tables that are there, by their file names."""
    remarks: list[str] = []
    scans: dict[str, pl.LazyFrame] = {
        n: scan(folder / n, path / n, limits, remarks) for n in names if (folder / n).is_file()
    }
    return ColumnFiles(path, scans, tables_of(scans, "CSV"), guess, tuple(remarks))
