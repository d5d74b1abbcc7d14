"""Read a result file, TOML or JSON, into its typed record."""

import json
import tomllib
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from sigmaswarm.errors import InputError, first_mistake
from sigmaswarm.files import finite

M = TypeVar("M", bound=BaseModel)


def load_record(kind: type[M], path: Path) -> M:
    """Read a result file: JSON by its suffix, else TOML.

    Raises
    ------
    InputError
        If the file can't be read; the message names the file, the key and what is wrong.
    """
    try:
        text = path.read_text(encoding="utf-8")
        return kind.model_validate(
            finite(json.loads(text)) if path.suffix == ".json" else tomllib.loads(text)
        )
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; repeat the command that made the folder") from None
    except ValidationError as error:
        key, _, _, message = first_mistake(error)
        raise InputError(
            f"{path}: {key or 'the file'}: {message}; not a result of sigmaswarm, or a damaged one"
        ) from None
    except (OSError, ValueError) as error:  # not UTF-8, not TOML, not JSON
        raise InputError(f"{path}: not readable: {' '.join(str(error).split())}") from None
