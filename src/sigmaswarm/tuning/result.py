"""`Tuning`: what a tuning found, and how it is kept."""

import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic

import numba
import numpy as np
import tomli_w
from typing_extensions import TypeVar

import sigmaswarm
from sigmaswarm.filters.parameters import FilterParameters, units
from sigmaswarm.tuning.config import ModelTuneConfig, SearchConfig
from sigmaswarm.tuning.custom import MODEL_OBJECTIVES
from sigmaswarm.tuning.objectives import OBJECTIVES
from sigmaswarm.tuning.search import Trial
from sigmaswarm.tuning.store import write_whole

P = TypeVar("P", default=FilterParameters)


@dataclass(frozen=True, eq=False)
class Tuning(Generic[P]):
    """What `tune` found.

    Attributes
    ----------
    parameters : FilterParameters, or dict of str to float for a model of your own
        Of the best trial.
    cost : float
        Its objective on the training drives.
    touched_bounds : list of str
        Which parameters ended on a bound of the box: the optimum may lie outside it.
    trials : tuple of Trial
    best_trial : int
    config : TuneConfig, or ModelTuneConfig for a model of your own
    data : list of dict
        Name, length and fingerprint of each drive.
    """

    parameters: P
    cost: float
    touched_bounds: list[str]
    trials: tuple[Trial, ...]
    best_trial: int
    config: SearchConfig
    data: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])

    def to_dict(self) -> dict[str, Any]:
        """Plain types, as tuning.toml holds them."""
        return {
            **self._filter(),
            "result": {
                "cost": self.cost,
                "objective": self.config.objective,
                "objective_meaning": self._meaning(),
                "touched_bounds": self.touched_bounds,
                "best_trial": self.best_trial,
                "trial_costs": [trial.cost for trial in self.trials],
                "evaluations": sum(trial.evaluations for trial in self.trials),
                "failures": sum(trial.failures for trial in self.trials),
            },
            "config": self.config.model_dump(mode="json", exclude_none=True),
            "versions": versions(),
            "data": self.data,
        }

    def _filter(self) -> dict[str, Any]:
        if isinstance(self.parameters, FilterParameters):
            return {"filter": self.parameters.to_dict(), "units": units(self.parameters)}
        model = self.config.model if isinstance(self.config, ModelTuneConfig) else {}
        stated = {t["name"]: t["unit"] for t in model["parameters"] if t["unit"]}
        return {"filter": self.parameters, "units": stated | {"states": model["states"]}}

    def _meaning(self) -> str:
        name = self.config.objective
        return (
            MODEL_OBJECTIVES[name] if isinstance(self.config, ModelTuneConfig) else OBJECTIVES[name].summary
        )

    def save(self, path: str | Path) -> None:
        """Write a tuning.toml, which `FilterParameters.load` reads."""
        write_whole(Path(path), tomli_w.dumps(self.to_dict()).encode())


def versions() -> dict[str, str]:
    """What the result depends on, beside the data."""
    return {
        "sigmaswarm": sigmaswarm.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }
