"""FilterParameters: everything that a filter can be tuned by, as one frozen record."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from sigmaswarm.errors import InputError

ModelName = Literal["planar5"]

STATE_NAMES: dict[str, tuple[str, ...]] = {"planar5": ("x", "y", "vx", "vy", "theta")}
"""The states of each model, in order."""

PROCESS_NOISE_UNITS: dict[str, tuple[str, ...]] = {"planar5": ("m2", "m2", "m2/s2", "m2/s2", "rad2")}
"""Units of the diagonal of Q, per nominal IMU step."""


def _as_tuple(value: Any) -> Any:
    return tuple(value.tolist()) if isinstance(value, np.ndarray) else value


Variances = Annotated[tuple[Annotated[float, Field(allow_inf_nan=False)], ...], BeforeValidator(_as_tuple)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class FilterParameters:
    """The parameters of an unscented Kalman filter.

    Attributes
    ----------
    alpha, beta, kappa : float
        Merwe's scaling of the sigma points: alpha > 0, kappa > -n (van der Merwe 2004, thesis, section 3.2.2).
    process_noise : tuple of float, length n
        Diagonal of Q: the variance added per nominal IMU step, in the units of the state squared.
    measurement_noise : tuple of float, length 2
        Diagonal of R, m2 east and north.
    model : {"planar5"}
        planar5: x, y (m), vx, vy (m/s), theta (rad), driven by the IMU.
    nominal_interval : float or None
        s: the IMU interval that ``process_noise`` refers to. None: each drive's own median interval. A tuning
        stores it, so that the same filter on an IMU of another rate adds the same variance per second.

    Notes
    -----
    A negative variance is not refused here: the filter that runs with it fails, says so, and costs ``inf``.
    """

    alpha: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    beta: Annotated[float, Field(allow_inf_nan=False)]
    kappa: Annotated[float, Field(allow_inf_nan=False)]
    process_noise: Variances
    measurement_noise: Variances
    model: ModelName = "planar5"
    nominal_interval: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None, kw_only=True
    )

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

    @property
    def n_states(self) -> int:
        """How many states the model has."""
        return len(STATE_NAMES[self.model])

    def to_dict(self) -> dict[str, Any]:
        """Plain types for TOML and JSON; ``nominal_interval`` is left out where it is None."""
        names = ("model", "alpha", "beta", "kappa", "process_noise", "measurement_noise", "nominal_interval")
        table = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in table.items()}  # pyright: ignore

    def save(self, path: str | Path) -> None:
        """Write a TOML file that `load` reads."""
        text = tomli_w.dumps({"filter": self.to_dict(), "units": units(self.model)})
        Path(path).write_text(text, encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> "FilterParameters":
        """Read the ``[filter]`` table of a parameter file or of a tuning.toml.

        Raises
        ------
        InputError
            Naming the file, the key, what is wrong with it and the remedy.
        """
        path = Path(path)
        if path.is_dir():
            path = path / "tuning.toml"
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(
                f"{path}: no such file; give a tuning.toml or the folder that holds it"
            ) from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"{path}: not a readable TOML file: {_one_line(error)}") from None
        if not isinstance(table.get("filter"), dict):
            raise InputError(f"{path}: has no [filter] table; give a file written by `sigmaswarm tune`")
        return cls._validated(table["filter"], path)

    @classmethod
    def _validated(cls, table: dict[str, Any], path: Path) -> "FilterParameters":
        try:
            parameters = TypeAdapter(cls).validate_python(table)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in ("filter", *first["loc"]))
            value = "" if isinstance(first["input"], dict) else f" (is {first['input']!r})"
            message = first["msg"].removeprefix("Value error, ")
            raise InputError(f"{path}: {key}: {_one_line(message)}{value}; correct it in the file") from None
        for key in ("process_noise", "measurement_noise"):
            for i, variance in enumerate(getattr(parameters, key)):
                if variance < 0 or (variance == 0 and key == "measurement_noise"):
                    raise InputError(
                        f"{path}: filter.{key}[{i}]: a variance must be positive (is {variance:g}); "
                        "correct it in the file"
                    )
        return parameters


def units(model: str) -> dict[str, Any]:
    """The units of a parameter file, for whoever reads it."""
    return {
        "process_noise": [f"{u} per nominal IMU step" for u in PROCESS_NOISE_UNITS[model]],
        "measurement_noise": ["m2", "m2"],
        "nominal_interval": "s",
        "states": list(STATE_NAMES[model]),
    }


def _one_line(error: object) -> str:
    return " ".join(str(error).split())
