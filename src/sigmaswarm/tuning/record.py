"""The files tuning.toml and convergence.csv."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import polars as pl
from pydantic import AliasChoices, BaseModel, BeforeValidator, Field

from sigmaswarm import notebook
from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.drives.mounting import Angles, common_axes, common_mounting
from sigmaswarm.drives.overlap import TRAINING_DATA_FILE, Landmarks, load_landmarks, whole_drive
from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import require_text
from sigmaswarm.filters.fixes_alone import MotionNoise
from sigmaswarm.filters.parameters import FilterParameters, filter_file, read_filter, units
from sigmaswarm.filters.robot_yaml import YAML
from sigmaswarm.record_files import load_record, to_record
from sigmaswarm.tables import Cell, Column, Table
from sigmaswarm.tuning.bounds import TouchedBound
from sigmaswarm.tuning.diagnostics import DO_NOT_USE, DriftComparison, drift_table, larger_drifts
from sigmaswarm.tuning.inflation import NOISE_SCALE
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.tuning.search import Trial
from sigmaswarm.tuning.space import searched_name
from sigmaswarm.wording import count_of

End = float | Literal["-"]
"""End of the range in which the cost increases by less than 1%; ``-`` if the range reaches the bound."""
NOT_VALIDATED = (
    "the cost is that of the training drives; evaluate the filter on other drives, or pass validation drives"
)
"""Remark in tuning.toml, which an evaluation omits."""
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
PARAMETER_MEANINGS = {
    "latency": (
        "delay with which this filter predicts the fixes best; the doctor estimates this delay as a clock offset, "
        "from turns and accelerations"
    ),
    "rear_axle": "distance of the IMU in front of the rear axle; negative: behind the rear axle",
}
RANGES = (
    'At the values in the columns "from" and "to", the cost is 1% higher than at the tuned value, with all other '
    "parameters unchanged. "
    '"At the bound" means that the cost at the bound of the search is less than 1% higher.'
)
SIGMA_POINTS = {"alpha", "beta", "kappa"}


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
    """Lowest relative change of the cost if only this parameter changes, by parameter.

    Only decreases (< 0) are stored.
    """


class TuningRecord(BaseModel):
    """A tuning.toml. A file of `FilterParameters` has only the tables ``filter`` and ``units``."""

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
        """Read a tuning.toml or the folder of a tuning. An ekf.yaml has no record of a tuning."""
        return cls(filter={}) if path.suffix in YAML else load_record(cls, filter_file(path))

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
        """Arguments of `export_texts`.

        ``imu_axes`` is omitted if the drives have different rotations after these axes.
        """
        axes = {} if self.mountings_differ else self.imu_axes
        return {"as_recorded": self.as_recorded, "mounting": self.mounting, "imu_axes": axes}

    @property
    def unusable(self) -> list[str]:
        """Warnings of the tuning that advise against using the filter."""
        return [one for one in (self.result.warnings if self.result else ()) if DO_NOT_USE in one]

    @property
    def mountings_differ(self) -> bool:
        return self.mounting is None and any(drive.imu_mounting_deg for drive in self.data)

    # ---- sentences and tables, for the terminal, notebooks and the HTML report ----

    @property
    def _known(self) -> ResultRecord:
        if self.result is None:
            raise InputError("the file has no [result] table; specify a file written by `sigmaswarm tune`")
        return self.result

    @property
    def called(self) -> str:
        """Name and type of the filter."""
        config, values = self.config, self.filter
        model = config.get("model", values.get("model", "a filter"))
        if isinstance(model, dict):
            return f"{model.get('name', 'a custom model')} ({model.get('kind', 'ukf')})"
        return f"{model} ({config.get('kind', values.get('kind', 'ukf'))})"

    @property
    def noun(self) -> str:
        return "log" if isinstance(self.config.get("model"), dict) else "drive"

    @property
    def headline(self) -> str:
        result, on = self._known, count_of(len(self.data), self.noun)
        return f"Tuned for {result.objective}: cost {notebook.number(result.cost)} on {on}"

    @property
    def purpose(self) -> str:
        """Filter, training drives and objective, in one or two sentences."""
        result = self.result
        if result is None:
            return f"The filter is {self.called}; its file does not describe a tuning."
        length = sum(drive.duration_s or 0 for drive in self.data)
        on = count_of(len(self.data), self.noun) + (f" ({length / 60:.1f} min)" if length else "")
        meaning = f": {result.objective_meaning}" if result.objective_meaning else ""
        return f"{self.called} was tuned on {on}. The objective is {result.objective}{meaning}."

    @property
    def start(self) -> str:
        result, text = self._known, "cost {:.4f}; cost of the filter from which the search started: {:.4f}"
        return "" if result.start_cost is None else text.format(result.cost, result.start_cost)

    @property
    def training(self) -> str:
        result, before = self._known, ""
        if result.inflation_factor != 1.0:
            before = f"; {result.trial_costs[result.best_trial]:.4f} before process-noise inflation"
        objective = parse_objective(result.objective)
        unit = " nats per fix" if objective.likelihood and not objective.needs_truth else ""
        on = count_of(len(self.data), self.noun)
        return f"cost {result.cost:.4f}{unit} ({result.objective}{before}) on {on}"

    @property
    def racing(self) -> str:
        steps, full = self._known.filter_steps, self._known.filter_steps_without_racing
        if not self.config.get("racing") or not full:
            return ""
        return f"racing: {steps} filter steps, {steps / full:.0%} of those of a search without racing"

    @property
    def gap(self) -> str:
        """Comparison of the errors on validation and training drives."""
        gap = self._known.validation_gap
        if gap is None:
            return ""
        larger = f"{abs(gap):.1%} {'larger' if gap >= 0 else 'smaller'}"
        return f"errors {larger} than on the training {self.noun}s" if math.isfinite(gap) else "failed"

    @property
    def validation(self) -> str:
        result = self._known
        if result.validation_cost is None or not self.gap:
            return ""
        on = count_of(len(result.validation_drives), f"validation {self.noun}")
        return f"cost {result.validation_cost:.4f} on {on} ({self.gap})"

    @property
    def drifts(self) -> Table | None:
        """Drifts without fixes, if they were measured."""
        durations = [drive.duration_s or 0.0 for drive in self.data]
        return drift_table(self.forecasts, durations) if self.forecasts else None

    @property
    def larger_drifts(self) -> list[str]:
        """A sentence for each method that drifts less than the tuned filter."""
        return larger_drifts(self.forecasts)

    def unconfirmed_drifts(self, lengths: Collection[float]) -> list[str]:
        """Return a sentence for each larger drift on the training drives, in outages of other lengths (s)."""
        rest = [one for one in self.forecasts if one.length_s not in lengths]
        return [
            f"on the training drives, {text}; this evaluation has no such outages"
            for text in larger_drifts(rest)
        ]

    def parameters(self, caption: str = "") -> Table:
        """Return the table of all parameters, with the range in which the cost increases by less than 1%."""
        ranges = self.within_1_percent_of_the_cost
        touched = {
            bound.parameter: bound.place for bound in (self.result.touched_bounds if self.result else ())
        }
        rows: list[tuple[Cell, ...]] = []
        model = str(self.filter.get("model"))
        for name, value, unit, density in self._values():
            if self.filter.get("kind") == "ekf" and name in SIGMA_POINTS:
                continue
            low, high = ranges.get(searched_name(name, ranges, model), (None, None))
            place = touched.get(searched_name(name, touched, model), "")
            if (low, high) == ("-", "-"):
                place = "no effect within the bounds"
            remark = "; ".join(filter(None, (PARAMETER_MEANINGS.get(name, ""), place)))
            rows.append((name, value, unit, _end(low), _end(high), density, remark))
        if NOISE_SCALE in ranges:
            ends = map(_end, ranges[NOISE_SCALE])
            rows.append((NOISE_SCALE, 1.0, "", *ends, "", "one factor on all noise variances"))
        titles = ("parameter", "value", "unit", "from", "to", "density", "remark")
        return Table(caption, tuple(map(Column, titles)), tuple(rows))

    def _values(self) -> Iterator[tuple[str, Cell, str, str]]:
        """Yield name, value, unit and density of each number of the filter."""
        units = self.units
        names = {
            "process_noise": [f"q_{state}" for state in units.get("states", [])],
            "measurement_noise": ["r_x", "r_y"],
            "bias_std": ["accel_bias_std", "gyro_bias_std"],
        }
        for key, value in self.filter.items():
            unit = units.get(key, "")
            if not isinstance(value, list):
                yield key, value, unit if isinstance(unit, str) else "", ""
                continue
            for i, entry in enumerate(value):
                name = dict(enumerate(names.get(key, []))).get(i, f"{key}[{i}]")
                one = unit if isinstance(unit, str) else unit[i] if i < len(unit) else ""
                density = self.densities.get(name.removeprefix("q_"), "") if name.startswith("q_") else ""
                yield name, entry, one, density


def _end(end: End | None) -> Cell:
    return "at the bound" if end == "-" else end


@dataclass(frozen=True, eq=False)
class TunedFilter:
    """A filter, the record of its tuning, and the landmarks of the training drives (see `drives.overlap`).

    Landmarks are positions and yaw rates of a drive (see `drives.overlap`).
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
