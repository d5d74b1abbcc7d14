"""Find the drive from which a part was split."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sigmaswarm.drives.description import cut_of, read_description
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.reader import Location, has_table, read_with_warnings
from sigmaswarm.drives.urls import is_url
from sigmaswarm.errors import DriveError

MAX_FOLDERS = 1000  # maximum number of searched folders


def find_whole(part: Location) -> tuple[Drive, Path] | None:
    """Return the drive from which a part was split, and the folder of this drive.

    Return None if it is not found near the part's folder (see `_near`).

    The part's drive.toml states the fingerprint of this drive.
    """
    if is_url(part):
        return None
    cut = cut_of(description_of(Path(part)))
    name, sha256 = cut.get("drive"), cut.get("sha256")
    for folder in _near(Path(part)):
        if folder.name == name or description_of(folder).get("name") == name:
            try:
                drive, _ = read_with_warnings(folder)
            except DriveError:
                continue
            if fingerprint(drive) == sha256:
                return drive, folder
    return None


def _near(part: Path) -> Iterator[Path]:
    """Yield drive folders up to two levels below the parent and the grandparent folder of a part."""
    bases = dict.fromkeys((part.parent, part.parent.parent))
    folders = (folder for base in bases for pattern in ("*", "*/*") for folder in sorted(base.glob(pattern)))
    for folder, _ in zip(folders, range(MAX_FOLDERS), strict=False):
        if folder != part and (folder / "drive.toml").is_file() and has_table(folder, "imu"):
            yield folder


def description_of(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's drive.toml; {} if the file is missing or damaged."""
    try:
        return read_description(folder / "drive.toml")
    except DriveError:
        return {}
