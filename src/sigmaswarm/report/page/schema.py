"""What result files hold, as far as a page shows it; a file that holds something else gets one clear line."""

import json
import tomllib
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError

from sigmaswarm.errors import InputError, first_mistake
from sigmaswarm.files import finite

End = float | Literal["-"]


class Result(BaseModel):
    """``[result]`` of tuning.toml."""

    cost: float
    objective: str
    objective_meaning: str = ""
    validation_cost: float | None = None
    validation_gap: float | None = None
    validation_drives: list[str] = Field(default_factory=list)
    touched_bounds: list[str] = Field(default_factory=list)
    unidentified: list[str] = Field(default_factory=list)
    remarks: list[str] = Field(default_factory=list)
    best_trial: int = 0
    trial_costs: list[float] = Field(default_factory=list)
    evaluations: int = 0
    failures: int = 0


class Data(BaseModel):
    """A drive that a result comes from."""

    name: str
    sha256: str = ""
    duration_s: float | None = None
    imu_samples: int | None = None
    fixes: int | None = None
    has_truth: bool | None = None


class TuningFile(BaseModel):
    """tuning.toml; a file of filter parameters has only the first two tables."""

    filter: dict[str, float | str | list[float]]
    units: dict[str, str | list[str]] = Field(default_factory=dict)
    densities: dict[str, str] = Field(default_factory=dict)
    result: Result | None = None
    within_1_percent_of_the_cost: dict[str, tuple[End, End]] = Field(default_factory=dict)
    config: dict[str, Any] = Field(default_factory=dict)
    versions: dict[str, str] = Field(default_factory=dict)
    data: list[Data] = Field(default_factory=list[Data])


class ConsistencyEntry(BaseModel):
    """What scores.json says of the tuned filter's covariances on a drive."""

    n_fixes: int
    mean_nis: float
    nis_band_95: tuple[float, float]
    share_inside_95_gate: float
    autocorrelation: list[float] = Field(min_length=1)
    white_p: float
    mean_nees: float | None = None


Measures = dict[str, float | None]


class ScoresFile(BaseModel):
    """scores.json: drive, method, measure; the means over drives; consistency."""

    drives: dict[str, dict[str, Measures]] = Field(min_length=1)
    mean: dict[str, Measures]
    consistency: dict[str, ConsistencyEntry | None] = Field(default_factory=dict)


class EvaluationFile(BaseModel):
    """evaluation.json: what was asked."""

    outage_length_s: float
    outage_seed: int
    versions: dict[str, str]
    data: list[Data]


M = TypeVar("M", bound=BaseModel)


def load(kind: type[M], path: Path) -> M:
    """Read a TOML or JSON result file.

    Raises
    ------
    InputError
        Naming the file, the key and what is wrong with it.
    """
    try:
        text = path.read_text(encoding="utf-8")
        return kind.model_validate(
            tomllib.loads(text) if path.suffix == ".toml" else finite(json.loads(text))
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
