"""Read drives from URLs with fsspec (s3, gs, abfs, sftp, https ...), through a temporary copy."""

import re
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from sigmaswarm.drives.table_files import TABLES
from sigmaswarm.errors import DriveError, InputError, not_installed
from sigmaswarm.wording import printable

A_DRIVE = "a drive is a folder with imu.csv, gps.csv and drive.toml"


def is_url(location: str | Path) -> bool:
    return "://" in str(location)


def without_secrets(url: str) -> str:
    """Remove user, password and query from a URL, for messages."""
    return re.sub(r"(?<=://)[^/@]*@", "***@", url).partition("?")[0]


def drive_urls(url: str) -> list[str]:
    """Return the URL if it names a drive, otherwise the URLs of all drives below it, sorted by name."""
    url = url.rstrip("/")
    with _errors_in_one_line(url):
        system, path = _opened(url)
        if any(_exists(system, f"{path}/{name}") for name in ("drive.toml", *TABLES[:4])):
            return [url]
        if not _exists(system, path):
            raise FileNotFoundError(path)
        names = [str(entry).rstrip("/").rpartition("/")[2] for entry in system.ls(path, detail=False)]
        drives = [
            name for name in sorted(names) if any(_exists(system, f"{path}/{name}/{t}") for t in TABLES[:2])
        ]
        if not drives:
            raise DriveError(f"{without_secrets(url)}: contains no drive; {A_DRIVE}")
        return [f"{url}/{name}" for name in drives]


@contextmanager
def local_copy(url: str) -> Generator[Path]:
    """Copy the files of a drive to a temporary folder, which is removed at the end of the block."""
    if "?" in url:
        raise InputError(
            f"{without_secrets(url)}?...: a drive has several files, but a signed URL names only one; pass the "
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
    """Return True if a path exists. ``exists`` of fsspec would return False if permission is denied."""
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
            f"{without_secrets(url)} does not exist, or is not accessible from this machine; specify the folder "
            "of a drive"
        ) from None
    except Exception as error:  # each protocol's library has its own errors
        why = printable(without_secrets(f"{type(error).__name__}: {error}"), 200)
        raise DriveError(
            f"{without_secrets(url)}: can't be read ({why}); check the address and your permission to read it"
        ) from None
