"""Writing files, for the whole house: whole or not at all.

What is written stands beside its place under a hidden name, is flushed to the disk and then renamed, so that no reader,
no kill, no full disk and no second run ever leaves a part of it under its own name, and what was there before stays
until then. A rename replaces a symbolic link and never follows it. What a killed run left under such a hidden name is
swept by the next one that writes into the folder.
"""

import io
import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from errno import EDQUOT, EEXIST, EFBIG, ENOSPC, ENOTEMPTY
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar, cast

from sigmaswarm.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

try:
    import fcntl
except ImportError:  # not on Windows: nothing is locked there, and nothing swept
    fcntl = None

T = TypeVar("T", "_Part", "_Staging")
_HELD = set[int]()
"""Of `held_folder`: open folders that this process has locked."""
_OURS = re.compile(r"\..+\.sigmaswarm-[0-9a-f]{12}")


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file of bytes, or of text as UTF-8, as `whole_file` does."""
    with whole_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_json(path: Path, content: Any, indent: int = 2) -> None:
    """Write JSON with every bit of its floats."""
    write_whole(path, json.dumps(content, indent=indent) + "\n")


def read_arrays(path: Path) -> "dict[str, NDArray[Any]]":
    """All arrays of an npz file; what a damaged one raises can be anything."""
    import numpy as np  # heavy, and not needed to write text

    # opened here, since np.load leaves a damaged file open
    with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def finite(content: Any) -> Any:
    """The content with null in the place of NaN and inf, which JSON does not know."""
    if isinstance(content, dict):
        return {str(key): finite(value) for key, value in cast("dict[Any, Any]", content).items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in cast("list[Any]", content)]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def make_folder(path: Path, remedy: str = "choose another --out") -> Path:
    """Make a folder and its parents where they are missing.

    Raises
    ------
    InputError
        Naming what is in the way, and ``remedy``.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: can't be made a folder ({error.strerror}); {remedy}") from None
    return path


@contextmanager
def held_folder(path: Path) -> Generator[Path]:
    """A folder, made where it is missing, that this run alone fills until the block ends.

    Raises
    ------
    InputError
        Another run fills it, or it can't be made.
    """
    make_folder(path)
    handle = os.open(path, os.O_RDONLY) if fcntl else -1
    _HELD.add(handle)
    try:
        if fcntl:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        _let_go_of(handle)
        raise InputError(
            f"{path}: another run is filling it; wait for its end, or choose another --out"
        ) from None
    except OSError:
        pass  # a file system that can't lock
    try:
        yield path
    finally:
        _let_go_of(handle)  # the lock ends with it, and with the process


def let_go() -> None:
    """In a fork: let go of the folders that the parent holds, or they would be held as long as the fork lives."""
    for handle in tuple(_HELD):
        _let_go_of(handle)


def _let_go_of(handle: int) -> None:
    if fcntl and handle in _HELD:
        os.close(handle)
    _HELD.discard(handle)


@contextmanager
def whole_file(path: Path) -> Generator[BinaryIO]:
    """Open a file for bytes, which takes its place when the block ends, and never if the block fails.

    Raises
    ------
    InputError
        Naming the file, if it can't be written: a full disk, no permission, something in the way.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if path.exists() and not path.is_file():  # as root, /dev/null could be replaced
        raise InputError(f"{path}: is no regular file; name another")
    _sweep(path.parent.resolve())
    part = _made(path, _Part)
    name = Path(part.name)
    try:
        with io.BufferedWriter(part) as file:
            yield file
            file.flush()
            os.fsync(part.fileno())
            name.replace(path)
    except BaseException as error:
        with suppress(OSError):
            name.unlink(missing_ok=True)
        failure = part.failure or error
        if isinstance(failure, OSError) and failure.filename in (None, str(name)):
            raise _unwritable(path, failure) from None
        raise


@contextmanager
def whole_folder(path: Path, *, replace: bool = False) -> Generator[Path]:
    """Name a place where a folder is to be made, which takes its own place when the block ends.

    Parameters
    ----------
    path : Path
        Of the folder; its parent exists.
    replace : bool
        Whether a folder that is there already, and not empty, gives way.

    Raises
    ------
    InputError
        Naming the folder, if it can't be written, or was made by somebody else meanwhile.
    """
    _sweep(path.parent.resolve())
    staging = _made(path, _Staging)
    new, old = staging.path / "new" / path.name, staging.path / "old" / path.name
    try:
        new.parent.mkdir()
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
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(staging.path)):
            raise _unwritable(path, error) from None
        raise
    finally:
        shutil.rmtree(staging.path, ignore_errors=True)
        staging.close()


def _unwritable(path: Path, error: OSError) -> InputError:
    rust = re.search(r"\(os error (\d+)\)", str(error))  # polars gives the number in words
    number = int(rust[1]) if rust else error.errno
    if number in (EEXIST, ENOTEMPTY):
        return InputError(f"{path}: exists already; delete it, or choose another name")
    said = os.strerror(number) if number else str(error)
    remedy = "make room, or name another place" if number in (ENOSPC, EDQUOT, EFBIG) else "name another place"
    return InputError(f"{path}: can't be written ({said}); {remedy}")


class _Part(io.FileIO):
    """A new file, locked while it is open; it remembers a failure, which some writers bury under others."""

    failure: OSError | None = None

    def __init__(self, path: Path) -> None:
        super().__init__(str(path), "xb")  # follows no link, and has the mode of any new file
        _lock(self.fileno())

    def write(self, data: Any, /) -> int:
        """Write as any file does."""
        try:
            return super().write(data)
        except OSError as error:
            self.failure = error
            raise


class _Staging:
    """A new folder, locked until it is closed."""

    def __init__(self, path: Path) -> None:
        path.mkdir()
        self.path = path
        self._handle = os.open(path, os.O_RDONLY) if fcntl else -1
        if fcntl:
            _lock(self._handle)

    def close(self) -> None:
        """Give the lock back."""
        if fcntl:
            os.close(self._handle)


def _made(path: Path, kind: Callable[[Path], T]) -> T:
    """Something new beside a path, with a hidden name that tells whose it is."""
    stem = path.name.encode()[:200].decode(errors="ignore")  # names end at 255 bytes
    while True:
        name = path.with_name(f".{stem}.sigmaswarm-{secrets.token_hex(6)}")
        try:
            made = kind(name)
        except OSError as error:
            raise _unwritable(path, error) from None
        if name.exists():  # else another run swept it, in the moment before it was locked
            return made
        made.close()


def _flush(folder: Path) -> None:
    for file in folder.rglob("*"):
        if file.is_file():
            with file.open("rb") as opened:
                os.fsync(opened.fileno())


def _lock(handle: int, *, wait: bool = True) -> bool:
    """Lock an open file or folder; the lock ends with the process. False where somebody has it, or nobody can."""
    try:
        if fcntl:
            fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return fcntl is not None


@cache  # once a folder is enough for a process, which clears away after itself
def _sweep(folder: Path) -> None:
    """Remove what killed runs left in a folder: by name and owner ours, and locked by nobody."""
    if not fcntl:
        return
    with suppress(OSError):
        for path in folder.iterdir():
            if _OURS.fullmatch(path.name):
                with suppress(OSError):
                    _sweep_one(path)


def _sweep_one(left: Path) -> None:
    handle = os.open(left, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        if os.fstat(handle).st_uid != os.getuid() or not _lock(handle, wait=False):
            return
        if not left.is_dir():
            left.unlink(missing_ok=True)
            return
        if (left / "old").is_dir():  # killed in between two renames: back to its place
            for kept in (left / "old").iterdir():
                if not (left.parent / kept.name).exists():
                    kept.rename(left.parent / kept.name)
        shutil.rmtree(left, ignore_errors=True)
    finally:
        os.close(handle)
