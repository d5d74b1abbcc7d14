"""The files tuning.toml and convergence.csv."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import polars as pl
from pydantic import AliasChoices, BaseModel, BeforeValidator, Field

from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.drives.mounting import Angles, common_axes, common_mounting
from sigmaswarm.drives.overlap import TRAINING_DATA_FILE, Landmarks, load_landmarks, whole_drive
from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import require_text
from sigmaswarm.filters.fixes_alone import MotionNoise
from sigmaswarm.filters.parameters import FilterParameters, read_filter, units
from sigmaswarm.filters.robot_yaml import YAML
from sigmaswarm.record_files import load_record, to_record
from sigmaswarm.tuning.bounds import TouchedBound
from sigmaswarm.tuning.diagnostics import DO_NOT_USE, DriftComparison
from sigmaswarm.tuning.search import Trial

End = float | Literal["-"]
"""End of the range in which the cost increases by less than 1%; ``-`` if the range ends at the bound."""
NOT_VALIDATED = (
    "the cost is that of the training drives; evaluate the filter on other drives, or pass validation drives"
)
"""Remark in tuning.toml; an evaluation omits it."""
NOT_VALIDATED_TEXTS = (
    NOT_VALIDATED,
    "its cost is that of the drives it was tuned on; evaluate it on others, or name some as validation",
)
"""Texts of the remark in files of this version and of 0.3.0."""
FILE = "tuning.toml"
HISTORY_FILE = "convergence.csv"
CONVERGENCE = {
    **dict.fromkeys(("trial", "generation"), pl.Int64()),
    **dict.fromkeys(("best_cost", "median_cost"), pl.Float64()),
}


class ResultRecord(BaseModel):
    """``[result]`` of tuning.toml."""

    cost: float
    objective: str
    objective_meaning: str = ""
    start_cost: float | None = None
    validation_cost: float | None = None
    validation_gap: float | None = None
    validation_drives: list[str] = Field(default_factory=list)
    inflation_factor: float = Field(
        default=1.0, validation_alias=AliasChoices("inflation_factor", "margin_raised_by")
    )
    touched_bounds: list[Annotated[TouchedBound, BeforeValidator(TouchedBound.read)]] = Field(
        default_factory=list
    )
    unidentified: list[str] = Field(default_factory=list)
    remarks: list[str] = Field(default_factory=list)
    warnings: tuple[str, ...] = Field(default=(), validation_alias=AliasChoices("warnings", "doubts"))
    """Faults of the tuned filter that the objective does not show, found on the training data."""
    best_trial: int = 0
    trial_costs: tuple[float, ...] = ()
    evaluations: int = 0
    failures: int = 0
    filter_steps: int = 0
    filter_steps_without_racing: int = 0
    lower_cost_at: dict[str, float] = Field(default_factory=dict)
    """Lowest relative change of the cost if only one parameter changes, by parameter; contains only negative values."""


class TuningRecord(BaseModel):
    """tuning.toml; a file of `FilterParameters` has only the tables ``filter`` and ``units``."""

    filter: dict[str, float | str | list[float]]
    units: dict[str, str | list[str]] = Field(default_factory=dict)
    densities: dict[str, str] = Field(default_factory=dict)
    result: ResultRecord | None = None
    within_1_percent_of_the_cost: dict[str, tuple[End, End]] = Field(default_factory=dict)
    config: dict[str, Any] = Field(default_factory=dict)
    fixes_alone: MotionNoise | None = None
    forecasts: list[DriftComparison] = Field(default_factory=list[DriftComparison])
    versions: dict[str, str] = Field(default_factory=dict)
    data: list[DriveRecord] = Field(default_factory=list[DriveRecord])

    @classmethod
    def read(cls, path: Path) -> "TuningRecord":
        """Read a tuning.toml or the folder of a tuning; an ekf.yaml has no record of a tuning."""
        return cls(filter={}) if path.suffix in YAML else load_record(cls, tuning_file(path))

    @classmethod
    def of(cls, parameters: FilterParameters | None) -> "TuningRecord":
        """Return the record of a filter without a tuning."""
        return (
            cls(filter={})
            if parameters is None
            else cls(filter=parameters.to_dict(), units=units(parameters))
        )

    @property
    def as_recorded(self) -> bool:
        """True if the filter was tuned without preprocessing."""
        return self.config.get("as_recorded", False) is True

    @property
    def mounting(self) -> Angles | None:
        """Mounting of the IMU in all training drives, deg; None if it is unknown or differs between the drives."""
        return common_mounting(drive.imu_mounting_deg for drive in self.data)

    @property
    def imu_axes(self) -> dict[str, str]:
        """Import expressions of the IMU's axes; empty if they are unknown or differ between the training drives."""
        return common_axes(drive.imu_axes for drive in self.data)

    @property
    def shown_std(self) -> float | None:
        """Standard deviation of the fixes from truth or scatter of the training drives, m per axis; None if unknown."""
        known = [drive.shown_std_m for drive in self.data if drive.shown_std_m is not None]
        return float(np.median(known)) if known else None

    @property
    def for_export(self) -> dict[str, Any]:
        """Arguments of `export_texts`."""
        return {"as_recorded": self.as_recorded, "mounting": self.mounting, "imu_axes": self.imu_axes}

    @property
    def unusable(self) -> list[str]:
        """Warnings of the tuning that advise against using the filter."""
        return [one for one in (self.result.warnings if self.result else ()) if DO_NOT_USE in one]

    @property
    def mountings_differ(self) -> bool:
        return self.mounting is None and any(drive.imu_mounting_deg for drive in self.data)


def tuning_file(path: Path) -> Path:
    """Return the tuning.toml of a folder; raise `InputError` for an interrupted tuning, which has none yet."""
    if not path.is_dir():
        return path
    if (path / "config.json").exists() and not (path / FILE).exists():
        raise InputError(
            f"{path}: has no finished tuning; add --resume to the command that made this folder, and run it again"
        )
    return path / FILE


@dataclass(frozen=True, eq=False)
class TunedFilter:
    """A filter, the record of its tuning, and the landmarks by which copies of the training drives are recognized.

    Landmarks are positions and yaw rates of a drive: see `drives.overlap`.
    """

    parameters: FilterParameters
    record: TuningRecord = field(default_factory=lambda: TuningRecord(filter={}))
    seen: Sequence[Landmarks] = ()

    @classmethod
    def read(cls, path: Path) -> "TunedFilter":
        """Read a TOML file with a filter, the folder of a tuning, or an ekf.yaml; see `FilterParameters.load`."""
        if path.suffix in YAML:
            return cls(FilterParameters.load(path))
        content, file = read_filter(path)
        parameters, record = (
            FilterParameters.from_content(content, file),
            to_record(TuningRecord, content, file),
        )
        return cls(parameters, record, training_data_of(record, file))


def training_data_of(record: TuningRecord, file: Path) -> list[Landmarks]:
    """Return the landmarks of the training drives of a tuning.toml, from seen.npz next to it.

    If seen.npz is missing or does not belong to tuning.toml, only whole drives can be recognized.
    """
    kept = load_landmarks(file.parent / TRAINING_DATA_FILE)
    if kept is not None and [marks.sha256 for marks in kept] == [drive.sha256 for drive in record.data]:
        return kept
    return [whole_drive(d.name, d.sha256, d.duration_s or 0.0) for d in record.data if d.sha256]


def history_of(trials: Sequence[Trial]) -> pl.DataFrame:
    """Return the table of convergence.csv: lowest cost so far and median cost of each generation."""
    rows = [
        (number, generation, *costs)
        for number, trial in enumerate(trials)
        for generation, costs in enumerate(zip(trial.best.tolist(), trial.median.tolist(), strict=True), 1)
    ]
    return pl.DataFrame(rows, CONVERGENCE, orient="row")


def load_history(path: Path) -> pl.DataFrame:
    try:
        require_text(path)
        table = pl.read_csv(path, glob=False, schema_overrides=CONVERGENCE).select(list(CONVERGENCE))
        if table.is_empty() or table.select("trial", "generation").null_count().sum_horizontal().item():
            raise InputError("a row without a trial")
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError):
        raise InputError(f"{path}: not readable; repeat `sigmaswarm tune`") from None
    return table.with_columns(pl.col("best_cost", "median_cost").fill_null(math.nan))
