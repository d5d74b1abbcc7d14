"""URLs of drives that fsspec reads (s3, gs, abfs, sftp, https ...), through a temporary copy."""

import re
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import Any

from sigmaswarm.drives.table_files import TABLES
from sigmaswarm.errors import DriveError, InputError, not_installed
from sigmaswarm.wording import printable

A_DRIVE = "a drive is a folder with imu.csv, gps.csv and drive.toml"
TEXTS = (".csv", ".tsv", ".txt")
# Words in the name and the first line of a table that show its content
_AXES = re.compile(r"(?<![a-z])[ag]_?[xyz](?![a-z])", re.IGNORECASE)
_MOTION = re.compile(r"acc(?!urac)|gyro|angular|imu", re.IGNORECASE)
_PLACE = re.compile(r"lat|lon|gps|gnss|east|north|utm|posi", re.IGNORECASE)
_XY = re.compile(r"(?<![a-z])[xy](?![a-z])", re.IGNORECASE)


def importing(log: Path) -> str:
    """Return the remedy for a log of another format: the command that makes a drive of it, or of its folder."""
    log = _whole_log(log)
    out = Path("drives") / log.resolve().name.removesuffix(log.suffix)
    return f"to make one from a log: sigmaswarm import {quote(str(log))} --out {quote(str(out))}"


def _whole_log(file: Path) -> Path:
    """Return the folder of a table without IMU or positions, if the tables of this folder have both; else the file."""
    if file.suffix.lower() not in TEXTS or not file.is_file():
        return file
    tables = [table for table in sorted(file.parent.iterdir()) if table.suffix.lower() in TEXTS]
    content = {table: _content(table) for table in tables[:100]}
    together = {kind for found in content.values() for kind in found}
    return file.parent if len(content.get(file, ())) == 1 and len(together) == 2 else file


def _content(table: Path) -> set[str]:
    """Return "imu" or "gps", or both, for what the name and the first line of a table show."""
    with table.open(encoding="utf-8", errors="replace") as lines:
        title = lines.readline(4096)
    text = f"{table.stem},{title}"
    axes = _AXES.search(title) is not None
    imu = axes or _MOTION.search(text) is not None
    # x and y of a table of one sensor are its axes.
    place = _PLACE.search(text) is not None or (_XY.search(title) is not None and (axes or not imu))
    return {kind for kind, found in (("imu", imu), ("gps", place)) if found}


def is_url(location: str | Path) -> bool:
    return "://" in str(location)


def without_secrets(url: str) -> str:
    """Remove user, password and query from a URL, for messages."""
    return re.sub(r"(?<=://)[^/@]*@", "***@", url).partition("?")[0]


def drive_urls(url: str) -> list[str]:
    """Return the URL if it names a drive, else the URLs of all drives in this folder, sorted by name."""
    url = url.rstrip("/")
    with _errors_in_one_line(url):
        system, path = _opened(url)
        if any(_exists(system, f"{path}/{name}") for name in ("drive.toml", *TABLES[:4])):
            return [url]
        if not _exists(system, path):
            raise FileNotFoundError(path)
        names = [str(entry).rstrip("/").rpartition("/")[2] for entry in system.ls(path, detail=False)]
        found = [
            name for name in sorted(names) if any(_exists(system, f"{path}/{name}/{t}") for t in TABLES[:2])
        ]
        if not found:
            raise DriveError(f"{without_secrets(url)}: contains no drive; {A_DRIVE}")
        return [f"{url}/{name}" for name in found]


@contextmanager
def local_copy(url: str) -> Generator[Path]:
    """Copy the files of a drive to a temporary folder, which is removed at the end of the block."""
    if "?" in url:
        raise InputError(
            f"{without_secrets(url)}?...: a drive has several files, which a signed URL can't name; pass the "
            "URL of their folder"
        )
    with TemporaryDirectory(prefix="sigmaswarm-") as scratch:
        folder = Path(scratch) / (url.rpartition("/")[2] or "drive")
        folder.mkdir()
        with _errors_in_one_line(url):
            system, path = _opened(url)
            names = [name for name in ("drive.toml", *TABLES) if _exists(system, f"{path}/{name}")]
            if not names:
                raise FileNotFoundError(path)
            for name in names:
                with system.open(f"{path}/{name}", "rb") as source, (folder / name).open("wb") as target:
                    shutil.copyfileobj(source, target, 1 << 20)
        yield folder


def _opened(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise not_installed(f"{without_secrets(url)}: reading URLs", "fsspec") from None
    system, path = fsspec.core.url_to_fs(url)
    return system, str(path).rstrip("/")


def _exists(system: Any, path: str) -> bool:
    """Return True if a path exists; ``exists`` of fsspec would return False if permission is denied."""
    try:
        system.info(path)
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


@contextmanager
def _errors_in_one_line(url: str) -> Generator[None]:
    try:
        yield
    except (InputError, MemoryError):
        raise
    except FileNotFoundError:
        raise DriveError(
            f"{without_secrets(url)} does not exist, or is not accessible from this machine; name the folder of a drive"
        ) from None
    except Exception as error:  # each protocol's library has its own errors
        why = printable(without_secrets(f"{type(error).__name__}: {error}"), 200)
        raise DriveError(
            f"{without_secrets(url)}: can't be read ({why}); check the address and your permission to read it"
        ) from None
