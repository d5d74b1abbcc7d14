"""The configuration of a study: one TOML file, saved with its results."""

import tomllib
from pathlib import Path
from typing import Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sigmaswarm.errors import InputError, first_mistake
from sigmaswarm.filters.parameters import FilterKind, ModelName
from sigmaswarm.simulation.conditions import PAPER_MANEUVERS
from sigmaswarm.simulation.environments import ENVIRONMENTS
from sigmaswarm.tuning.space import Scale

ALL = "all"
"""The pool of all conditions, and the maneuver or environment of a drive that names none."""
UNTUNED = "untuned"
"""The protocol of methods that nothing is tuned for."""
MAIN = "pso-ukf"
"""The paper's method, which all others are compared with."""
ProtocolName = Literal["paper", "honest"]


class Protocol(BaseModel):
    """What is minimized under a protocol, and how variances are searched."""

    model_config = ConfigDict(frozen=True)

    objective: str
    scale: Scale


PROTOCOLS: dict[str, Protocol] = {
    "paper": Protocol(objective="gps-rmse", scale="linear"),
    "honest": Protocol(objective="truth-rmse", scale="log10"),
}
"""The paper's is its equation 4."""

BY_PSO: dict[str, tuple[FilterKind, ModelName, tuple[ProtocolName, ...]]] = {
    "pso-ukf": ("ukf", "planar5", ("paper", "honest")),
    "pso-ekf": ("ekf", "planar5", ("honest",)),
    "pso-adaptive-ukf": ("adaptive-ukf", "planar5", ("honest",)),
    "pso-planar8": ("ukf", "planar8", ("honest",)),
}
"""Kind, model and protocols of what is tuned as the paper tunes; the paper tunes the UKF alone."""
BY_DEFAULT = "default"
"""The filter, the objective and the optimizer that `tune` takes by itself for a study's drives."""
TUNED_METHODS: dict[str, tuple[ProtocolName, ...]] = {
    **{method: protocols for method, (_, _, protocols) in BY_PSO.items()},
    BY_DEFAULT: ("honest",),
}
"""Protocols of every tuned method."""


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
    """The first placement included: 30 x 50 are 1500 evaluations."""
    seed: int = Field(default=0, ge=0)
    """Decides drives, splits and swarms."""
    per_condition: bool = False
    """Tune each condition by itself instead of one filter for all of them."""
    racing: bool = False
    """Drop the worse candidates of a generation before all drives are tried; not under the paper's protocol."""

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
