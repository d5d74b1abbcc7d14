"""Where drives lie: folders, and what fsspec reads in their place (s3, gs, abfs, sftp, https ...), named by URLs.

A drive behind a URL is fetched into a folder that is removed again, and read there as any other: one reader, one set of
checks. Messages name the URL.
"""

import re
import shutil
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import drive_folders, read_with_warnings
from sigmaswarm.drives.sheet import FORMS
from sigmaswarm.errors import DriveError, InputError, SigmaswarmWarning
from sigmaswarm.wording import shown

Place = str | Path
"""A folder, or a URL."""

TABLES = tuple(f"{name}{form}" for name in ("imu", "gps", "odometer", "truth") for form in FORMS)


def is_url(place: Place) -> bool:
    """Whether fsspec is to read it."""
    return "://" in str(place)


def drive_places(place: Place) -> list[Place]:
    """A drive itself, or all drives inside a folder, in the order of their names: `drive_folders`, of URLs as well.

    Raises
    ------
    DriveError
        If a folder holds no drive, or a URL can't be listed.
    """
    if not is_url(place):
        return list(drive_folders(Path(place)))
    url = str(place).rstrip("/")
    with _told(url):
        system, path = _opened(url)
        if any(_is_there(system, f"{path}/{name}") for name in ("drive.toml", *TABLES[:4])):
            return [url]
        if not _is_there(system, path):
            raise FileNotFoundError(path)
        names = [str(entry).rstrip("/").rpartition("/")[2] for entry in system.ls(path, detail=False)]
        found = [
            name for name in sorted(names) if any(_is_there(system, f"{path}/{name}/{t}") for t in TABLES[:2])
        ]
        if not found:
            raise DriveError(
                f"{without_secrets(url)}: holds no drive; a drive is a folder with imu.csv, gps.csv and drive.toml"
            )
        return [f"{url}/{name}" for name in found]


def sizes_of(place: Place) -> dict[str, int]:
    """Bytes of a drive's tables where it lies, by their names; none where that can't be said: reading will tell."""
    with suppress(Exception):
        if not is_url(place):
            return {f.name: f.stat().st_size for f in Path(place).iterdir() if f.name in TABLES}
        system, path = _opened(str(place))
        listed = {
            str(e["name"]).rpartition("/")[2]: int(e["size"] or 0) for e in system.ls(path, detail=True)
        }
        return {name: listed[name] for name in TABLES if name in listed}
    return {}


def without_secrets(url: str) -> str:
    """A URL as messages name it: without what may be a secret."""
    return re.sub(r"(?<=://)[^/@]*@", "***@", url).partition("?")[0]


def read_place(place: Place) -> tuple[Drive, list[SigmaswarmWarning]]:
    """A drive, and what is told of it: `read_with_warnings`, of URLs as well."""
    if not is_url(place):
        return read_with_warnings(Path(place))
    url = str(place).rstrip("/")
    if "?" in url:
        raise InputError(
            f"{without_secrets(url)}?...: a drive has several files, which a signed URL can't name; give their folder"
        )
    with TemporaryDirectory(prefix="sigmaswarm-") as scratch:
        folder = Path(scratch) / (url.rpartition("/")[2] or "drive")
        with _told(url):
            _fetch(url, folder)
        try:
            drive, warned = read_with_warnings(folder)
        except DriveError as error:
            raise type(error)(str(error).replace(str(folder), without_secrets(url))) from None
    for one in warned:
        one.args = (str(one).replace(str(folder), without_secrets(url)),)
    return drive, warned


def _fetch(url: str, folder: Path) -> None:
    system, path = _opened(url)
    folder.mkdir()
    there = [name for name in ("drive.toml", *TABLES) if _is_there(system, f"{path}/{name}")]
    if not there:
        raise FileNotFoundError(path)
    for name in there:
        with system.open(f"{path}/{name}", "rb") as source, (folder / name).open("wb") as target:
            shutil.copyfileobj(source, target, 1 << 20)


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    try:
        import fsspec
    except ImportError:
        raise InputError(
            f"{without_secrets(url)}: reading URLs needs fsspec; run: pip install fsspec"
        ) from None
    system, path = fsspec.core.url_to_fs(url)
    return system, str(path).rstrip("/")


def _is_there(system: Any, path: str) -> bool:
    """Whether something is there; fsspec's own ``exists`` takes what may not be looked at for what is not there."""
    try:
        system.info(path)
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


@contextmanager
def _told(url: str) -> Generator[None]:
    """What fsspec and the libraries below it raise, as one line."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except FileNotFoundError:
        raise DriveError(
            f"{without_secrets(url)} does not exist, or can't be seen from here; name a drive's folder"
        ) from None
    except Exception as error:  # each protocol's library has errors of its own
        why = shown(without_secrets(f"{type(error).__name__}: {error}"), 200)
        raise DriveError(
            f"{without_secrets(url)}: can't be read ({why}); look at the address and your right to read it"
        ) from None


def listed_places(places: Iterable[Place]) -> list[Place]:
    """All drives of some folders and URLs."""
    return [drive for place in places for drive in drive_places(place)]
