"""The result of a tuning run, and its file."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Generic

import numpy as np
import tomli_w
from typing_extensions import TypeVar

from sigmaswarm import notebook
from sigmaswarm.drives.mounting import KEY, Angles, axes_of, common_axes, common_mounting
from sigmaswarm.drives.overlap import Landmarks
from sigmaswarm.errors import InputError, warn_deprecated
from sigmaswarm.files import write_atomically
from sigmaswarm.filters.fixes_alone import MotionNoise
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters, densities, filter_file, units
from sigmaswarm.record_files import read_content, to_record
from sigmaswarm.tuning.bounds import TouchedBound
from sigmaswarm.tuning.config import ModelTuneConfig, SearchConfig, TuneConfig, validated_config
from sigmaswarm.tuning.custom import MODEL_OBJECTIVES
from sigmaswarm.tuning.diagnostics import DriftComparison
from sigmaswarm.tuning.inflation import MAX_INCREASE, NOISE_SCALE, Sensitivity
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.tuning.record import NOT_VALIDATED, RANGES, TuningRecord, training_data_of
from sigmaswarm.tuning.search import Trial, saved_trials
from sigmaswarm.tuning.space import SCALING, search_space
from sigmaswarm.versions import versions
from sigmaswarm.wording import count_of, sort_remarks, to_do

P = TypeVar("P", default=FilterParameters)
SHOWN_REMARKS = 5  # number of remarks in the printed text
INFLATION_REMARK = (
    "after the search, the process noise was increased until the cost rose slightly, so that the filter also suits "
    "other roads and IMUs. This step multiplied {}; --inflation 0 omits it"
)
SENSORS_REMARK = (
    "a filter tuned with truth is valid only for the receiver and the IMU of its training drives. With other sensors "
    "it may be far less accurate than the fixes; for other sensors, tune without truth (--objective innovation-t)"
)
MORE_DRIVES = "tune on more drives, or on drives that resemble the validation drives"
STORED = (
    *("cost", "start_cost", "inflation_factor", "touched_bounds", "warnings"),
    *("best_trial", "trial_costs", "evaluations", "failures"),
)
"""Attributes of `Tuning` with the same name in the file."""
LARGE_GAP = 0.2  # relative increase of the errors on validation drives above which a remark is made


@dataclass(frozen=True)
class Validation:
    """Cost, without priors, on drives that the search did not use.

    ``gap`` is the increase of this cost relative to the training cost.
    """

    cost: float
    gap: float
    drives: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Tuning(Generic[P]):
    """Result of `tune`.

    Attributes
    ----------
    parameters : FilterParameters, or dict of str to float for a custom model
        Tuned parameters, after process-noise inflation.
    cost : float
        Cost of these parameters on the training drives, including priors.
    touched_bounds : list of TouchedBound
        Parameters at a bound; the optimum may lie beyond it.
    trial_costs : tuple of float
        Lowest cost of each trial, before inflation.
    best_trial : int
        Index of the trial with the lowest cost.
    config : TuneConfig, or ModelTuneConfig for a custom model
    trials : tuple of Trial
        Empty if the folders of the trials are missing.
    evaluations, failures : int
        Number of evaluated parameter sets, and number of these that failed.
    steps, full_steps : int
        Number of filter steps of the search, and of the same search without racing.
    data : list of dict
        Name, duration, fingerprint and other properties of each training drive.
    seen : sequence of Landmarks
        Sampled values of each training drive. `evaluate` compares them with other drives to recognize training data.
    warnings : tuple of str
        Faults of the tuned filter that the objective does not show, found on the training drives.
    sensitivities : tuple of Sensitivity
        Range of each parameter in which the cost increases by less than 1%.
    validation : Validation or None
    inflation_factor : float
        Factor by which process noise is inflated; 1 without inflation. See `tuning.inflation`.
    start_cost : float or None
        Cost of the start filter on the training drives; None if no ``start`` was given.
    fixes_alone : MotionNoise or None
        Noise parameters of a constant-velocity filter that uses only the fixes, fitted to the training drives by
        likelihood.
    forecasts : tuple of DriftComparison
        Drifts over outages of 1, 5 and 30 s on the first training drives, compared with fixes alone and the baseline.
    choice : str
        Model and measurements that `tune` chose, and the reason; empty if they were given. The file does not contain
        this attribute.
    """

    parameters: P
    cost: float
    touched_bounds: list[TouchedBound]
    trial_costs: tuple[float, ...]
    best_trial: int
    config: SearchConfig
    trials: tuple[Trial, ...] = ()
    evaluations: int = 0
    failures: int = 0
    steps: int = 0
    full_steps: int = 0
    data: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    seen: Sequence[Landmarks] = ()
    warnings: tuple[str, ...] = ()
    sensitivities: tuple[Sensitivity, ...] = ()
    validation: Validation | None = None
    inflation_factor: float = 1.0
    start_cost: float | None = None
    fixes_alone: MotionNoise | None = None
    forecasts: tuple[DriftComparison, ...] = ()
    choice: str = ""

    @property
    def doubts(self) -> tuple[str, ...]:
        """Deprecated name of ``warnings``."""
        warn_deprecated("Tuning.doubts", "Tuning.warnings")
        return self.warnings

    @property
    def raised_by(self) -> float:
        """Deprecated name of ``inflation_factor``."""
        warn_deprecated("Tuning.raised_by", "Tuning.inflation_factor")
        return self.inflation_factor

    @property
    def unidentified(self) -> list[str]:
        """Parameters that can have any value within their bounds while the cost increases by less than 1%."""
        return [s.name for s in self.sensitivities if not s.identified]

    @property
    def mounting(self) -> Angles | None:
        """Roll, pitch and yaw of the IMU in the vehicle, deg; None if it is unknown or differs between drives."""
        return common_mounting(entry.get(KEY) for entry in self.data)

    @property
    def imu_axes(self) -> dict[str, str]:
        """Import expressions of the IMU's axes; empty if they are unknown or differ between the training drives."""
        return common_axes(map(axes_of, self.data))

    @property
    def remarks(self) -> list[str]:
        """Remarks on the result; those with a remedy come first."""
        return sort_remarks(_remarks(self))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of tuning.toml as plain types."""
        v = self.validation
        result: dict[str, Any] = {
            **{name: getattr(self, name) for name in STORED},
            "objective": self.config.objective,
            "objective_meaning": self._meaning(),
            "validation_cost": v and v.cost,
            "validation_gap": v and v.gap,
            "validation_drives": v and v.drives,
            "inflation_factor": None if self.inflation_factor == 1.0 else self.inflation_factor,
            "touched_bounds": [str(touched) for touched in self.touched_bounds],
            "unidentified": self.unidentified,
            "remarks": self.remarks,
            "filter_steps": self.steps,
            "filter_steps_without_racing": self.full_steps,
            "lower_cost_at": {s.name: s.lowest_rise for s in self.sensitivities if s.lowest_rise < 0} or None,
        }
        return {
            **self._filter(),
            "result": {k: [*x] if isinstance(x, tuple) else x for k, x in result.items() if x is not None},
            "within_1_percent_of_the_cost": {
                s.name: ["-" if end is None else end for end in (s.lowest, s.highest)]
                for s in self.sensitivities
            },
            "config": self.config.model_dump(mode="json", exclude_none=True),
            **({"fixes_alone": asdict(self.fixes_alone)} if self.fixes_alone else {}),
            **({"forecasts": [asdict(each) for each in self.forecasts]} if self.forecasts else {}),
            "versions": versions(),
            "data": self.data,
        }

    def _filter(self) -> dict[str, Any]:
        p = self.parameters
        if isinstance(p, FilterParameters):
            return {"filter": p.to_dict(), "units": units(p), "densities": densities(p)}
        model = self.config.model if isinstance(self.config, ModelTuneConfig) else {}
        stated = {t["name"]: t["unit"] for t in model["parameters"] if t["unit"]}
        return {"filter": p, "units": stated | {"states": model["states"]}}

    def _meaning(self) -> str:
        if not isinstance(self.config, TuneConfig):
            return MODEL_OBJECTIVES[self.config.objective]
        meaning, prior = parse_objective(self.config.objective).summary, self.config.prior
        lasting = isinstance(p := self.parameters, FilterParameters) and p.fix_error is not None
        penalized = "different from" if lasting else "below"
        added = f"; a prior with weight {prior:g} penalizes an R {penalized} the receiver's variance"
        if MODELS[self.config.model].tilts and self.config.scale == "log10":
            added += ", and parameters far from typical values"
        return f"{meaning}{added}" if prior else meaning

    @cached_property
    def record(self) -> TuningRecord:
        """The content of tuning.toml."""
        return TuningRecord.model_validate(self.to_dict())

    def __repr__(self) -> str:
        record, given = self.record, getattr(self.config, "use", None)
        sources = "" if given is None else f" with {', '.join(given) or 'position fixes alone'}"
        lines = [
            record.headline,
            f"filter: {record.called}{sources}, {count_of(len(self.trial_costs), 'trial')}",
        ]
        if isinstance(self.config, ModelTuneConfig):
            units = record.units
            values = (
                f"{k} {notebook.number(x)} {units.get(k, '')}" for k, x in self._filter()["filter"].items()
            )
            lines.append("parameters: " + ", ".join(value.strip() for value in values))
        lines += filter(None, [record.validation])
        if drifts := record.drifts:
            lines += [f"{drifts.caption}:", drifts.to_text(), *record.larger_drifts]
        remarks = self.remarks
        lines += remarks[:SHOWN_REMARKS]
        if (more := len(remarks) - SHOWN_REMARKS) > 0:
            lines.append(f"see .remarks for {count_of(more, 'more remark')}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        table = self.record.parameters(f"{self.record.headline}. {RANGES}")
        return table.to_html() + notebook.html_list("Warnings:", self.remarks)

    def save(self, path: str | Path) -> None:
        """Write a tuning.toml, which `Tuning.load` and `FilterParameters.load` read."""
        write_atomically(Path(path), tomli_w.dumps(self.to_dict()))

    @classmethod
    def load(cls, path: str | Path) -> "Tuning[Any]":
        """Read a tuning.toml, or the folder of a tuning.

        Raises
        ------
        InputError
            If the file can't be read, or is not the result of a tuning run.
        """
        file = filter_file(Path(path))
        content = read_content(file)
        record = to_record(TuningRecord, content, file)
        result = record.result
        if result is None:
            raise InputError(f"{file}: has no [result] table; specify a file written by `sigmaswarm tune`")
        own = isinstance(record.config.get("model"), dict)
        config = validated_config(ModelTuneConfig if own else TuneConfig, record.config)
        parameters: Any = record.filter if own else FilterParameters.from_content(content, file)
        values: dict[str, Any] = {**record.filter}
        if isinstance(config, TuneConfig):
            kind, use, truth = config.kind, config.use, parse_objective(config.objective).needs_truth
            space = search_space(config.model, config.scale, kind=kind, use=use, has_truth=truth)
            values = space.values_of(parameters)
        sensitivities = tuple(
            Sensitivity(
                name,
                float(values.get(name, 1.0)),
                *(None if end == "-" else end for end in ends),
                lowest_rise=result.lower_cost_at.get(name, 0.0),
            )
            for name, ends in record.within_1_percent_of_the_cost.items()
        )
        validation, gap = None, result.validation_gap
        if result.validation_cost is not None and gap is not None:
            validation = Validation(result.validation_cost, gap, tuple(result.validation_drives))
        return Tuning(
            **{name: getattr(result, name) for name in STORED},
            parameters=parameters,
            config=config,
            trials=saved_trials(file.parent, len(result.trial_costs)),
            steps=result.filter_steps,
            full_steps=result.filter_steps_without_racing,
            data=[drive.model_dump(exclude_unset=True) for drive in record.data],
            seen=tuple(training_data_of(record, file)),
            sensitivities=sensitivities,
            validation=validation,
            fixes_alone=record.fixes_alone,
            forecasts=tuple(record.forecasts),
        )


def _remarks(t: Tuning[Any]) -> Iterator[str]:
    p, objective, factor = t.parameters, parse_objective(t.config.objective), t.inflation_factor
    car = p if isinstance(p, FilterParameters) else None
    yield from t.warnings
    if factor != 1.0:
        times = _plain(factor)
        inflated = f"all process noise variances by {times}"
        if car and MODELS[car.model].gyro_axes:
            inflated = f"all process noise variances except that of the gyro's bias by {times}"
        if car and MODELS[car.model].measures_imu:
            inflated = f"the process noise variances of position, velocity and acceleration by {times}"
        if car and MODELS[car.model].tilts:
            root = _plain(factor**0.5)
            inflated = (
                f"the variances of the biases' random walks by {times} and the process noise variances of "
                f"position and velocity by {root}"
            )
        yield INFLATION_REMARK.format(inflated)
    fixed = {*t.unidentified, *(dimension.name for dimension in SCALING)}
    for touched in () if car else t.touched_bounds:  # users choose the bounds of their own models
        if touched.parameter not in fixed:
            why = f"{touched}, so the optimum may lie beyond the bounds"
            yield to_do("widen the bounds in your model", why)
    if names := ", ".join(name for name in t.unidentified if name != NOISE_SCALE):
        yield (
            f"the tuned values of {names} are arbitrary, since any other value within the bounds raises the cost by "
            "less than 1%; no action is needed"
        )
    if NOISE_SCALE in t.unidentified and not objective.scale_free:
        why = (
            "the objective does not depend on the common scale of all noise variances, so the covariances are "
            "not reliable"
        )
        yield to_do("add innovation-nll or nis to the objective", why)
    if car and not (car.lateral_noise or car.velocity_noise) and "truth-pose" not in objective.name:
        remedy = "for a car, use the lateral constraint (--use lateral), or tune with truth-pose"
        why = "the heading can hardly be estimated from fixes alone and may be wrong by tens of degrees"
        yield to_do(remedy, why)
    better = min(t.sensitivities, key=lambda s: s.lowest_rise, default=None)
    if better and better.lowest_rise < -MAX_INCREASE and factor == 1.0:
        lower = f"lowers the cost by {-better.lowest_rise:.0%}"
        why = f"a change of {better.name} alone {lower}, so the search did not converge"
        polish = "" if t.config.polish else ", or add --polish 300"
        yield to_do(f"increase --generations or --trials{polish}", why)
    if car and objective.needs_truth:
        yield SENSORS_REMARK
    if t.mounting is None and any(KEY in entry for entry in t.data):
        yield f"the training drives state different mountings ({KEY}), so exports do not rotate raw IMU samples"
    if t.start_cost is not None:
        yield f"the filter from which the search started has cost {notebook.number(t.start_cost)} on the same drives"
    if t.validation is None:
        yield NOT_VALIDATED
    elif not np.isfinite(t.validation.cost):
        yield to_do(MORE_DRIVES, "the tuned filter failed on at least one validation drive")
    elif t.validation.gap > LARGE_GAP:
        gap = f"{t.validation.gap:.0%} larger than on the training drives"
        yield to_do(MORE_DRIVES, f"errors on the validation drives are {gap}")


def _plain(factor: float) -> str:
    """Format a factor with three digits; large factors are integers with separators instead of powers of ten."""
    return f"{factor:.3g}" if factor < 999.5 else f"{factor:,.0f}"
