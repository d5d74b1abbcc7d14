"""MATLAB files (``.mat`` up to version 7), read with SciPy.

Vectors of equal length in a struct, or outside of structs, become a table.
"""

import io
import math
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import guess_roles, spread_rows
from sigmaswarm.importing.source import (
    FILES,
    Guess,
    Limits,
    Log,
    TableChoice,
    errors_as_damage,
    first_bytes,
    log_of_frames,
)
from sigmaswarm.wording import printable

ROOT_TABLE = "variables"  # name of the table of vectors outside of structs
MAX_DEPTH = 5
MAX_STRUCTS = 100_000
MAX_MATRIX_COLUMNS = 9  # matrices with more columns are left out
_HDF5 = b"\x89HDF\r\n\x1a\n"
# Types of elements in files of version 5 to 7 (MathWorks, "MAT-File Format")
_SHAPE, _FLAGS, _ARRAY, _COMPRESSED = 5, 6, 14, 15
_NUMBERS = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18)
_OF_ARRAYS = (1, 2, 3, 16, 17)  # classes of arrays of arrays: cell, struct, object, function, opaque
_OF_STRUCTS = {1: "cell", 2: "struct"}
_SPARSE, _OPAQUE_CLASS, _COMPLEX = 5, 17, 0x800
_MAX_ARRAY_DEPTH = 50
_OPAQUE = ("MatlabOpaque", "MatlabFunction")


def recognizes(path: Path) -> bool:
    return first_bytes(path, 6) == b"MATLAB" or (path.is_file() and path.suffix.lower() == ".mat")


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    from scipy.io import loadmat, whosmat

    if _HDF5 in first_bytes(path, 1024):
        raise InputError(
            f"{path}: is a MATLAB file of version 7.3, which is not supported; in MATLAB, type: "
            f"s = load('{path.name}'); save('{path.stem}_v7.mat', '-struct', 's', '-v7')"
        )
    with errors_as_damage(path):
        arrays = _require_known_elements(path, limits)
        own = any(
            kind == _OPAQUE_CLASS for kind, _ in arrays
        )  # MATLAB's own classes, at which SciPy's list fails
        unnamed = [("an array", (count,), _OF_STRUCTS.get(kind, "")) for kind, count in arrays]
        for name, shape, kind in unnamed if own else whosmat(path):
            # SciPy would create all elements
            if kind in ("struct", "cell") and math.prod(shape) > MAX_STRUCTS:
                raise InputError(
                    f"{path}: {printable(name)} has more than {MAX_STRUCTS} elements; save the columns as vectors of "
                    "one struct"
                )
            limits.check_unpacked(8 * math.prod(shape), path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # SciPy gives all opaque arrays the same name
            content = cast("dict[str, Any]", loadmat(path, squeeze_me=True, struct_as_record=False))
    plain = {k: v for k, v in content.items() if not k.startswith("__") and type(v).__name__ not in _OPAQUE}
    frames = {name: pl.DataFrame(columns) for name, columns in _tables(plain, "", 0)}
    if not frames:
        if own or any(
            type(v).__name__ in _OPAQUE or k == "__function_workspace__" for k, v in content.items()
        ):
            raise InputError(
                f"{path}: contains MATLAB's own tables (timetable, table), which are not supported; in MATLAB, "
                "write each with writetimetable(NAME, 'NAME.csv') or writetable(NAME, 'NAME.csv'), and import the "
                "folder of these files"
            )
        raise InputError(
            f"{path}: contains no vectors of equal length; save the log's columns as vectors of one struct"
        )
    for name, frame in frames.items():
        limits.check_rows(len(frame), path, name)

    def guess(choice: TableChoice) -> Guess:
        return guess_roles({name: spread_rows(frame.lazy()) for name, frame in frames.items()}, choice.tables)

    return log_of_frames(path, frames, FILES, guess)


def _require_known_elements(path: Path, limits: Limits) -> list[tuple[int, int]]:
    """Refuse elements that have invalid types or are nested too deeply, since they crash SciPy's compiled code.

    Return the class and the number of elements of each array; empty for formats before version 5, which have no
    elements.
    """
    from scipy.io.matlab import matfile_version

    arrays: list[tuple[int, int]] = []
    if matfile_version(path)[0] != 1:
        return arrays
    with path.open("rb") as file:
        order = "<" if file.read(128)[126:] == b"IM" else ">"
        for kind, size in _elements(file, path.stat().st_size, order):
            if kind == _COMPRESSED:
                inner = zlib.decompressobj().decompress(file.read(size), limits.unpacked_mb * 1_000_000 + 1)
                limits.check_unpacked(len(inner), path)
                unpacked = io.BytesIO(inner)
                for kind, size in _elements(unpacked, len(inner), order):
                    arrays.append(_require_array(unpacked, kind, size, order, 0))
            else:
                arrays.append(_require_array(file, kind, size, order, 0))
    return arrays


def _elements(file: IO[bytes], end: int, order: str) -> Iterator[tuple[int, int]]:
    """Yield the type and size of each element up to ``end``. The file is then positioned at the element's content."""
    while (at := file.tell()) + 8 <= end:
        kind, size = struct.unpack(f"{order}II", file.read(8))
        following = at + 8 + size
        if kind >> 16:  # a small element: type and size share four bytes, and the content is the next four
            kind, size, following = kind & 0xFFFF, kind >> 16, at + 8
            file.seek(at + 4)
        elif kind != _COMPRESSED:
            following += -size % 8
        if following - (-size % 8) > end:
            raise ValueError(f"an element of {size} bytes is cut off")
        yield kind, size
        file.seek(following)


def _require_array(file: IO[bytes], kind: int, size: int, order: str, depth: int) -> tuple[int, int]:
    """Refuse elements that are not arrays, and arrays with contradicting class, shape and content.

    Return the class and the number of elements.
    """
    if kind != _ARRAY or depth > _MAX_ARRAY_DEPTH:
        raise ValueError(f"an element of type {kind}, at depth {depth}, instead of an array")
    elements = _elements(file, file.tell() + size, order)
    if next(elements, (_FLAGS, 8)) != (_FLAGS, 8):
        raise ValueError("an array without a class")
    flags = struct.unpack(f"{order}I", file.read(4))[0] if size else _OPAQUE_CLASS
    array, count, filled, parts = flags & 255, 0, 0, 0
    if array != _OPAQUE_CLASS:
        inner, length = next(elements, (0, 0))
        if inner != _SHAPE or length < 8 or length % 4:
            raise ValueError("an array without a shape")
        count = math.prod(struct.unpack(f"{order}{length // 4}I", file.read(length)))
    for inner, length in elements:
        filled, parts = filled + length, parts + 1
        if inner == _ARRAY and array in _OF_ARRAYS:
            _require_array(file, inner, length, order, depth + 1)
        elif inner not in _NUMBERS:
            raise ValueError(f"an element of type {inner} instead of numbers")
    if array in _OF_ARRAYS:
        # `open_log` checks the number at depth 0, since its error names the variable
        lacks = depth > 0 and count > MAX_STRUCTS
    elif array == _SPARSE:
        lacks = parts < 4 + bool(flags & _COMPLEX)  # name, row indices, column indices, values
    else:
        lacks = parts < 2 + bool(flags & _COMPLEX) or count > filled
    if lacks:
        raise ValueError(f"an array of {count} elements in {parts} parts with {filled} bytes in total")
    return array, count


def _tables(content: Mapping[str, Any], name: str, depth: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the tables of a struct: those of its structs, then vectors of equal length, by the length's frequency."""
    vectors: dict[str, Any] = {}
    for field, value in content.items():
        if hasattr(value, "_fieldnames") and depth < MAX_DEPTH:
            inner = {f: getattr(value, f) for f in value._fieldnames}
            yield from _tables(inner, f"{name}.{field}" if name else field, depth + 1)
        elif (
            isinstance(value, np.ndarray)
            and value.size
            and all(hasattr(v, "_fieldnames") for v in value.flat)
            and depth < MAX_DEPTH
        ):
            rows: dict[str, list[Any]] = {
                f: [getattr(v, f, None) for v in value.flat] for f in value.flat[0]._fieldnames
            }
            alike = {f: np.array(v) for f, v in rows.items() if len({np.shape(each) for each in v}) == 1}
            yield from _tables(alike, f"{name}.{field}" if name else field, depth + 1)
        elif isinstance(value, np.ndarray):
            vectors |= dict(_columns(field, cast("np.ndarray[Any, Any]", value)))
    times = {len(v) for v in content.values() if isinstance(v, np.ndarray) and v.ndim == 1 and _rises(v)}
    for field in [f for f, v in vectors.items() if f.endswith("_x") and len(v) not in times and _rises(v)]:
        numbered = {
            field[:-1] + axis: f"{field[:-1]}{k}" for k, axis in enumerate("xyz")
        }  # the first is a time
        if field not in content and numbered.keys() <= vectors.keys():
            vectors = {numbered.get(f, f): v for f, v in vectors.items()}
    lengths = [len(v) for v in vectors.values() if len(v) > 1]
    for length in dict.fromkeys(sorted(lengths, key=lengths.count, reverse=True)):
        columns = {f: v for f, v in vectors.items() if len(v) == length}
        if len(columns) > 1:
            first = length == max(lengths, key=lengths.count)
            yield (name or ROOT_TABLE) + ("" if first else f" ({length})"), columns


def _rises(values: "np.ndarray[Any, Any]") -> bool:
    return len(values) > 2 and values.dtype.kind in "fiu" and bool(np.all(values[1:] > values[:-1]))


def _columns(field: str, value: "np.ndarray[Any, Any]") -> Iterator[tuple[str, Any]]:
    """Yield the columns of a vector, or of a matrix (n, 2 to 9) or its transpose."""
    if value.dtype.kind not in "fiub":
        return
    if value.ndim == 1:
        yield field, value
    elif value.ndim == 2:
        matrix = value if value.shape[0] >= value.shape[1] else value.T
        if 1 < matrix.shape[1] <= MAX_MATRIX_COLUMNS:
            axes = "xyz" if matrix.shape[1] == 3 else [str(k) for k in range(matrix.shape[1])]
            yield from ((f"{field}_{a}", np.ascontiguousarray(matrix[:, k])) for k, a in enumerate(axes))
