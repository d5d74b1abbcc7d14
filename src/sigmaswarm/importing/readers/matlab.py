"""MATLAB files, ``.mat`` up to version 7, through SciPy: structs and loose vectors of one length are tables."""

import math
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import SAMPLE, guess_roles
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.source import FILES, Choice, Guess, Log, first_bytes, of_frames, whole
from sigmaswarm.wording import shown

LOOSE = "variables"
"""The table of the vectors that are in no struct."""
DEEPEST = 5
MOST_STRUCTS = 100_000
MOST_PARTS = 9
"""Columns of a matrix that are a column each."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_OPAQUE = ("MatlabOpaque", "MatlabFunction")


def recognizes(path: Path) -> bool:
    """Return True if it begins as a MATLAB file does, or has its name."""
    return first_bytes(path, 6) == b"MATLAB" or (path.is_file() and path.suffix.lower() == ".mat")


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    """Read all variables; timetables and files of version 7.3 are refused with the line to type in MATLAB."""
    from scipy.io import loadmat, whosmat

    if _HDF5 in first_bytes(path, 1024):
        raise InputError(
            f"{path}: is a MATLAB file of version 7.3, which is not read; in MATLAB type: "
            f"s = load('{path.name}'); save('{path.stem}_v7.mat', '-struct', 's', '-v7')"
        )
    with whole(path):
        for name, shape, kind in whosmat(path):
            if kind in ("struct", "cell") and math.prod(shape) > MOST_STRUCTS:  # SciPy makes them all at once
                raise InputError(
                    f"{path}: {shown(name)} has more than {MOST_STRUCTS} structs; save vectors in one struct"
                )
            limits.check_unpacked(8 * math.prod(shape), path)
        content = cast("dict[str, Any]", loadmat(path, squeeze_me=True, struct_as_record=False))
    plain = {k: v for k, v in content.items() if not k.startswith("__") and type(v).__name__ not in _OPAQUE}
    frames = {name: pl.DataFrame(columns) for name, columns in _tables(plain, "", 0)}
    if not frames:
        if any(type(v).__name__ in _OPAQUE or k == "__function_workspace__" for k, v in content.items()):
            raise InputError(
                f"{path}: holds MATLAB's own tables (timetable, table), which are not read; in MATLAB type for each: "
                "writetimetable(NAME, 'NAME.csv')  (or writetable), and import the folder of these files"
            )
        raise InputError(
            f"{path}: holds no struct of vectors and no vectors; --show lists tables, and there are none"
        )
    for name, frame in frames.items():
        limits.check_rows(len(frame), path, name)

    def guess(choice: Choice) -> Guess:
        return guess_roles({name: frame.head(SAMPLE) for name, frame in frames.items()}, choice.tables)

    return of_frames(path, frames, FILES, guess)


def _tables(content: Mapping[str, Any], name: str, depth: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """The tables of a struct's fields: vectors of the most common length together, structs in it by themselves."""
    vectors: dict[str, Any] = {}
    for field, value in content.items():
        if hasattr(value, "_fieldnames") and depth < DEEPEST:
            inner = {f: getattr(value, f) for f in value._fieldnames}
            yield from _tables(inner, f"{name}.{field}" if name else field, depth + 1)
        elif isinstance(value, np.ndarray):
            vectors |= dict(_columns(field, cast("np.ndarray[Any, Any]", value)))
    lengths = [len(v) for v in vectors.values() if len(v) > 1]
    for length in dict.fromkeys(sorted(lengths, key=lengths.count, reverse=True)):
        columns = {f: v for f, v in vectors.items() if len(v) == length}
        if len(columns) > 1:
            first = length == max(lengths, key=lengths.count)
            yield (name or LOOSE) + ("" if first else f" ({length})"), columns


def _columns(field: str, value: "np.ndarray[Any, Any]") -> Iterator[tuple[str, Any]]:
    """The columns of a vector or of a matrix (n, 2 to 9), lying or standing."""
    if value.dtype.kind not in "fiub":
        return
    if value.ndim == 1:
        yield field, value
    elif value.ndim == 2:
        matrix = value if value.shape[0] >= value.shape[1] else value.T
        if 1 < matrix.shape[1] <= MOST_PARTS:
            axes = "xyz" if matrix.shape[1] == 3 else [str(k) for k in range(matrix.shape[1])]
            yield from ((f"{field}_{a}", np.ascontiguousarray(matrix[:, k])) for k, a in enumerate(axes))
