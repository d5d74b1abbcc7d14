"""The box that is searched, and the way from a point in it to filter parameters."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import STATE_NAMES, FilterKind, FilterParameters, ModelName
from sigmaswarm.tuning.box import Box

Scale = Literal["log10", "linear"]
Option = Literal["velocity", "lateral", "standstill", "gate", "latency"]
OPTIONS: tuple[Option, ...] = ("velocity", "lateral", "standstill", "gate", "latency")
"""What a filter can use beside position fixes; each is a switch, and its parameters are then tuned with the rest."""


@dataclass(frozen=True)
class Dimension:
    """One parameter that is searched: where it goes in FilterParameters, and its range.

    ``index`` is its place in a tuple, -1 where the field is a plain number. ``spread``: it spans powers of ten.
    """

    name: str
    field: str
    index: int
    lowest: float
    highest: float
    spread: bool = True


SCALING = (
    Dimension("alpha", "alpha", -1, 1e-3, 1.0, spread=False),
    Dimension("beta", "beta", -1, 0.0, 3.0, spread=False),
    Dimension("kappa", "kappa", -1, 0.0, 5.0, spread=False),
)
"""The paper's box for the scaling of the sigma points."""
VARIANCE = (1e-5, 10.0)
"""The paper's box for all variances, Q per nominal IMU step."""
SMALL_VARIANCE = (1e-12, 10.0)
"""planar8's for position, velocity, heading: the paper's lowest heading variance, 1e-3 rad2/s, would drown the gyro."""
BIAS_WALK = (1e-16, 1e-4)
"""planar8's for the random walks of the biases."""
BIAS_STD = ((1e-3, 1.0), (1e-5, 0.1))
"""planar8's for the biases at the start, m/s2 and rad/s."""
OPTION_DIMENSIONS: dict[Option, tuple[Dimension, ...]] = {
    "velocity": (Dimension("velocity_noise", "velocity_noise", -1, 1e-4, 10.0),),
    "lateral": (
        Dimension("lateral_noise", "lateral_noise", -1, 1e-4, 10.0),
        Dimension("rear_axle", "rear_axle", -1, -1.0, 4.0, spread=False),
    ),
    "standstill": (Dimension("standstill_noise", "standstill_noise", -1, 1e-6, 1.0),),
    "gate": (Dimension("gate", "gate", -1, 4.0, 100.0),),
    "latency": (Dimension("latency", "latency", -1, 0.0, 0.5, spread=False),),
}
NOISES = ("process_noise", "measurement_noise", "velocity_noise", "lateral_noise", "standstill_noise")
ADAPTIVE = Dimension("forgetting", "forgetting", -1, 0.9, 0.9999, spread=False)


@dataclass(frozen=True, eq=False)
class SearchSpace(Box):
    """A box of filter parameters for cars.

    Attributes
    ----------
    dimensions : tuple of Dimension, length d
    fixed : dict
        Fields of `FilterParameters` that are not searched.
    """

    dimensions: tuple[Dimension, ...]
    fixed: dict[str, Any]

    @property
    def noises(self) -> NDArray[np.bool_]:
        """Which dimensions are variances of noise, shape (d,)."""
        return np.array([d.field in NOISES for d in self.dimensions])

    def decode(self, points: Array) -> list[FilterParameters]:
        """Parameters of points in the box, shape (n, d), in search coordinates."""
        return [FilterParameters(**self.fixed, **self._fields(row)) for row in self.values(points).tolist()]

    def _fields(self, values: list[float]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for dimension, value in zip(self.dimensions, values, strict=True):
            if dimension.index < 0:
                found[dimension.field] = value
            else:
                found[dimension.field] = (*found.get(dimension.field, ()), value)
        return found


def search_space(
    model: ModelName,
    scale: Scale,
    nominal_interval: float | None = None,
    *,
    kind: FilterKind = "ukf",
    use: Sequence[Option] = (),
) -> SearchSpace:
    """The box for a filter: the paper's for planar5, its own for planar8; ``scale`` says how variances are searched.

    Raises
    ------
    InputError
        If the scale or an option is unknown.
    """
    if scale not in ("log10", "linear"):
        raise InputError(f"scale must be log10 or linear, not {scale!r}")
    unknown = [option for option in use if option not in OPTIONS]
    if unknown:
        raise InputError(f"a filter can't use {unknown[0]!r}; choose from {', '.join(OPTIONS)}")
    dimensions = tuple(_dimensions(model, kind, use))
    logarithmic = np.array([d.spread and scale == "log10" for d in dimensions])
    fixed: dict[str, Any] = {"model": model, "kind": kind, "nominal_interval": nominal_interval}
    if kind == "ekf":  # it has no sigma points
        fixed |= {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}
    return SearchSpace(
        names=tuple(d.name for d in dimensions),
        lowest=np.array([d.lowest for d in dimensions]),
        highest=np.array([d.highest for d in dimensions]),
        logarithmic=logarithmic,
        dimensions=dimensions,
        fixed=fixed,
    )


def _dimensions(model: ModelName, kind: FilterKind, use: Sequence[Option]) -> Iterator[Dimension]:
    if kind != "ekf":
        yield from SCALING
    for i, state in enumerate(STATE_NAMES[model]):
        bounds = VARIANCE if model == "planar5" else SMALL_VARIANCE if i < 5 else BIAS_WALK
        yield Dimension(f"q_{state}", "process_noise", i, *bounds)
    yield Dimension("r_x", "measurement_noise", 0, *VARIANCE)
    yield Dimension("r_y", "measurement_noise", 1, *VARIANCE)
    if model == "planar8":
        yield Dimension("accel_bias_std", "bias_std", 0, *BIAS_STD[0])
        yield Dimension("gyro_bias_std", "bias_std", 1, *BIAS_STD[1])
    if kind in ("adaptive-ukf", "strong-tracking-ukf"):
        yield ADAPTIVE
    for option in OPTIONS:
        if option in use:
            yield from OPTION_DIMENSIONS[option]
