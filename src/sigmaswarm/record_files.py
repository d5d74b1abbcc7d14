"""Read TOML, JSON and npz files written by sigmaswarm as typed records."""

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError

from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import MAX_JSON_BYTES, read_bounded, read_toml_text
from sigmaswarm.files import nan_to_none, read_arrays
from sigmaswarm.wording import first_mistake, printable

R = TypeVar("R")
ARRAYS = ConfigDict(arbitrary_types_allowed=True, extra="forbid")  # for records in npz files
DAMAGED = "the file was not written by sigmaswarm, or is damaged"
MISSING = "repeat the command that made the folder"


def _vector(value: Any) -> NDArray[Any]:
    array = np.asarray(value)
    if array.ndim != 1 or array.dtype.kind not in "fiu":
        raise ValueError("should be a vector of numbers")
    return array


Vector = Annotated[NDArray[Any], BeforeValidator(_vector)]  # numbers (n,) in an npz file


def load_record(
    kind: type[R], path: Path, remedy: str = DAMAGED, *, missing: str = MISSING, infinite: bool = False
) -> R:
    """Read a record (a pydantic model or a dataclass) from a file: .json, .npz, or TOML with any other suffix.

    ``remedy`` is the remedy in a message about a damaged file, and ``missing`` the remedy in one about a missing file.
    NaN and inf in a JSON file become None unless ``infinite`` is True.
    """
    return to_record(kind, read_content(path, remedy, missing=missing, infinite=infinite), path, remedy)


def to_record(kind: type[R], content: dict[str, Any], path: Path, remedy: str = DAMAGED) -> R:
    """Convert the content of the file ``path`` to a record."""
    try:
        return TypeAdapter(kind).validate_python(content)
    except ValidationError as error:
        key, _, _, message = first_mistake(error)
        raise InputError(f"{path}: {key or 'the file'}: {message}; {remedy}") from None


def content_if_readable(path: Path) -> dict[str, Any]:
    """Read a file like `read_content`, or return an empty dictionary if the file is missing or damaged."""
    try:
        return read_content(path)
    except InputError:
        return {}


def read_content(
    path: Path, remedy: str = DAMAGED, *, missing: str = MISSING, infinite: bool = False
) -> dict[str, Any]:
    """Read a TOML, JSON or npz file as a dictionary. For the arguments see `load_record`."""
    try:
        if path.suffix == ".npz":
            return {**read_arrays(path)}
        if path.suffix == ".json":
            content = json.loads(read_bounded(path, MAX_JSON_BYTES))
            numbers = nan_to_none(content)  # this also fails for content that is nested too deeply
            content = content if infinite else numbers
        else:
            content = tomllib.loads(read_toml_text(path))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {missing}") from None
    except InputError:
        raise
    # A damaged archive can raise any error. Deeply nested text raises RecursionError, a long number ValueError.
    except Exception as error:
        reason = printable(" ".join(str(error).split()) or type(error).__name__, 160)
        raise InputError(f"{path}: not readable ({reason}); {remedy}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: the file should be a table of keys; {remedy}")
    return cast("dict[str, Any]", content)
