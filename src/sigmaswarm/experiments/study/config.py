"""Configuration of a study, saved as study.toml."""

from dataclasses import dataclass
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

from sigmaswarm.errors import InputError
from sigmaswarm.filters.names import FilterKind, ModelName, NetworkName
from sigmaswarm.tuning.config import Scale
from sigmaswarm.wording import first_mistake

ALL = "all"  # group of all conditions; also the name of an unknown maneuver or environment
NO_PROTOCOL = "untuned"  # protocol of methods without tuning
ProtocolName = Literal["paper", "honest"]


class Protocol(BaseModel):
    """Objective and scale of a study's tuning runs."""

    model_config = ConfigDict(frozen=True)

    objective: str
    scale: Scale


# The objective of ``paper`` is the paper's equation 4.
PROTOCOLS: dict[str, Protocol] = {
    "paper": Protocol(objective="gps-rmse", scale="linear"),
    "honest": Protocol(objective="truth-rmse", scale="log10"),
}
PROTOCOL_LABELS = {"paper": "tuned with the fixes", "honest": "tuned with truth"}


@dataclass(frozen=True)
class Method:
    """A method of a study, one row of the tables.

    - ``protocols``: protocols under which the method is tuned or trained.
    - ``filter``: filter type and model, if fixed.
    - ``paper``: key of the corresponding result of the paper.
    - ``rival``: True for a method that only studies with rivals have.
    """

    label: str
    protocols: tuple[ProtocolName, ...] = ()
    filter: tuple[FilterKind, ModelName] | None = None
    paper: str | None = None
    rival: bool = False


MAIN_METHOD = "pso-ukf"  # the paper's method, with which all others are compared
DEFAULT_METHOD = "default"  # filter, objective and optimizer that `tune` chooses by default
BAYESIAN_METHOD = "bo-ukf"
NETWORK_FILTER = "pso-planar8"
"""Method whose filter the networks assist. `noise-gru` does not support tilted12, and planar5 has no bias states."""
HONEST: tuple[ProtocolName, ...] = ("honest",)
# In the order of the tables; the paper tunes only the UKF.
METHODS: dict[str, Method] = {
    "imu-only": Method("IMU only", paper="imu-only"),
    "raw-gps": Method("raw GPS"),
    "fixes-alone": Method("fixes alone, constant velocity"),
    "ekf-defaults": Method("EKF, manual: defaults", paper="ekf"),
    "ekf-datasheet": Method("EKF, manual: data sheet", paper="ekf"),
    "adaptive-ukf-defaults": Method("adaptive UKF, manual: defaults", paper="adaptive-ukf"),
    "adaptive-ukf-datasheet": Method("adaptive UKF, manual: data sheet", paper="adaptive-ukf"),
    "ukf-defaults": Method("UKF, manual: defaults", paper="ukf"),
    "ukf-datasheet": Method("UKF, manual: data sheet", paper="ukf"),
    "ukf-paper": Method("UKF, the paper's optimum"),
    MAIN_METHOD: Method("PSO-UKF", ("paper", "honest"), ("ukf", "planar5"), MAIN_METHOD),
    "pso-ekf": Method("PSO-EKF", HONEST, ("ekf", "planar5")),
    "pso-adaptive-ukf": Method("PSO-adaptive UKF", HONEST, ("adaptive-ukf", "planar5")),
    NETWORK_FILTER: Method("PSO-UKF, planar8", HONEST, ("ukf", "planar8")),
    DEFAULT_METHOD: Method("default filter of tune", HONEST),
    "pso-fuzzy-ukf": Method("PSO-fuzzy UKF", HONEST, ("fuzzy-ukf", "planar5"), rival=True),
    BAYESIAN_METHOD: Method("UKF by Bayesian optimization", HONEST, ("ukf", "planar5"), rival=True),
    "outage-lstm": Method("planar8 with outage-lstm", HONEST, rival=True),
    "noise-gru": Method("planar8 with noise-gru", HONEST, rival=True),
}
NETWORKS: tuple[NetworkName, ...] = get_args(NetworkName)
BO_EVALUATIONS = 100  # with more, the optimizer takes longer than the filters (docs/optimizers.md)
LONG_OUTAGES = {f"outage_drift_{length:g}_s_m": length for length in (15.0, 30.0, 60.0)}
MEASURES = {
    "position_rmse_m": "position RMSE against truth, m",
    "gps_rmse_m": "RMSE of the updated estimates against the GPS (equation 4), m",
    "heading_rmse_deg": "heading error, deg",
    "outage_drift_m": "drift over a 5 s outage, m",
    "nis": "mean NIS, 2 if the filter is consistent",
}
QUICK_STUDY = {"runs": 2, "trials": 3}  # options of `sigmaswarm demo`: 50 drives
RIVAL_OPTIONS = ("rivals", "learn_minutes", "elsewhere")


PAPER_RESULTS: dict[str, Any] = {
    "table_1": {
        "imu-only": {"rmse_m": 21606.59},
        "ukf": {"rmse_m": 2.80},
        "pso-ukf": {"rmse_m": 0.50, "improvement_percent": 82.14},
        "optimum": {"q": 2.00, "r": 0.10, "alpha": 0.03, "beta": 2.5, "kappa": 0.48},
    },
    "table_2": {
        "ekf": {"rmse_m": 7.45, "sd_m": 0.65, "interval_m": [7.22, 7.68]},
        "adaptive-ukf": {"rmse_m": 3.92, "sd_m": 0.38, "interval_m": [3.78, 4.06]},
        "ukf": {"rmse_m": 2.80, "sd_m": 0.41, "interval_m": [2.62, 2.98]},
        "pso-ukf": {"rmse_m": 0.50, "sd_m": 0.09, "interval_m": [0.46, 0.54]},
    },
    "table_3": {
        "ekf": {"heading_deg": 4.8, "outage_drift_m": 18.6, "update_ms": 0.65},
        "adaptive-ukf": {"heading_deg": 2.7, "outage_drift_m": 9.3, "update_ms": 1.15},
        "ukf": {"heading_deg": 2.1, "outage_drift_m": 7.5, "update_ms": 1.20},
        "pso-ukf": {"heading_deg": 0.6, "outage_drift_m": 2.0, "update_ms": 1.35},
    },
    "figure_2": {"stable_generation": 15, "stable_at_m": 1.5},
    "real_time_limit_ms": 10.0,
}
"""The paper's results:

Malabo and Gerardo, "Adaptive Tuning of the Unscented Kalman Filter Using Particle Swarm Optimization for Inertial-GPS
Sensor Fusion Systems", Tables I to III and Figure 2.
"""


def _of_paper(name: str) -> tuple[str, ...]:
    from sigmaswarm import simulation  # slow, and not needed for the command line's help

    return tuple(getattr(simulation, name))


class StudyConfig(BaseModel):
    """Configuration of a study. The defaults are the values that the paper states, if any."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    maneuvers: tuple[str, ...] = Field(default_factory=lambda: _of_paper("PAPER_MANEUVERS"), min_length=1)
    environments: tuple[str, ...] = Field(default_factory=lambda: _of_paper("ENVIRONMENTS"), min_length=1)
    runs: int = Field(default=20, ge=1)
    """Number of simulated drives of each maneuver in each environment."""
    imu: str = "icm-20602"
    gps: str = "white-1m"
    """Grade of the GPS receiver.

    The paper does not state the noise of its sensors; CARLA's GNSS sensor has white noise.
    """
    vibration: float = Field(default=0.0, ge=0)
    """Vibration of the IMU, relative to real cars. A network can infer the speed from vibration."""
    terrain: str = "flat"
    drives: tuple[str, ...] = ()
    """Folders or URLs of your own drives with truth, instead of simulated drives."""
    train_fraction: float = Field(default=0.7, gt=0, lt=1)
    """Fraction of the drives of each condition used for training. Each trial draws these drives again."""
    trials: int = Field(default=20, ge=2)
    """Number of repetitions, each with a different split of the drives and a different seed."""
    particles: int = Field(default=30, ge=2)
    """Size of the swarm."""
    generations: int = Field(default=50, ge=1)
    """Number of generations of the swarm, including the initial generation."""
    seed: int = Field(default=0, ge=0)
    """Seed of the simulated drives, the splits and the searches."""
    per_condition: bool = False
    """Tune one filter for each condition instead of one filter for all."""
    racing: bool | None = None
    """Reject worse candidates after a few drives, to save time. --no-racing uses all drives, as in the paper."""
    rivals: bool = False
    """Also compare a fuzzy filter, Bayesian optimization and networks, and test with other sensors and another car."""
    learn_minutes: float = Field(default=20.0, ge=2)
    """With --rivals: minutes of training data for each network, after the filters' start."""
    elsewhere: tuple[str, ...] = ()
    """With --rivals: drives with truth from other sensors or another car; without --drives, simulated by default."""

    @property
    def simulated(self) -> dict[str, Any]:
        return self.model_dump(include={"imu", "gps", "vibration", "terrain", "seed"})

    @property
    def methods(self) -> dict[str, Method]:
        return {name: method for name, method in METHODS.items() if self.rivals or not method.rival}

    @property
    def tuned(self) -> list[tuple[ProtocolName, str]]:
        """Pairs of protocol and method that are tuned."""
        methods = {name: method for name, method in self.methods.items() if name not in NETWORKS}
        return [(protocol, name) for name, method in methods.items() for protocol in method.protocols]

    @property
    def measures(self) -> dict[str, str]:
        longer = {name: f"drift over a {s:g} s outage, m" for name, s in self.long_outages.items()}
        return MEASURES | longer

    @property
    def long_outages(self) -> dict[str, float]:
        """Lengths (s) of the additional outages, by measure."""
        return LONG_OUTAGES if self.rivals else {}

    @field_validator("rivals")
    @classmethod
    def _learn_from_all(cls, rivals: bool, others: ValidationInfo) -> bool:
        if rivals and others.data.get("per_condition"):
            raise ValueError("networks learn from all conditions together; omit per_condition")
        return rivals

    @field_validator("learn_minutes", "elsewhere")
    @classmethod
    def _of_rivals(cls, value: Any, others: ValidationInfo) -> Any:
        if not others.data.get("rivals"):
            raise ValueError("only studies with rivals have this option; set rivals, or omit this option")
        return value

    @model_serializer(mode="wrap")
    def _without_defaults(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit None, which TOML does not have; without rivals, also omit the options of rivals."""
        values: dict[str, Any] = dump(self)
        left_out = () if self.rivals else RIVAL_OPTIONS
        return {name: value for name, value in values.items() if value is not None and name not in left_out}

    def to_toml(self) -> str:
        return tomli_w.dumps(self.model_dump(mode="json"))


def read_config(path: Path | None, **changes: Any) -> StudyConfig:
    """Read study.toml or use the defaults, and apply changes to the options."""
    options: dict[str, Any] = {}
    if path is not None:
        from sigmaswarm.record_files import read_content

        missing = "omit --config for the paper's study"
        options = read_content(path, "specify a readable TOML file", missing=missing)
    try:
        return StudyConfig(**(options | changes))
    except ValidationError as error:
        key, value, kind, message = first_mistake(error)
        if kind == "extra_forbidden":
            message = f"no such option; choose from {', '.join(StudyConfig.model_fields)}"
        where = f"{path}: " if path is not None and key.split(".")[0] not in changes else ""
        raise InputError(f"{where}{key} = {value}: {message}") from None
