"""Exports of phones, as folders or zips of CSVs, and the mounting of a phone."""

import shutil
import tempfile
import zipfile
from collections.abc import Collection
from contextlib import ExitStack
from pathlib import Path, PurePosixPath

from sigmaswarm.errors import InputError
from sigmaswarm.importing.readers.columns import of_files, scan
from sigmaswarm.importing.source import Guess, Limits, Log, whole
from sigmaswarm.limits import require_text

FLAT = (
    "the phone is assumed to lie flat with the screen up and the top edge forward; otherwise add --mount, or "
    "--mount auto"
)
"""A phone's x points right and y to its top edge (Android's SensorEvent): forward is y, left is -x."""
NOTHING = Guess({})
RADIUS_68 = 1.515
"""Radius of a circle that contains 68% of normal errors, in standard deviations per axis: sqrt(-2 ln 0.32)."""


def names_in(path: Path) -> set[str]:
    if path.is_dir():
        return {file.name for file in path.iterdir() if file.is_file()}
    if path.suffix.lower() == ".zip" and zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return {PurePosixPath(name).name for name in archive.namelist()}
        except Exception:  # the zip's directory is damaged
            return set()
    return set()


def phone_files(
    path: Path, names: Collection[str], limits: Limits, stack: ExitStack, guessed: Guess | None = NOTHING
) -> Log:
    """Open the named tables of a folder, or of a zip, which is unpacked to a temporary folder."""
    folder = path if path.is_dir() else Path(stack.enter_context(tempfile.TemporaryDirectory()))
    if not path.is_dir():
        with whole(path, "is damaged or not a zip file", "export it again"), zipfile.ZipFile(path) as archive:
            for name, member in _wanted(archive, path, names, limits).items():
                with archive.open(member) as packed, (folder / name).open("wb") as file:
                    shutil.copyfileobj(packed, file)
                _, lines = require_text(folder / name, path / name)
                limits.check_rows(lines, path, name)
    remarks: list[str] = []
    there = [name for name in names if (folder / name).is_file()]
    scans = {name: scan(folder / name, path / name, limits, remarks) for name in there}
    return of_files(path, scans, "CSV", guessed, remarks)


def _wanted(
    archive: zipfile.ZipFile, path: Path, names: Collection[str], limits: Limits
) -> dict[str, zipfile.ZipInfo]:
    """Find the files of these names in the outermost folder that contains any of them."""
    found = [(PurePosixPath(m.filename), m) for m in archive.infolist() if not m.is_dir()]
    found = [(inside, m) for inside, m in found if inside.name in names]
    folders = {inside.parent for inside, _ in found}
    outermost = min(folders, key=lambda f: (len(f.parts), str(f)), default=None)
    wanted = {inside.name: m for inside, m in found if inside.parent == outermost}
    limits.check_unpacked(sum(m.file_size for m in wanted.values()), path)
    for name, member in wanted.items():
        if member.flag_bits & 1:
            raise InputError(f"{path}: contains {name}, which is encrypted; unpack it, and name the folder")
    return wanted
