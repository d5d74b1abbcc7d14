"""What a study is asked for: one TOML file, saved with its results."""

import tomllib
from pathlib import Path
from typing import Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sigmaswarm.errors import InputError, first_mistake
from sigmaswarm.filters.parameters import FilterKind, ModelName
from sigmaswarm.simulation.conditions import PAPER_MANEUVERS
from sigmaswarm.simulation.environments import ENVIRONMENTS
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.space import Scale

ProtocolName = Literal["paper", "honest"]
PROTOCOLS: dict[ProtocolName, tuple[str, Scale]] = {
    "paper": ("gps-rmse", "linear"),
    "honest": ("truth-rmse", "log10"),
}
"""Objective and scale of each protocol; the paper's is its equation 4."""

TUNED: dict[str, tuple[FilterKind, ModelName, tuple[ProtocolName, ...]]] = {
    "pso-ukf": ("ukf", "planar5", ("paper", "honest")),
    "pso-ekf": ("ekf", "planar5", ("honest",)),
    "pso-adaptive-ukf": ("adaptive-ukf", "planar5", ("honest",)),
    "pso-planar8": ("ukf", "planar8", ("honest",)),
}
"""What is tuned, and in which protocols; the paper tunes the UKF alone."""


class StudyConfig(BaseModel):
    """A study. The defaults are the paper's, where it says them."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    maneuvers: tuple[str, ...] = Field(default=PAPER_MANEUVERS, min_length=1)
    environments: tuple[str, ...] = Field(default=tuple(ENVIRONMENTS), min_length=1)
    runs: int = Field(default=20, ge=1)
    """Simulated drives of each maneuver in each environment."""
    imu: str = "icm-20602"
    gps: str = "white-1m"
    """The paper does not say its sensors' noise; CARLA's GNSS sensor has white noise."""
    drives: tuple[str, ...] = ()
    """Folders of drives to be used instead of simulated ones."""
    train_fraction: float = Field(default=0.7, gt=0, lt=1)
    """Of the drives of each condition, in each trial drawn anew."""
    trials: int = Field(default=20, ge=2)
    particles: int = Field(default=30, ge=2)
    generations: int = Field(default=50, ge=1)
    """The first placement of the swarm included: 30 x 50 are 1500 evaluations."""
    seed: int = Field(default=0, ge=0)
    """Decides drives, splits and swarms."""
    per_condition: bool = False
    """Tune each condition by itself instead of one filter for all of them."""

    def tune_config(self, method: str, protocol: ProtocolName) -> TuneConfig:
        """What one of `TUNED` is asked for under a protocol."""
        kind, model, _ = TUNED[method]
        objective, scale = PROTOCOLS[protocol]
        return TuneConfig(
            optimizer="pso",
            objective=objective,
            scale=scale,
            particles=self.particles,
            generations=self.generations,
            trials=self.trials,
            seed=self.seed,
            model=model,
            kind=kind,
        )

    def to_toml(self) -> str:
        """The file that `read_config` reads."""
        return tomli_w.dumps(self.model_dump(mode="json"))


def read_config(path: Path | None, **changes: Any) -> StudyConfig:
    """A study's file, or the defaults, with some options changed.

    Raises
    ------
    InputError
        Naming the file, the option, and what is wrong with it.
    """
    asked: dict[str, Any] = {}
    if path is not None:
        try:
            asked = tomllib.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(f"{path}: no such file; leave --config out for the paper's study") from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"{path}: not a readable TOML file: {error}") from None
    try:
        return StudyConfig(**(asked | changes))
    except ValidationError as error:
        key, value, kind, message = first_mistake(error)
        if kind == "extra_forbidden":
            message = f"no such option; there are {', '.join(StudyConfig.model_fields)}"
        where = f"{path}: " if path is not None and key.split(".")[0] not in changes else ""
        raise InputError(f"{where}{key} = {value!r}: {message}") from None
