"""The folder of a tuning: written atomically, the same bytes for the same result, resumable.

A folder of results contains

    config.json          the configuration and the data; a resumed run must have the same
    checkpoint-000.npz   the optimizer's whole state after the last generation, while a trial runs
    trial-000/           result.json and history.npz of a finished trial
    tuning.toml          the best trial's filter, once all trials are done
    seen.npz             landmarks of its drives, whole or in parts (`drives.overlap`)
"""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from pydantic import BaseModel, Field, model_validator

from sigmaswarm.errors import InputError
from sigmaswarm.files import make_folder, read_arrays, whole_file, whole_folder, write_json
from sigmaswarm.records import ARRAYS, Vector, load_record
from sigmaswarm.tuning.config import RENAMED
from sigmaswarm.versions import same_results
from sigmaswarm.wording import names_shown, shown

LONGEST = 120
"""Characters of a value in a message."""


class ConfigRecord(BaseModel, extra="allow"):
    """config.json of a tuning: its configuration, which a resumed run must repeat, and the versions of its software."""

    versions: dict[str, str] = Field(default_factory=dict)


class CountsRecord(BaseModel, extra="forbid"):
    """``counts`` of result.json: parameter sets tried, and how many of them failed."""

    evaluations: int
    failures: int


class TrialRecord(BaseModel, extra="forbid"):
    """result.json of a trial."""

    cost: float
    counts: CountsRecord


class TrialHistoryRecord(BaseModel):
    """history.npz of a trial: the best point (d,), and after each generation the costs and steps (g,)."""

    model_config = ARRAYS
    point: Vector
    best: Vector
    median: Vector
    steps: Vector

    @model_validator(mode="after")
    def _of_one_length(self) -> Self:
        if not 0 < len(self.best) == len(self.median) == len(self.steps):
            raise ValueError("best, median and steps should have one length")
        if np.isnan([*self.best, *self.median]).any() or not np.isfinite([*self.point, *self.steps]).all():
            raise ValueError("its numbers should be finite; costs may be infinite")
        return self


def save_checkpoint(path: Path, arrays: dict[str, Any], notes: dict[str, Any]) -> None:
    """Save arrays, and notes that JSON can hold, as one file."""
    with whole_file(path) as file:
        np.savez(file, **arrays, notes=json.dumps(notes))


def load_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Arrays and notes, or None where nothing was saved."""
    if not path.exists():
        return None
    try:
        arrays: dict[str, Any] = {**read_arrays(path)}
        return arrays, json.loads(str(arrays.pop("notes")))
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise unreadable(path) from None


def saved_options(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the options of the tuning in a folder, as `tune` takes them, and its data: to resume it."""
    record = load_record(ConfigRecord, path / "config.json", "not written by a tuning", infinite=True)
    config = _with_current_names(record.model_extra)
    if "start" in config:
        raise InputError(
            f"{path}: was started from another filter; resume it with the command that started it"
        )
    return config, config.pop("data", [])


def saved_history(path: Path) -> dict[int, list[float]]:
    """Return the lowest costs after each generation, by trial, also of an unfinished tuning."""
    history: dict[int, list[float]] = {}
    for place in sorted((*path.glob("trial-???"), *path.glob("checkpoint-???.npz"))):
        number = int(place.stem[-3:])
        done = finished_trial(path, number) if place.is_dir() else load_checkpoint(place)
        if done and number not in history:
            history[number] = np.asarray(done[place.is_dir()]["best"], np.float64).tolist()
    return history


def unreadable(checkpoint: Path) -> InputError:
    """Create the error for a checkpoint that can't be read."""
    return InputError(f"{checkpoint}: not a readable checkpoint; delete it to redo this trial")


def finished_trial(
    path: Path,
    trial: int,
    result_type: type[BaseModel] = TrialRecord,
    history_type: type[BaseModel] = TrialHistoryRecord,
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Read the result and the history of a finished trial from a tuning's folder; None where there is none."""
    folder = path / f"trial-{trial:03d}"
    if not folder.exists():
        return None
    remedy = f"delete {folder} to redo this trial"
    result = load_record(result_type, folder / "result.json", remedy, missing=remedy, infinite=True)
    history = load_record(history_type, folder / "history.npz", remedy, missing=remedy)
    return result.model_dump(), vars(history) | (history.model_extra or {})


def _with_current_names(config: Any) -> Any:
    """Rename the options of 0.3.0 in a saved configuration."""
    if not isinstance(config, dict):
        return config
    items = cast(dict[str, Any], config).items()
    return {RENAMED.get(key, key): _with_current_names(value) for key, value in items}


def _difference(key: str, saved: Any, wanted: Any) -> tuple[str, str]:
    """Describe the innermost values that differ."""
    if isinstance(saved, dict) and isinstance(wanted, dict) and key not in ("data", "model"):
        old, new = cast(dict[str, Any], saved), cast(dict[str, Any], wanted)
        inner = next(k for k in sorted(old.keys() | new.keys()) if old.get(k) != new.get(k))
        return _difference(f"{key}.{inner}" if key else inner, old.get(inner), new.get(inner))
    return _short(key, saved), _short(key, wanted)


def _short(key: str, value: Any) -> str:
    with suppress(LookupError, TypeError):  # a damaged file lacks names or hashes
        if key == "data" and isinstance(value, list):
            return "the drives " + names_shown(f"{d['name']} ({d['sha256'][:8]})" for d in value)
        if key == "model" and isinstance(value, dict):  # a custom model is too long for a message
            return "the model " + shown(f"{value['name']} ({value['sha256'][:8]})")
    return f"{shown(key)} = {shown(value, LONGEST)}"


class ResultFolder:
    """The folder of a tuning, made if missing, with its effective configuration (JSON types only).

    ``resume`` continues the run in it if that has the same configuration. Another tuning, or results without
    ``resume``, are refused.
    """

    def __init__(self, path: Path, config: dict[str, Any], *, resume: bool) -> None:
        self.path, file = make_folder(path), path / "config.json"
        if not file.exists():
            write_json(file, config)
            return
        if not resume:
            raise InputError(
                f"{path}: already contains a tuning; add --resume to continue it, or choose another --out"
            )
        remedy = "not written by a tuning; choose another --out"
        record = load_record(ConfigRecord, file, remedy, infinite=True)
        saved, wanted = _with_current_names(record.model_extra), json.loads(json.dumps(config))
        if not same_results(record.versions, wanted.pop("versions", {})):
            made = names_shown(" ".join(one) for one in record.versions.items())
            raise InputError(
                f"{file}: was started with other versions, {made}; continue with those, or choose another --out"
            )
        if saved != wanted:
            old, new = _difference("", saved, wanted)
            raise InputError(
                f"{file}: was started with {old}, now asked for {new}; "
                "repeat the first command, or choose another --out"
            )

    def checkpoint(self, trial: int) -> Path:
        """Return the file of a running trial's state."""
        return self.path / f"checkpoint-{trial:03d}.npz"

    def finished(self, trial: int, *records: type[BaseModel]) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Return the result and the history of a finished trial, else None; ``records`` as in `finished_trial`."""
        done = finished_trial(self.path, trial, *records)
        if done:  # a run killed between saving the result and deleting the checkpoint left both
            self.checkpoint(trial).unlink(missing_ok=True)
        return done

    def finish(self, trial: int, result: dict[str, Any], history: dict[str, Any]) -> None:
        """Save a trial's result, then delete its checkpoint."""
        folder = self.path / f"trial-{trial:03d}"
        if not folder.exists():
            with whole_folder(folder) as new:
                new.mkdir()
                write_json(new / "result.json", result)
                np.savez(new / "history.npz", **history)
        self.checkpoint(trial).unlink(missing_ok=True)
