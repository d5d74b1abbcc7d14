"""Find files in a folder or a zip, and unpack them."""

import shutil
import tempfile
import zipfile
from collections.abc import Collection
from contextlib import ExitStack
from pathlib import Path, PurePosixPath

from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import require_text
from sigmaswarm.importing.source import Limits, errors_as_damage


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
                f"{path}: contains {name}, which is encrypted; unpack the zip, and name the folder"
            )
    return wanted
