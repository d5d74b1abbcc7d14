"""Folder of the workbench: logs, drives, tunings and other results by name, and the user's choices."""

import re
import shutil
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import sigmaswarm
from sigmaswarm import Drive, InputError
from sigmaswarm.files import free_path, make_folder, write_json
from sigmaswarm.record_files import content_if_readable

KINDS = ("logs", "drives", "tunings", "evaluations", "exports")
DRIVE, TUNING = "drive.toml", "tuning.toml"
LEFT_OUT = "leave it out"
CHECKED = "-checked"  # suffix of a repaired or cut copy of a drive, whose drive.toml lists the ``steps``
NAME = re.compile(r"[\w][\w .()+-]{0,99}")
MAX_UPLOAD_SIZE = 2_000_000_000  # bytes of an upload; the command line opens larger logs
TOO_LARGE = "larger than 2 GB; open the log from the command line: sigmaswarm workbench LOG"
T = TypeVar("T")


class Workbench:
    """State of a workbench: its folder (created if missing), its logs, and the user's choices."""

    def __init__(self, folder: Path, logs: Sequence[Path] = ()) -> None:
        for log in logs:
            if not log.exists():
                raise InputError(f"{log} does not exist; specify a log file or its folder")
        self.folder = make_folder(folder).resolve()
        for kind in KINDS:
            make_folder(self.folder / kind)
        self.named = tuple(log.resolve() for log in logs)
        self._file = self.folder / "workbench.json"
        self.choices = content_if_readable(self._file)
        self._cached = lru_cache(6)(_read_version)
        if self.named:
            self.choices["log"] = str(self.named[0])

    def save(self) -> None:
        write_json(self._file, self.choices)

    def path(self, kind: str, name: str) -> Path:
        """Return the folder of a drive or of a result. Raises `InputError` for an invalid name or a link."""
        path = self.folder / kind / name
        if kind not in KINDS or not NAME.fullmatch(name) or path.is_symlink():
            raise InputError(f"{name!r} is not a valid name; use letters, digits, - and _")
        return path

    def names(self, kind: str, file: str = "") -> list[str]:
        """List the names of drives or of results of one kind, the newest last.

        If ``file`` is given, list only folders that contain it.
        """
        folders = [p for p in (self.folder / kind).iterdir() if NAME.fullmatch(p.name) and not p.is_symlink()]
        folders = [p for p in folders if not file or (p / file).is_file()]
        return [p.name for p in sorted(folders, key=lambda p: (p.stat().st_mtime, p.name))]

    def free(self, kind: str, name: str) -> str:
        """Return a valid name made from ``name``, with a number appended if that name exists."""
        name = re.sub(r"[^\w.+-]+", "-", name).strip("-.") or kind.removesuffix("s")
        return free_path(self.path(kind, name)).name

    @property
    def drives(self) -> list[str]:
        """Names of the drives for tuning. A checked copy replaces the drive of which it is a copy."""
        names = self.drive_names
        return [name for name in names if name + CHECKED not in names]

    @property
    def drive_names(self) -> list[str]:
        return self.names("drives", DRIVE)

    def read(self, name: str) -> Drive:
        path = self.path("drives", name)
        return self._cached(path, path.stat().st_mtime_ns)

    def write(self, drive: Drive) -> str:
        sigmaswarm.write_drive(drive, self.path("drives", drive.name), overwrite=True)
        return drive.name

    @property
    def sources(self) -> list[Path]:
        """Logs that can be opened: arguments of the command, dropped files and folders, and the files in folders."""
        tops = [*self.named, *(self.folder / "logs" / name for name in self.names("logs"))]
        inside = (path for top in tops if top.is_dir() for path in sorted(top.iterdir()))
        return [*tops, *(p for p in inside if not p.name.startswith(".") and not p.is_symlink())]

    @property
    def log(self) -> Path | None:
        chosen = self.choices.get("log")
        return next((path for path in self.sources if str(path) == chosen), None)

    @property
    def log_choices(self) -> dict[str, Any]:
        return self.choices.setdefault("logs", {}).setdefault(str(self.log), {})

    @property
    def unfinished(self) -> list[str]:
        begun = self.names("tunings", "config.json")
        return [name for name in begun if not (self.path("tunings", name) / TUNING).exists()]

    @property
    def finished(self) -> list[str]:
        return self.names("tunings", TUNING)

    def remove(self, kind: str, name: str) -> None:
        path = self.path(kind, name)
        if path.exists():
            shutil.rmtree(path)


def _read_version(path: Path, _: int) -> Drive:
    return sigmaswarm.read_drive(path)


def attempt(work: Callable[..., T], *arguments: Any, **options: Any) -> tuple[T | None, str]:
    """Run a function. Return its result and "", or None and the error message."""
    try:
        return work(*arguments, **options), ""
    except sigmaswarm.SigmaswarmError as error:
        return None, str(error)
    except OSError as error:
        return None, f"{error.filename or 'a file'}: {error.strerror or error}"
