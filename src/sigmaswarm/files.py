"""Write files and folders completely or not at all.

New content is written under a hidden name next to its destination, flushed to the disk and then renamed. A rename
replaces a symbolic link and never follows the link. While a run writes, it locks a file next to the hidden name. A lock
ends with its process, so the next run can recognize and remove the files of a killed run.
"""

import io
import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Generator, Sequence, Set
from contextlib import contextmanager, suppress
from errno import EDQUOT, EEXIST, EFBIG, ENOSPC, ENOTEMPTY
from functools import cache
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import require_members, require_regular

if TYPE_CHECKING:
    from filelock import BaseFileLock
    from numpy.typing import NDArray

RESULT_FILE = ".sigmaswarm-result.json"  # in the folder of a result: its kind and the names of its files
DETAILS_FILE = (
    "details.txt"  # in the folder of a tuning or an evaluation: the output of the command with all details
)
_HIDDEN = re.compile(
    r"\.DS_Store|Thumbs\.db|desktop\.ini|\.sigmaswarm\.lock|\..+\.sigmaswarm-[0-9a-f]{12}(\.lock)?"
)
_LOCK = re.compile(r"\..+\.sigmaswarm-[0-9a-f]{12}\.lock")


def write_atomically(path: Path, content: bytes | str) -> None:
    with atomic_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_json(path: Path, content: Any, indent: int = 2) -> None:
    """Write JSON with the exact values of its floats."""
    write_atomically(path, json.dumps(content, indent=indent) + "\n")


def read_arrays(path: Path) -> "dict[str, NDArray[Any]]":
    """Read all arrays of an npz file. A damaged file can raise any exception."""
    import numpy as np  # heavy, and not needed to write text

    require_regular(path)
    # The file is opened here, since np.load leaves a damaged file open.
    with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
        require_members(path, file.zip.infolist())
        return {name: file[name] for name in file.files}


def nan_to_none(content: Any) -> Any:
    """Replace NaN and inf, which JSON does not have, by None."""
    if isinstance(content, dict):
        return {str(key): nan_to_none(value) for key, value in cast("dict[Any, Any]", content).items()}
    if isinstance(content, list | tuple):
        return [nan_to_none(value) for value in cast("list[Any]", content)]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def free_path(path: Path | str, inside: str = "") -> Path:
    """Return the first path of PATH/``inside``, PATH-2/``inside``, PATH-3/``inside`` ... that does not exist.

    For PATH-2, the next path is also PATH-3, not PATH-2-2, if PATH exists.
    """
    path = Path(path)
    base = path.resolve() if path.name in ("", "..") else path
    numbered = re.fullmatch(r"(.+)-\d+", base.name)
    if path.exists() and numbered and base.with_name(numbered[1]).exists():
        path = base = base.with_name(numbered[1])
    paths = ((path if i == 1 else base.with_name(f"{base.name}-{i}")) / inside for i in count(1))
    return next(free for free in paths if not free.exists())


def make_folder(path: Path, remedy: str = "choose another --out") -> Path:
    """Make a folder and its parents, or raise `InputError` with ``remedy``."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: can't be created as a folder ({error.strerror}); {remedy}") from None
    return path


@contextmanager
def locked_folder(path: Path) -> Generator[Path]:
    """Make a folder if it is missing, and lock it against other runs until the block ends."""
    file = make_folder(path) / ".sigmaswarm.lock"
    try:
        lock = _lock(file, wait=False)
    except TimeoutError:
        raise InputError(
            f"{path}: another run is writing to it; wait until that run ends, or choose another --out"
        ) from None
    # Also remove lock files of killed runs in subfolders, since later runs may not write there. Three levels suffice.
    for level in ("", "*/", "*/*/", "*/*/*/"):
        _sweep_all(path, f"{level}.*.lock")
    try:
        yield path
    finally:
        if lock is not None:
            with suppress(OSError):
                file.unlink(missing_ok=True)  # still locked, so no other run has it
            lock.release()


@contextmanager
def atomic_file(path: Path) -> Generator[BinaryIO]:
    """Open a binary file, which gets its final name when the block ends without an error."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; specify a file")
    if path.exists() and not path.is_file():  # the user root could replace /dev/null
        raise InputError(f"{path}: is not a regular file; specify another file")
    with _staging(path) as new:
        part = _Part(str(new), "xb")
        try:
            with io.BufferedWriter(part) as file:
                yield file
                file.flush()
                os.fsync(part.fileno())
        except BaseException:
            if part.failure:
                raise part.failure from None
            raise
        new.replace(path)


@contextmanager
def atomic_folder(path: Path, *, replace: bool = False) -> Generator[Path]:
    """Yield a path for a folder, which gets its final name when the block ends.

    With ``replace``, the new folder may replace a folder that is not empty.
    """
    with _staging(path) as hidden:
        new, old = hidden / "new" / path.name, hidden / "old" / path.name
        new.parent.mkdir(parents=True)
        yield new
        _flush(new)
        if replace and path.exists():
            old.parent.mkdir()
            path.rename(old)
        try:
            new.rename(path)
        except OSError:
            if old.exists():
                old.rename(path)
            raise


def earlier_result(folder: Path, kind: str, mark: str = "", *, alone: bool = True) -> frozenset[str] | None:
    """Return the files of an earlier result of the same kind in a folder; empty if there is no earlier result.

    Return None if the result has the file ``mark`` but no list of files, as in version 0.3.0. If ``alone`` is False,
    the folder may contain files of the user, for example a program that uses an exported filter.

    Raises
    ------
    InputError
        If the folder contains another result, or files of the user.
    """
    if folder.is_dir():
        _sweep(folder.resolve())  # if a killed run replaced the list, this call restores it
    if not folder.is_dir() or all(_HIDDEN.fullmatch(entry.name) for entry in folder.iterdir()):
        return frozenset()
    if mark and (folder / mark).is_file() and not (folder / RESULT_FILE).exists():
        return None
    record = _result_in(folder)
    if not (record or alone):
        return frozenset()
    if record.get("kind") != kind:
        raise InputError(f"{folder}: is not empty and contains no {kind}; choose another --out")
    inside = folder.resolve()
    parents = {name: (folder / name).parent.resolve() for name in record["files"]}
    return frozenset(name for name, parent in parents.items() if parent.is_relative_to(inside))


def add_to_result(folder: Path, name: str) -> None:
    """Add a file to a result's list of files (if it has one), so that the next result replaces the file."""
    if not (record := _result_in(folder)):
        return
    if (folder / name).exists() and name not in record["files"]:
        raise InputError(f"{folder / name}: is not part of the result in this folder; move it")
    write_json(folder / RESULT_FILE, {**record, "files": sorted({*record["files"], name})})


def _result_in(folder: Path) -> dict[str, Any]:
    try:
        record = json.loads((folder / RESULT_FILE).read_bytes())
        valid = isinstance(record["kind"], str) and all(type(name) is str for name in record["files"])
        return record if valid else {}
    except (OSError, ValueError, LookupError, TypeError):
        return {}


@contextmanager
def staged_files(
    folder: Path, kind: str = "", mark: str = "", *, built: Sequence[str] = ()
) -> Generator[Path]:
    """Yield a hidden folder for new files. When the block ends, all or none of them are moved into ``folder``.

    If this run is killed between two replacements, the next run that writes into the folder restores the old files. If
    ``kind`` is given, the files are a whole result, which replaces an earlier result (see `earlier_result`): files that
    only the earlier result has are removed, and other files in the folder are not changed. ``built`` contains files
    that users build from a result, such as programs. They are removed when the result is replaced.
    """
    before = earlier_result(folder, kind, mark, alone=False) if kind else None
    make_folder(folder)
    with _staging(folder / "results", folder) as hidden:
        new = hidden / "new"
        new.mkdir(parents=True)
        (hidden / "old").mkdir()
        try:
            yield new
        except InputError as error:  # the error names a hidden file
            raise InputError(str(error).replace(str(new), str(folder))) from None
        names = {file.relative_to(new).as_posix() for file in new.rglob("*") if file.is_file()}
        if before is not None:
            for name in sorted(names - before):
                if (folder / name).exists() and not _is_exported_code(folder / name):
                    raise InputError(
                        f"{folder / name}: is not part of an earlier {kind}; move it, or choose another --out"
                    )
        if kind:
            (new / RESULT_FILE).write_text(json.dumps({"kind": kind, "files": sorted(names)}) + "\n")
        _flush(new)
        stale = (before or frozenset()) - names
        if before or any((folder / name).exists() for name in names):
            stale |= {*built}
        _exchange(hidden, folder, stale)


def _is_exported_code(file: Path) -> bool:
    """Return True for code that sigmaswarm exported, since exports of version 0.3.0 have no list of files."""
    if file.suffix not in (".c", ".h", ".py", ".yaml"):
        return False
    with file.open("rb") as opened:
        return b"sigmaswarm" in opened.read(1000)


def _exchange(hidden: Path, folder: Path, stale: Set[str]) -> None:
    """Move new files to their places, and replaced and stale files aside. Undo all moves if one fails."""
    new, old = hidden / "new", hidden / "old"
    files = sorted(file.relative_to(new) for file in new.rglob("*") if file.is_file())
    for name in files:
        if (place := folder / name).exists() and not place.is_file():
            raise InputError(f"{place}: is not a regular file; move it, or choose another --out")
    try:
        for name in sorted(stale):
            if (folder / name).is_file():
                make_folder((old / name).parent)
                (folder / name).rename(old / name)
        for name in files:
            make_folder((folder / name).parent)
            if (folder / name).exists():
                make_folder((old / name).parent)
                (folder / name).rename(old / name)
            (new / name).rename(folder / name)
    except BaseException as error:
        _restore(hidden, folder)
        if isinstance(error, OSError):
            raise _unwritable(folder, error) from None
        raise
    for name in sorted(stale, reverse=True):
        with suppress(OSError):  # not empty, or the result's folder itself
            if (folder / name).parent != folder:
                (folder / name).parent.rmdir()


def _restore(hidden: Path, folder: Path) -> None:
    for file in (hidden / "old").rglob("*"):
        if file.is_file():
            file.replace(folder / file.relative_to(hidden / "old"))


def _unwritable(path: Path, error: OSError) -> InputError:
    rust = re.search(r"\(os error (\d+)\)", str(error))  # polars gives the error number only in the message
    number = int(rust[1]) if rust else error.errno
    if number in (EEXIST, ENOTEMPTY):
        return InputError(f"{path}: already exists; delete it, or choose another name")
    reason = os.strerror(number) if number else str(error)
    remedy = "free some space, or " * (number in (ENOSPC, EDQUOT, EFBIG)) + "specify another folder"
    return InputError(f"{path}: can't be written ({reason}); {remedy}")


class _Part(io.FileIO):
    """A file that stores the error of a failed write, since some writers replace this error."""

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.failure = error
            raise


@contextmanager
def _staging(path: Path, named: Path | None = None) -> Generator[Path]:
    """Yield a free, hidden path next to ``path``, with a locked lock file. Remove both at the end.

    An `OSError` about the hidden path, or about no path, is replaced by an `InputError` about ``named``.
    """
    _sweep(path.parent.resolve())
    stem = path.name.encode()[:200].decode(errors="ignore")  # file names have at most 255 bytes
    hidden = path.with_name(f".{stem}.sigmaswarm-{secrets.token_hex(6)}")
    file = hidden.with_name(f"{hidden.name}.lock")
    lock = _lock(file)
    try:
        yield hidden
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(hidden)):
            raise _unwritable(named or path, error) from None
        raise
    finally:
        _remove(hidden)
        if lock is not None:
            lock.release()
        with suppress(OSError):
            file.unlink(missing_ok=True)


def _remove(hidden: Path) -> None:
    if hidden.is_dir() and not hidden.is_symlink():
        shutil.rmtree(hidden, ignore_errors=True)
    else:
        with suppress(OSError):
            hidden.unlink(missing_ok=True)


def _lock(file: Path, *, wait: bool = True) -> "BaseFileLock | None":
    """Lock a file until the lock is released or the process ends. Return None if the file system has no locks.

    If another run has the lock, wait. With ``wait`` = False, raise `TimeoutError`.
    """
    from filelock import FileLock, Timeout  # not needed by commands that only read

    if not file.parent.is_dir():  # filelock would create the folder
        return None
    lock = FileLock(file, timeout=-1 if wait else 0, thread_local=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        raise
    except OSError:
        return None
    return lock


def _flush(folder: Path) -> None:
    for file in folder.rglob("*"):
        if file.is_file():
            with file.open("rb") as opened:
                os.fsync(opened.fileno())


@cache  # once per folder and process, since each process removes its own files
def _sweep(folder: Path) -> None:
    """Remove the files of killed runs: this user's files with hidden names and an unlocked lock file."""
    _sweep_all(folder, ".*.lock")


def _sweep_all(folder: Path, pattern: str) -> None:
    with suppress(OSError):
        for file in folder.glob(pattern):
            if _LOCK.fullmatch(file.name):
                with suppress(OSError):
                    _sweep_one(file)


def _sweep_one(file: Path) -> None:
    if hasattr(os, "getuid") and file.lstat().st_uid != os.getuid():
        return
    lock = _lock(file, wait=False)
    if lock is None:
        return
    stem = file.with_suffix("")
    for kept in (stem / "old").glob("*"):  # the run was killed between two renames: move the old files back
        if not (stem.parent / kept.name).exists():
            kept.rename(stem.parent / kept.name)
    if stem.name.startswith(".results.") and any(f.is_file() for f in (stem / "new").rglob("*")):
        _restore(stem, stem.parent)  # the run was killed within an exchange of files
    _remove(stem)
    lock.release()
    file.unlink(missing_ok=True)
