"""`FilterParameters`: all parameters of a filter as one frozen record."""

import math
import re
import warnings
from collections.abc import Collection
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tomli_w
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from sigmaswarm.drives.sensors import UNSTATED_GPS_STD
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.files import write_atomically
from sigmaswarm.filters.kernels import FILTERS, kernel_name
from sigmaswarm.filters.models import MEASURED, MODELS, SENSORS
from sigmaswarm.filters.names import FilterKind, ModelName
from sigmaswarm.filters.robot_yaml import HEADING_NOISE, IMU_NOISE, YAML, read_configuration
from sigmaswarm.record_files import read_content
from sigmaswarm.wording import first_mistake, printable


def _as_tuple(value: Any) -> Any:
    return tuple(value.tolist()) if isinstance(value, np.ndarray) else value


Real = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0)]
Gain = Annotated[float, Field(ge=1, allow_inf_nan=False)]
Variances = Annotated[tuple[Real, ...], BeforeValidator(_as_tuple)]
NIS, OF_STATED = "NIS, dimensionless", "of the stated variance, dimensionless"  # units


class SearchRange(NamedTuple):
    """The option of ``tune --use`` that tunes a parameter, and the bounds and scale (``logarithmic``) of its search."""

    option: str
    lowest: float
    highest: float
    logarithmic: bool


def _option(
    default: Any,
    unit: str = "",
    use: str = "",
    bounds: tuple[float, float] = (math.nan, math.nan),
    *,
    logarithmic: bool = True,
    **properties: Any,
) -> Any:
    """Describe an optional parameter.

    ``use``, ``bounds`` and ``logarithmic`` are those of `SearchRange`. The other properties are ``absent``, which
    represents None in a `ParameterTable` (default 0); ``typical``, the value without tuning if no data sheet states
    one; and ``scaled``, which marks noise variances and factors of variances.
    """
    about = {"unit": unit, "search": SearchRange(use, *bounds, logarithmic) if use else None}
    about |= {"absent": 0.0} if default is None else {}
    return field(default=default, kw_only=True, metadata=about | properties)


def _noise(name: str, bounds: tuple[float, float], typical: float) -> Any:
    """Describe the variance of a measurement in `MEASURED`."""
    return _option(None, MEASURED[name], name, bounds, absent=math.inf, typical=typical, scaled=True)


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class FilterParameters:
    """The parameters of a Kalman filter for a car's IMU and GPS.

    Attributes
    ----------
    alpha, beta, kappa : float
        Merwe's scaling of the sigma points: alpha > 0, kappa > -n (van der Merwe 2004, thesis, section 3.2.2). An
        extended filter ignores them.
    process_noise : tuple of float, length n
        Diagonal of Q: the variance added per nominal IMU step, in squared units of the states.
    measurement_noise : tuple of float, length 2
        Diagonal of R, m2 east and north.
    model : {"planar5", "planar8", "tilted12", "robot-localization"}
        planar5: x, y (m), vx, vy (m/s), theta (rad); the IMU is the input. planar8: also the biases of the
        accelerometer, forward and left (m/s2), and of the gyro (rad/s), as random walks. tilted12: also roll and pitch
        (rad), and the other two biases of the gyro; for an IMU with six axes.
        robot-localization: the EKF of this ROS package in ``two_d_mode``, see `models.robot_localization`.
    nominal_interval : float or None
        IMU interval to which ``process_noise`` refers, s. None: the median interval of each drive. A tuning stores the
        interval of its drives, so that the filter adds the same variance per second with an IMU of another rate.
    kind : {"ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf"}
        Filter types, in this order: unscented; extended; unscented with Q and R adapted to the innovations (Sage and
        Husa 1969); unscented with a fading factor (Zhou and Frank 1996); unscented with Q and R scaled by fuzzy rules
        (`textbook.adaptive.FuzzyNoise`).
    forgetting : float
        Forgetting factor per fix of an adaptive, strong tracking or fuzzy filter, in (0, 1).
    fuzzy_widths : tuple of float, length 2
        Ratio and trend (see `FuzzyNoise`) at which "large" and "rises" reach membership 1.
    fuzzy_gains : tuple of float, length 2
        Largest factors (and divisors) that a fuzzy filter's rules apply to R and Q; at least 1.
    bias_std : tuple of float, length 2
        planar8, tilted12: standard deviation of the biases at the start, m/s2 and rad/s.
    imu_noise : tuple of float, length 2 or 3
        robot-localization: variances in the IMU's messages: gz, (rad/s)2; ax, (m/s2)2; and, if it is fused, ay,
        (m/s2)2.
    imu_gate : tuple of float, length 2
        robot-localization: largest accepted NIS of gz and of ax; inf: no limit.
    velocity_noise : float or None
        Variance of the receiver's velocity per axis, m2/s2, if the log has speed and course. None: the velocity is not
        used.
    lateral_noise : float or None
        Variance of the lateral velocity at the rear axle, m2/s2; this velocity is 0 without tire slip. None: the
        constraint is not used.
    rear_axle : float
        Distance from the rear axle forward to the IMU, m, for ``lateral_noise``.
    tire_slip : float
        Slip angle of the rear tires per lateral acceleration, s2/m (rad per m/s2), for ``lateral_noise``. 0: no slip.
    standstill_noise : float or None
        Variance of the velocity at detected standstills, m2/s2. None: standstills are not used.
    odometer_noise : float or None
        Variance of the wheels' speed, m2/s2, if the log has an odometer. None: the odometer is not used.
    odometer_scale : float
        Ratio of the odometer's reading to the true speed.
    odometer_latency : float
        Delay of an odometer reading relative to its time stamp, s.
    heading_noise : float or None
        Variance added to the stated variance of a fix's heading, rad2, if the log has headings (two antennas, a
        compass). None: the heading is not used.
    gate : float or None
        Largest accepted normalized innovation squared (NIS) of a fix; 9.2 rejects 1% of good fixes (chi-square, two
        degrees of freedom). None: every fix is used.
    latency : float
        Delay of a fix relative to its time stamp, s.
    accuracy_scale : float or None
        Factor s2: R of a fix is ``measurement_noise`` + s2 std^2 per axis, with the standard deviation std that the
        receiver states. None: R is ``measurement_noise``.
    fix_error : float or None
        Ratio g: variance of the correlated fix error, divided by the stated variance of a fix or, if none is stated, by
        ``fix_std`` squared: see `filters.kernels`. None: errors of fixes are independent.
    fix_error_time : float
        Time constant of the correlated fix error, s.
    fix_std : float
        Standard deviation of fixes per axis (m), which ``fix_error`` uses if the receiver states none.
    robust_dof : float or None
        Degrees of freedom of Student's t distribution for the errors of fixes; outliers then have little weight (R.
        Piche, S. Sarkka and J. Hartikainen, MLSP 2012). Begin with 4, and use fewer if there are more outliers. None:
        Gaussian errors.

    Notes ----- Negative numbers in ``process_noise`` and ``measurement_noise`` are accepted. The filter then fails and
    reports the failure, and its cost is ``inf``.
    """

    alpha: Positive
    beta: Real
    kappa: Real
    process_noise: Variances
    measurement_noise: Variances
    model: ModelName = "planar5"
    nominal_interval: Positive | None = _option(None, "s")
    kind: FilterKind = _option("ukf")
    forgetting: Annotated[float, Field(gt=0, lt=1)] = _option(0.98)
    fuzzy_widths: tuple[Positive, Positive] = _option(
        (0.3, 0.3),
        "dimensionless; the inputs of the fuzzy rules, ratio and trend of the NIS, lie between -1 and 1",
    )
    fuzzy_gains: tuple[Gain, Gain] = _option((3.0, 3.0), "largest factors of R and Q")
    bias_std: tuple[Positive, Positive] = _option((0.3, 0.01))
    imu_noise: tuple[Positive, Positive] | tuple[Positive, Positive, Positive] = _option(IMU_NOISE)
    imu_gate: tuple[Limit, Limit] = _option((math.inf, math.inf), NIS, "imu-gate", (4.0, 100.0))
    velocity_noise: Positive | None = _noise("velocity", (1e-4, 10.0), 0.1**2)
    lateral_noise: Positive | None = _noise("lateral", (1e-4, 10.0), 0.2**2)
    rear_axle: Real = _option(0.0, "m", "lateral", (-1.0, 4.0), logarithmic=False)
    tire_slip: Real = _option(0.0, "s2/m", "slip", (0.0, 0.02), logarithmic=False)
    standstill_noise: Positive | None = _noise("standstill", (1e-6, 1.0), 0.05**2)
    odometer_noise: Positive | None = _noise("odometer", (1e-4, 10.0), 0.1**2)
    odometer_scale: Positive = _option(
        1.0, "reading divided by true speed", "odometer", (0.9, 1.1), logarithmic=False
    )
    odometer_latency: Real = _option(0.0, "s", "odometer", (0.0, 0.3), logarithmic=False)
    heading_noise: Positive | None = _noise("heading", (1e-7, 0.1), HEADING_NOISE)
    gate: Positive | None = _option(None, NIS, "gate", (4.0, 100.0), absent=math.inf, typical=9.2)
    latency: Real = _option(0.0, "s", "latency", (0.0, 0.5), logarithmic=False)
    accuracy_scale: Positive | None = _option(
        None, OF_STATED, "accuracy", (1e-3, 10.0), typical=1.0, scaled=True
    )
    robust_dof: Positive | None = _option(None, "dimensionless", "robust", (1.0, 30.0), typical=4.0)
    fix_error: Positive | None = _option(None, OF_STATED, "fix-error", (1e-3, 4.0), scaled=True)
    fix_error_time: Positive = _option(5.0, "s", "fix-error", (0.5, 300.0))
    fix_std: Positive = _option(UNSTATED_GPS_STD, "m")

    def __post_init__(self) -> None:
        n = self.n_states
        if len(self.process_noise) != n:
            raise ValueError(
                f"process_noise needs {n} variances for {self.model}, got {len(self.process_noise)}"
            )
        if len(self.measurement_noise) != 2:
            raise ValueError(f"measurement_noise needs 2 variances, got {len(self.measurement_noise)}")
        if n + self.kappa <= 0:
            raise ValueError(f"kappa must be greater than {-n} for {n} states, got {self.kappa}")
        used = [option for option, name in _ACTIVATES.items() if getattr(self, name) is not None]
        if reason := incompatibility(self.kind, used):
            raise ValueError(reason)
        known = MODELS[self.model].options
        for option in used:
            if known is not None and option not in known:
                raise ValueError(
                    f"{self.model} does not have the option {_ACTIVATES[option]}; omit this option"
                )
        if self.kernel not in FILTERS:
            raise ValueError(
                f"fix_error can't be combined with {self.model} of kind {self.kind}; use ekf, or omit fix_error"
            )
        if known is not None and self.latency:
            raise ValueError(
                f"{self.model} has no parameter latency; if fixes are late, set smooth_lagged_data in ekf.yaml"
            )

    @property
    def n_states(self) -> int:
        """Number n of states of the model."""
        return len(MODELS[self.model].states)

    @property
    def kernel(self) -> str:
        """Name of the kernel: the key in `kernels.FILTERS`."""
        return kernel_name(self.model, self.kind, self.fix_error is not None)

    def scaled(self, factor: float) -> "FilterParameters":
        """Multiply all noise variances by a factor, which hardly changes the estimates.

        The initial standard deviations of the biases are multiplied by the square root of the factor. The other initial
        covariances and the covariance that IMU gaps add do not change. The estimates change if a gate or ``robust_dof``
        is set, since these depend on the covariance.

        Raises
        ------
        InputError
            If the factor is not positive and finite.
        """
        if not 0 < factor < np.inf:
            raise InputError(f"factor = {factor:g} is not positive and finite; pass for example 2.0")
        given = {name: getattr(self, name) for name in _SCALED}
        imu_factor = factor if MODELS[self.model].measures_imu else 1.0
        return replace(
            self,
            process_noise=tuple(factor * q for q in self.process_noise),
            measurement_noise=tuple(factor * r for r in self.measurement_noise),
            bias_std=tuple(factor**0.5 * std for std in self.bias_std),
            imu_noise=tuple(imu_factor * r for r in self.imu_noise),
            **{name: factor * value for name, value in given.items() if value is not None},
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert to plain types for TOML and JSON; omit options with default values."""
        table = {f.name: getattr(self, f.name) for f in fields(self)}
        plain = FilterParameters(**{name: table[name] for name in _ALWAYS_STATED})
        shown = {k: v for k, v in table.items() if k in _ALWAYS_STATED or v != getattr(plain, k)}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in shown.items()}

    def save(self, path: str | Path) -> None:
        """Write a TOML file that `load` reads."""
        text = tomli_w.dumps({"filter": self.to_dict(), "units": units(self)})
        write_atomically(Path(path), text)

    @classmethod
    def load(cls, path: str | Path) -> "FilterParameters":
        """Read the ``[filter]`` table of a parameter file or tuning.toml (or its folder), or robot_localization's YAML.

        Raises
        ------
        InputError
            The message states the file, the key, the error and the remedy.

        Warns
        -----
        SigmaswarmWarning
            If the file is from a version before 0.3, or an ekf.yaml has settings that the model does not support.
        """
        path = Path(path)
        if path.suffix in YAML:
            usual: dict[str, Any] = {"model": "robot-localization", "kind": "ekf", "nominal_interval": 1.0}
            return cls(1.0, 0.0, 0.0, measurement_noise=(1.0, 1.0), **usual, **read_configuration(path))
        return cls.from_content(*read_filter(path))

    @classmethod
    def from_content(cls, content: dict[str, Any], path: Path) -> "FilterParameters":
        """Validate the table ``[filter]`` in the content of the file ``path``."""
        if not isinstance(content.get("filter"), dict):
            raise InputError(f"{path}: has no [filter] table; specify a file written by `sigmaswarm tune`")
        parameters = cls._validated(content["filter"], path)
        _warn_of_age(content, path)
        return parameters

    @classmethod
    def _validated(cls, table: dict[str, Any], path: Path) -> "FilterParameters":
        try:
            parameters = TypeAdapter(cls).validate_python(table)
        except ValidationError as error:
            first = first_mistake(error)
            key = ".".join(part for part in ("filter", first.key) if part)
            value = f" (is {first.value})" if first.value else ""
            known = {
                "unexpected_keyword_argument": "unknown key",
                "tuple_type": "should be a list of variances",
            }
            message = known.get(first.kind, first.message)
            remedy = "delete it" if first.kind == "unexpected_keyword_argument" else "correct it in the file"
            raise InputError(f"{path}: {key}: {message}{value}; {remedy}") from None
        for key in ("process_noise", "measurement_noise"):
            for i, variance in enumerate(getattr(parameters, key)):
                if variance < 0 or (variance == 0 and key == "measurement_noise"):
                    limit = "be positive" if key == "measurement_noise" else "not be negative"
                    raise InputError(
                        f"{path}: the variance filter.{key}[{i}] must {limit} (is {variance:g}); "
                        "correct it in the file"
                    )
        return parameters


def described(key: str) -> dict[str, Any]:
    """Return the property ``key`` (see `_option`) of the parameters that have it, by parameter name."""
    return {f.name: f.metadata[key] for f in fields(FilterParameters) if f.metadata.get(key) is not None}


def filter_file(path: Path) -> Path:
    """Return the tuning.toml of a folder.

    Raises `InputError` for a drive, and for an interrupted tuning that has no tuning.toml yet.
    """
    if not path.is_dir():
        return path
    file = path / "tuning.toml"
    if not file.exists():
        from sigmaswarm.drives.reader import has_table  # slow to import

        if has_table(path, "imu"):
            raise InputError(
                f"{path}: is a drive; pass a tuning, as written by sigmaswarm tune {path} --out tuned"
            )
        if (path / "config.json").exists() and not (path / "runs").exists():  # a comparison has runs
            raise InputError(
                f"{path}: has no finished tuning; add --resume to the command that made this folder, and run it again"
            )
    return file


def read_filter(path: Path) -> tuple[dict[str, Any], Path]:
    """Read a TOML file with a filter, or the tuning.toml of a folder. Return its content and its path."""
    file = filter_file(path)
    remedy, missing = "specify a readable TOML file", "specify a tuning.toml or the folder that contains it"
    return read_content(file, remedy, missing=missing), file


SEARCHED: dict[str, SearchRange] = described("search")
_ACTIVATES = {s.option: n for n, s in SEARCHED.items() if getattr(FilterParameters, n) is None}
"""Options of ``tune --use``, and for each option the field that is None without the option."""
_SCALED = tuple(described("scaled"))
NOISES = ("process_noise", "measurement_noise", "imu_noise", *_SCALED)
"""Fields that are noise variances or factors of variances. Scaling all of them by a factor scales the covariance."""
RULES_SINCE = (0, 3)  # first version with the current rules for stale fixes, gaps and standstills


_ADAPTS = "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf"
_CONFLICTS = (
    ("robust", _ADAPTS, "itself adapts to outliers; use ukf or ekf"),
    ("accuracy", _ADAPTS[:1], "estimates R; use another kind"),
    ("fix-error", _ADAPTS, "adapts to the innovations; use ukf or ekf"),
)
"""Options of ``tune --use``, the filter types with which they conflict, and the reason and remedy."""


def incompatibility(kind: str, use: Collection[str]) -> str | None:
    """Return the reason why a filter type and options conflict; None if they do not."""
    if "robust" in use and "gate" in use:
        return (
            "robust and gate can't be combined: robust reduces the weight of fixes that gate rejects; omit one of "
            "them"
        )
    for option, kinds, why in _CONFLICTS:
        if option in use and kind in kinds:
            return f"{option} can't be combined with {kind}, which {why}, or omit {option}"
    return None


_ALWAYS_STATED = ("alpha", "beta", "kappa", "process_noise", "measurement_noise", "model")


def units(parameters: FilterParameters) -> dict[str, Any]:
    """Return the units of the parameters in `to_dict`, and the names of the states: the table ``units`` of a file."""
    states = MODELS[parameters.model].states
    known: dict[str, Any] = {f.name: f.metadata.get("unit") for f in fields(parameters)}
    known |= {
        "process_noise": [f"{state.variance_unit} per nominal IMU step" for state in states],
        "measurement_noise": ["m2", "m2"],
        "bias_std": [sensor.unit for sensor in SENSORS.values()],
        "imu_noise": ["rad2/s2", "m2/s4", "m2/s4"][: len(parameters.imu_noise)],
        "imu_gate": [NIS] * 2,
    }
    stated = parameters.to_dict()
    return {k: v for k, v in known.items() if v and k in stated} | {"states": [s.name for s in states]}


def known_interval(parameters: FilterParameters) -> float:
    """Return ``nominal_interval``, s. Raises `InputError` if it is None."""
    if parameters.nominal_interval is None:
        raise InputError(
            "the file of the filter does not contain the IMU interval of its process noise; add "
            "nominal_interval (s) to [filter], for example nominal_interval = 0.01"
        )
    return parameters.nominal_interval


def densities(parameters: FilterParameters) -> dict[str, str]:
    """Return the density of white noise in each state, as in data sheets: sqrt(Q / nominal interval).

    The result is empty if the interval of Q is unknown or a variance is negative.
    """
    p = parameters
    if p.nominal_interval is None or min(p.process_noise) < 0:
        return {}
    each = zip(MODELS[p.model].states, p.process_noise, strict=True)
    return {s.name: f"{np.sqrt(q / p.nominal_interval):.4g} {s.unit}/sqrt(s)" for s, q in each}


def _warn_of_age(table: dict[str, Any], path: Path) -> None:
    made = table.get("versions")
    version = str(made.get("sigmaswarm", "")) if isinstance(made, dict) else ""
    numbers = re.match(r"(\d+)\.(\d+)", version)
    if numbers and tuple(map(int, numbers.groups())) < RULES_SINCE:
        warnings.warn(
            f"{path}: was tuned by sigmaswarm {printable(version)}, whose filters used stale fixes, treated gaps in "
            "the IMU as ordinary steps, and detected standstills by another rule, so results differ; tune it again",
            SigmaswarmWarning,
            stacklevel=4,
        )
