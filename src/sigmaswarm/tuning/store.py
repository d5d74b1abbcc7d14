"""The folder of a tuning run. Files are written atomically, and the same result gives identical files.

The folder contains

    config.json          configuration, data and versions, which must be the same for a resumed run
    checkpoint-000.npz   complete state of an unfinished trial after its latest generation
    trial-000/           result.json and history.npz of a finished trial
    tuning.toml          filter of the best trial, after all trials
    seen.npz             landmarks: positions and yaw rates by which copies of the training drives are recognized
"""

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from pydantic import BaseModel, Field, model_validator

from sigmaswarm.errors import InputError
from sigmaswarm.files import atomic_file, atomic_folder, free_path, make_folder, read_arrays, write_json
from sigmaswarm.record_files import ARRAYS, Vector, load_record
from sigmaswarm.tuning.config import RENAMED
from sigmaswarm.versions import same_results
from sigmaswarm.wording import list_names, printable

MAX_LENGTH = 120  # characters of a value in a message


DRIVES = (
    "data",
    "validation",
    "test",
)  # keys of a configuration with records of drives; "test": of a comparison
CENTER = "center"
"""Key of the center of the first generation (values by parameter). Without it, that generation is uniform."""


class ConfigRecord(BaseModel, extra="allow"):
    versions: dict[str, str] = Field(default_factory=dict)


class CountsRecord(BaseModel, extra="forbid"):
    evaluations: int
    failures: int


class TrialRecord(BaseModel, extra="forbid"):
    cost: float
    counts: CountsRecord


class TrialHistoryRecord(BaseModel):
    """history.npz of a trial: best point, shape (d,), and values after each generation, shape (g,)."""

    model_config = ARRAYS
    point: Vector
    best: Vector
    median: Vector
    steps: Vector

    @model_validator(mode="after")
    def _of_one_length(self) -> Self:
        if not 0 < len(self.best) == len(self.median) == len(self.steps):
            raise ValueError("best, median and steps should have the same length")
        if np.isnan([*self.best, *self.median]).any() or not np.isfinite([*self.point, *self.steps]).all():
            raise ValueError("point and steps should be finite, and costs should not be NaN")
        return self


def save_checkpoint(path: Path, arrays: dict[str, Any], notes: dict[str, Any]) -> None:
    with atomic_file(path) as file:
        np.savez(file, **arrays, notes=json.dumps(notes))


def load_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    if not path.exists():
        return None
    try:
        arrays: dict[str, Any] = {**read_arrays(path)}
        return arrays, json.loads(str(arrays.pop("notes")))
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise checkpoint_error(path) from None


def saved_options(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the options and the data of the tuning in a folder, to resume it with `tune`."""
    record = load_record(ConfigRecord, path / "config.json", "not written by a tuning", infinite=True)
    config = _with_current_names(record.model_extra)
    config.pop(CENTER, None)
    if "start" in config:
        raise InputError(
            f"{path}: the tuning was started with --start; repeat its first command and add --resume"
        )
    return config, config.pop("data", [])


def saved_history(path: Path) -> dict[int, list[float]]:
    """Return the lowest cost so far after each generation, by trial. The tuning need not be finished."""
    history: dict[int, list[float]] = {}
    for entry in sorted((*path.glob("trial-???"), *path.glob("checkpoint-???.npz"))):
        number = int(entry.stem[-3:])
        done = finished_trial(path, number) if entry.is_dir() else load_checkpoint(entry)
        if done and number not in history:
            history[number] = np.asarray(done[entry.is_dir()]["best"], np.float64).tolist()
    return history


def checkpoint_error(checkpoint: Path) -> InputError:
    return InputError(f"{checkpoint}: not a readable checkpoint; delete it to redo this trial")


def finished_trial(
    path: Path,
    trial: int,
    result_type: type[BaseModel] = TrialRecord,
    history_type: type[BaseModel] = TrialHistoryRecord,
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    folder = path / f"trial-{trial:03d}"
    if not folder.exists():
        return None
    remedy = f"delete {folder} to redo this trial"
    result = load_record(result_type, folder / "result.json", remedy, missing=remedy, infinite=True)
    history = load_record(history_type, folder / "history.npz", remedy, missing=remedy)
    return result.model_dump(), vars(history) | (history.model_extra or {})


def _with_current_names(config: Any) -> Any:
    """Replace the option names of version 0.3.0."""
    if not isinstance(config, dict):
        return config
    items = cast(dict[str, Any], config).items()
    return {RENAMED.get(key, key): _with_current_names(value) for key, value in items}


def _difference(key: str, saved: Any, wanted: Any) -> tuple[str, str]:
    if key in DRIVES:
        for old, new in _same_drives(saved, wanted):
            if old != new:
                return _difference(f"drive {printable(new['name'])}", old, new)
    if isinstance(saved, dict) and isinstance(wanted, dict) and key not in ("data", "model"):
        old, new = cast(dict[str, Any], saved), cast(dict[str, Any], wanted)
        inner = next(k for k in sorted(old.keys() | new.keys()) if old.get(k) != new.get(k))
        return _difference(f"{key}.{inner}" if key else inner, old.get(inner), new.get(inner))
    return _short(key, saved), _short(key, wanted)


def _same_drives(saved: Any, wanted: Any) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return pairs of the drives' records if both lists name the same drives with the same data; otherwise nothing."""
    with suppress(LookupError, TypeError, ValueError):  # a damaged file lacks names or hashes
        pairs = list(zip(saved, wanted, strict=True))
        if all(old["name"] == new["name"] and old["sha256"] == new["sha256"] for old, new in pairs):
            return pairs
    return []


def _short(key: str, value: Any) -> str:
    with suppress(LookupError, TypeError):  # a damaged file lacks names or hashes
        if key == "data" and isinstance(value, list):
            return "the drives " + list_names(f"{d['name']} ({d['sha256'][:8]})" for d in value)
        if key == "model" and isinstance(value, dict):  # a custom model is too long for a message
            return "the model " + printable(f"{value['name']} ({value['sha256'][:8]})")
    return f"{printable(key)} = {printable(value, MAX_LENGTH)}"


def _drives(config: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for drive in (drive for key in DRIVES for drive in config.get(key, [])):
        if isinstance(drive, dict):
            yield cast(dict[str, Any], drive)


def _require_same(file: Path, config: dict[str, Any]) -> dict[str, float] | None:
    """Return the saved center of the first generation. Raises `InputError` if a saved configuration differs."""
    record = load_record(ConfigRecord, file, "not written by a tuning; choose another --out", infinite=True)
    saved, wanted = _with_current_names(record.model_extra), json.loads(json.dumps(config))
    center, _ = saved.pop(CENTER, None), wanted.pop(CENTER, None)
    for one in (saved, wanted):
        for drive in _drives(one):
            drive.pop("slow", None)  # version 0.3.0 does not save it
    if not any("stated" in drive for drive in _drives(saved)):  # version 0.3.0 does not save it
        for drive in _drives(wanted):
            drive.pop("stated", None)
    if not same_results(record.versions, wanted.pop("versions", {})):
        made = list_names(" ".join(one) for one in record.versions.items())
        raise InputError(
            f"{file}: the tuning was started with other software versions, {made}; continue with these versions, "
            "or choose another --out"
        )
    if saved != wanted:
        old, new = _difference("", saved, wanted)
        raise InputError(
            f"{file}: the tuning was started with {old}, but this command has {new}; "
            "repeat the first command, or choose another --out"
        )
    return center


class ResultFolder:
    """The folder of a tuning run, created if missing.

    With ``resume``, the folder may contain a run with the same configuration. Raises `InputError` if the folder
    contains another tuning, or if it contains any tuning and ``resume`` is False. The message proposes ``--resume``
    only if the configuration is the same.

    ``center`` is the `CENTER` of the configuration. For a resumed run it is the saved center, which is missing in files
    of version 0.3.0.
    """

    def __init__(self, path: Path, config: dict[str, Any], *, resume: bool) -> None:
        self.path, file = make_folder(path), path / "config.json"
        self.center: dict[str, float] | None = config.get(CENTER)
        if not file.exists():
            write_json(file, config)
            return
        if resume:
            self.center = _require_same(file, config)
            return
        remedy = f"its drives or options differ; choose another folder, for example --out {free_path(path)}"
        with suppress(InputError):
            _require_same(file, config)
            remedy = "add --resume to continue it, or choose another --out"
        kind = "a" if (path / "tuning.toml").exists() else "an unfinished"
        raise InputError(f"{path}: already contains {kind} tuning; {remedy}")

    def checkpoint(self, trial: int) -> Path:
        return self.path / f"checkpoint-{trial:03d}.npz"

    def finished(self, trial: int, *records: type[BaseModel]) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Return the result and the history of a finished trial. For ``records`` see `finished_trial`."""
        done = finished_trial(self.path, trial, *records)
        if done:  # both exist if the run was killed between the two steps of `finish`
            self.checkpoint(trial).unlink(missing_ok=True)
        return done

    def finish(self, trial: int, result: dict[str, Any], history: dict[str, Any]) -> None:
        folder = self.path / f"trial-{trial:03d}"
        if not folder.exists():
            with atomic_folder(folder) as new:
                new.mkdir()
                write_json(new / "result.json", result)
                np.savez(new / "history.npz", **history)
        self.checkpoint(trial).unlink(missing_ok=True)
