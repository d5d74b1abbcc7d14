"""`Tuning`: what a tuning found, and how it is kept."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic

import numpy as np
import tomli_w
from typing_extensions import TypeVar

from sigmaswarm import notebook
from sigmaswarm.drives.overlap import Landmarks
from sigmaswarm.files import write_whole
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters, densities, units
from sigmaswarm.tuning.box import TouchedBound
from sigmaswarm.tuning.config import ModelTuneConfig, SearchConfig
from sigmaswarm.tuning.custom import MODEL_OBJECTIVES
from sigmaswarm.tuning.objectives import objective_named
from sigmaswarm.tuning.scale import SCALE_FREE
from sigmaswarm.tuning.search import Trial
from sigmaswarm.tuning.sensitivity import NOISE_SCALE, RISE, Sensitivity
from sigmaswarm.versions import versions
from sigmaswarm.wording import counted, in_order, to_do

P = TypeVar("P", default=FilterParameters)
NOT_VALIDATED = (
    "its cost is that of the drives it was tuned on; evaluate it on others, or name some as validation"
)
"""The remark that an evaluation answers."""
MARGIN_TAKEN = (
    "{} times those of the lowest cost: the objective hardly tells the two filters apart, and on roads and IMUs that "
    "the tuning has not seen, the one that doubts more does better. On the same roads it drifts somewhat farther over "
    "outages; --margin 0 leaves it out"
)
OF_THESE_SENSORS = (
    "tuned with truth it belongs to the receiver and the IMU of these drives: on others it may be far worse than their "
    "fixes. For those tune without truth (--objective innovation-t)"
)
MORE_DRIVES = "tune on more drives, or on drives that are more like those of the validation"
LARGE_GAP = 0.2
"""Share by which a validation cost may be worse before a user is told."""


@dataclass(frozen=True)
class Validation:
    """What a tuning is worth on drives that it did not see.

    Attributes
    ----------
    cost : float
        The objective on the validation drives.
    gap : float
        How much larger errors are than on the training drives; 0.1 is 10%.
    drives : tuple of str
    """

    cost: float
    gap: float
    drives: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain types, as tuning.toml holds them."""
        return {
            "validation_cost": self.cost,
            "validation_gap": self.gap,
            "validation_drives": list(self.drives),
        }


@dataclass(frozen=True, eq=False)
class Tuning(Generic[P]):
    """What `tune` found.

    Attributes
    ----------
    parameters : FilterParameters, or dict of str to float for a model of your own
        Of the best trial.
    cost : float
        Its objective on the training drives.
    touched_bounds : list of TouchedBound
        Which parameters ended on a bound of the box: the optimum may lie outside it.
    trials : tuple of Trial
    best_trial : int
    config : TuneConfig, or ModelTuneConfig for a model of your own
    data : list of dict
        Name, length and fingerprint of each drive.
    seen : sequence of Landmarks
        What each drive is recognized by, whole or in parts: for `evaluate`.
    doubts : tuple of str
        What the drives say against the filter, and the objective does not see.
    sensitivities : tuple of Sensitivity
        How far each parameter can move before the cost rises by 1%.
    validation : Validation or None
        What the objective says on drives that were held back from the search.
    steps_per_set : int
        Filter steps that one parameter set takes on all drives.
    raised_by : float
        The factor by which the option ``margin`` has raised what is doubted: see `tuning.margin`; 1 without it.
    """

    parameters: P
    cost: float
    touched_bounds: list[TouchedBound]
    trials: tuple[Trial, ...]
    best_trial: int
    config: SearchConfig
    data: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    seen: Sequence[Landmarks] = ()
    doubts: tuple[str, ...] = ()
    sensitivities: tuple[Sensitivity, ...] = ()
    validation: Validation | None = None
    steps_per_set: int = 0
    raised_by: float = 1.0

    @property
    def steps(self) -> int:
        """Filter steps that the search took."""
        return sum(int(trial.steps[-1]) for trial in self.trials)

    @property
    def full_steps(self) -> int:
        """Filter steps that as many evaluations take on all drives: more than `steps` if they were raced."""
        return self.steps_per_set * sum(trial.evaluations for trial in self.trials)

    @property
    def unidentified(self) -> list[str]:
        """Parameters for which any value in the box does as well, within 1% of the cost."""
        return [s.name for s in self.sensitivities if not s.identified]

    @property
    def remarks(self) -> list[str]:
        """What a user should know before trusting the result, in sentences; first what asks for action (`TO_DO`)."""
        remarks = [
            *self.doubts,
            *([MARGIN_TAKEN.format(self._raised)] if self.raised_by != 1.0 else []),
            *(
                f"{touched}: the optimum may lie outside the box"
                for touched in self.touched_bounds
                if touched.parameter not in self.unidentified
            ),
        ]
        if names := ", ".join(name for name in self.unidentified if name != NOISE_SCALE):
            remarks.append(
                f"the objective can't tell: {names}; each alone may have any value in the box within 1% of the cost"
            )
        if NOISE_SCALE in self.unidentified and self.config.objective not in SCALE_FREE:
            why = "it can't tell how large all noises are together, so don't trust the covariances"
            remarks.append(to_do("add innovation-nll or nis to the objective", why))
        if self._heading_is_loose():
            remedy = (
                "for a car leave --model and --use out, which then suit the logs, or tune with truth-pose"
            )
            why = (
                "fixes alone hold the heading loosely: it may be off by tens of degrees and the position fine"
            )
            remarks.append(to_do(remedy, why))
        better = min(self.sensitivities, key=lambda s: s.lowest_rise, default=None)
        if better is not None and better.lowest_rise < -RISE and self.raised_by == 1.0:
            why = f"moving {better.name} alone makes the cost {-better.lowest_rise:.0%} better"
            remarks.append(to_do("search longer, with more trials, or polish", why))
        if isinstance(self.parameters, FilterParameters) and "truth" in self.config.objective:
            remarks.append(OF_THESE_SENSORS)
        if self.validation is None:
            remarks.append(NOT_VALIDATED)
        elif not np.isfinite(self.validation.cost):
            remarks.append(to_do(MORE_DRIVES, "the tuned filter failed on at least one validation drive"))
        elif self.validation.gap > LARGE_GAP:
            gap = f"{self.validation.gap:.0%} larger than on the training drives"
            remarks.append(to_do(MORE_DRIVES, f"errors on the validation drives are {gap}"))
        return in_order(remarks)

    def _heading_is_loose(self) -> bool:
        p = self.parameters
        held = not isinstance(p, FilterParameters) or p.lateral_noise or p.velocity_noise
        return not held and "truth-pose" not in self.config.objective

    @property
    def _raised(self) -> str:
        """What a margin has raised, and how much."""
        p, factor = self.parameters, f"{self.raised_by:.3g}"
        if not isinstance(p, FilterParameters) or not MODELS[p.model].tilts:
            return f"all process noises are {factor}"
        root = f"{self.raised_by**0.5:.3g}"
        return f"the walks of the biases are {factor}, the noises of position and velocity {root}"

    def to_dict(self) -> dict[str, Any]:
        """Plain types, as tuning.toml holds them."""
        ranges = {
            s.name: [s.lowest if s.lowest is not None else "-", s.highest if s.highest is not None else "-"]
            for s in self.sensitivities
        }
        return {
            **self._filter(),
            "result": {
                "cost": self.cost,
                "objective": self.config.objective,
                "objective_meaning": self._meaning(),
                **({} if self.validation is None else self.validation.to_dict()),
                **({} if self.raised_by == 1.0 else {"margin_raised_by": self.raised_by}),
                "touched_bounds": [str(touched) for touched in self.touched_bounds],
                "unidentified": self.unidentified,
                "remarks": self.remarks,
                "doubts": list(self.doubts),
                "best_trial": self.best_trial,
                "trial_costs": [trial.cost for trial in self.trials],
                "evaluations": sum(trial.evaluations for trial in self.trials),
                "failures": sum(trial.failures for trial in self.trials),
                "filter_steps": self.steps,
                "filter_steps_without_racing": self.full_steps,
            },
            "within_1_percent_of_the_cost": ranges,
            "config": self.config.model_dump(mode="json", exclude_none=True),
            "versions": versions(),
            "data": self.data,
        }

    def _filter(self) -> dict[str, Any]:
        if isinstance(self.parameters, FilterParameters):
            return {
                "filter": self.parameters.to_dict(),
                "units": units(self.parameters),
                "densities": densities(self.parameters),
            }
        model = self.config.model if isinstance(self.config, ModelTuneConfig) else {}
        stated = {t["name"]: t["unit"] for t in model["parameters"] if t["unit"]}
        return {"filter": self.parameters, "units": stated | {"states": model["states"]}}

    def _meaning(self) -> str:
        name = self.config.objective
        if isinstance(self.config, ModelTuneConfig):
            return MODEL_OBJECTIVES[name]
        prior = getattr(self.config, "prior", None)
        guarded = f" + {prior:g} x the prior of R where it is smaller than the receiver's" if prior else ""
        return objective_named(name).summary + guarded

    def _repr_html_(self) -> str:
        """What a notebook shows: each parameter and how far it can move, and what to know before trusting it."""
        rows = [
            (
                s.name,
                s.value,
                *("any" if end is None else notebook.number(end) for end in (s.lowest, s.highest)),
            )
            for s in self.sensitivities
        ]
        on = counted(len(self.data), "drive")
        caption = f"Tuned for {self.config.objective}: cost {notebook.number(self.cost)} on {on}"
        heads = ("parameter", "value", "within 1% of the cost: from", "to")
        return notebook.table(caption, heads, rows) + notebook.listed("Before you trust it:", self.remarks)

    def save(self, path: str | Path) -> None:
        """Write a tuning.toml, which `FilterParameters.load` reads."""
        write_whole(Path(path), tomli_w.dumps(self.to_dict()))
