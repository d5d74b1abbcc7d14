"""The configuration of a study: one TOML file, saved with its results."""

import tomllib
from pathlib import Path
from typing import Any, Literal, get_args

import tomli_w
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
)

from sigmaswarm.errors import InputError, first_mistake
from sigmaswarm.filters.names import NetworkName
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
BY_BO = "bo-ukf"
"""The rival that is tuned by Bayesian optimization."""
SEARCHED_RIVALS: dict[str, tuple[FilterKind, ModelName, tuple[ProtocolName, ...]]] = {
    "pso-fuzzy-ukf": ("fuzzy-ukf", "planar5", ("honest",)),
    BY_BO: ("ukf", "planar5", ("honest",)),
}
"""As `BY_PSO`: what a study with rivals tunes beside."""
BO_EVALUATIONS = 100
"""At most: with more points its process takes longer than all of the filters (docs/optimizers.md)."""
NETWORKS: tuple[NetworkName, ...] = get_args(NetworkName)
BESIDE = "pso-planar8"
"""Beside it networks are trained: `noise-gru` takes no tilted12, and planar5 has no biases that drift could be of."""
LONG_OUTAGES = {f"outage_drift_{length:g}_s_m": length for length in (15.0, 30.0, 60.0)}
"""What a study with rivals measures beside: names, and s without fixes."""
RIVALS_OPTIONS = ("rivals", "learn_minutes", "elsewhere")


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
    vibration: float = Field(default=0.0, ge=0)
    """Shaking of the IMU by road and engine, which a network may hear the speed in; 1 is that of real cars."""
    terrain: str = "flat"
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
    racing: bool | None = None
    """Drop the worse candidates of a generation before all drives are tried. None: where each tuning has many training
    drives (`tuning.racing.MANY`)."""
    rivals: bool = False
    """Tune a fuzzy filter and by Bayesian optimization, and train networks, too."""
    learn_minutes: float = Field(default=20.0, ge=2)
    """Of driving, from where filters start, that a network learns from: drawn from the trial's training drives."""
    elsewhere: tuple[str, ...] = ()
    """Folders of drives with other sensors or of another car, for what was tuned and trained; by default simulated."""

    @property
    def simulated(self) -> dict[str, Any]:
        """Options of all drives that are simulated."""
        return self.model_dump(include={"imu", "gps", "vibration", "terrain", "seed"})

    @property
    def tuned_methods(self) -> dict[str, tuple[ProtocolName, ...]]:
        """Protocols of what this study tunes."""
        rivals = {method: protocols for method, (_, _, protocols) in SEARCHED_RIVALS.items()}
        return {**TUNED_METHODS, **(rivals if self.rivals else {})}

    @property
    def networks(self) -> tuple[NetworkName, ...]:
        """What this study trains."""
        return NETWORKS if self.rivals else ()

    @property
    def long_outages(self) -> dict[str, float]:
        """Names and lengths, s, of the outages beside the usual one whose drift this study measures."""
        return LONG_OUTAGES if self.rivals else {}

    @field_validator("rivals")
    @classmethod
    def _learn_from_all(cls, rivals: bool, others: ValidationInfo) -> bool:
        if rivals and others.data.get("per_condition"):
            raise ValueError("networks learn from all conditions together; leave per_condition out")
        return rivals

    @field_validator("learn_minutes", "elsewhere")
    @classmethod
    def _of_rivals(cls, value: Any, others: ValidationInfo) -> Any:
        if not others.data.get("rivals"):
            raise ValueError("is for a study with rivals; add rivals")
        return value

    @model_serializer(mode="wrap")
    def _as_asked(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A study without rivals says what it said before there were any, and TOML has no None."""
        told: dict[str, Any] = dump(self)
        left_out = {
            *(() if self.rivals else RIVALS_OPTIONS),
            *(() if self.racing is not None else ("racing",)),
        }
        return {name: value for name, value in told.items() if name not in left_out}

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
