"""The search space of a filter."""

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any, get_args

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD
from sigmaswarm.errors import InputError
from sigmaswarm.filters.kernel_array import ParameterTable
from sigmaswarm.filters.kernels import FILTERS, kernel_name
from sigmaswarm.filters.models import MODELS, SENSORS
from sigmaswarm.filters.names import FilterKind, ModelName
from sigmaswarm.filters.parameters import SEARCHED, FilterParameters, incompatibility
from sigmaswarm.filters.presets import HALF_A_WHEELBASE, TYPICAL_VALUES
from sigmaswarm.tuning.bounds import Bounds, Dimension
from sigmaswarm.tuning.config import Option, Scale

OPTIONS: tuple[Option, ...] = get_args(Option)


SCALING = (
    Dimension("alpha", "alpha", 0, 1e-3, 1.0, logarithmic=False),
    Dimension("beta", "beta", 0, 0.0, 3.0, logarithmic=False),
    Dimension("kappa", "kappa", 0, 0.0, 5.0, logarithmic=False),
)
"""Scaling parameters of the sigma points, with the paper's bounds."""
FIX_ERROR_TIME = "fix_error_time"
"""A parameter that is searched only with truth, and only for models with roll and pitch.

Without truth, the likelihood hardly depends on this time constant. With a planar filter, slopes also cause correlated
innovations. After tuning with truth on kingston-1, the position RMSE was 3.1 m with a searched and 2.2 m with a fixed
time constant.
"""
TYPICAL_FIX_ERROR_TIME = 30.0
"""Time constant of fix errors (s) for a filter with roll and pitch, if the time constant is not searched.

Compared with 5 s (the default of `FilterParameters`), 30 s changed the scores of six simulated M8 receivers on held-out
drives: heading error -13%, 30 s drift -15%, NEES 2.0 to 2.9 instead of 2.0 to 4.7, position RMSE +2%. On the second
part of four real logs innovation-t is 0.2 to 0.5 nats lower. Planar filters keep 5 s: on kingston-1 the position RMSE
is 2.5 m with 5 s and 3.0 m with 15 s.
"""
TYPICAL_SLIP = 0.005
"""Tire slip of passenger cars, s2/m, used if the objective does not use truth.

The slip is 0.004 to 0.012 on real drives (course relative to the gyro's heading) and 0.006 on simulated drives. The
likelihood is largest at 0.010 to 0.018. Since a car takes most turns at similar speeds v, the likelihood determines
only rear_axle - slip v^2.
"""
MIN_SEARCHED_WHITE_SHARE = 0.04
"""Lower bound of R, relative to the receiver's variance, for fix-error with a fixed time constant.

With a smaller R, Student's t treats correlated errors as outliers.
"""
ADDED_VARIANCE_BOUNDS = (1e-4, 1e3)
"""Bounds (m2) of the variance added to the stated variance of each fix."""
INFLATION_MINIMA = {
    "tilt": 2e-7,
    "gyro_bias_xy": 1e-10,
    "accel_bias_std": 0.005,
    "gyro_bias_std": 2e-4,
}
"""Lower limits for models with roll and pitch, in rad2/s, (rad/s)2/s, m/s2 and rad/s (see `tuning.inflation`)."""
TYPICAL_NOISES = {
    "q_xy": (1e-7, 3.0),
    "q_vxy": (1e-4, 2.0),
    **dict.fromkeys(("q_theta", "q_tilt", "q_accel_bias"), (1e-8, 2.0)),
    **dict.fromkeys(("q_gyro_bias_xy", "q_gyro_bias_z"), (1e-11, 2.0)),
    "accel_bias_std": (0.05, 1.0),
    "gyro_bias_std": (5e-4, 1.0),
    **{name: (TYPICAL_VALUES[name], 2.0) for name in ("lateral_noise", "standstill_noise")},
    "robust_dof": (TYPICAL_VALUES["robust_dof"], 0.5),
    "rear_axle": (HALF_A_WHEELBASE, 1.0),
}
"""Prior of a filter with roll and pitch: typical values, and standard deviations in decades (rear_axle: m).

The variances of the process noise are per second, for an automotive MEMS IMU: noise densities of 0.01 m/s2/sqrt(Hz) and
1e-4 rad/s/sqrt(Hz), and random walks of the biases of 1e-4 m/s2/sqrt(s) and 3e-6 rad/s/sqrt(s).
"""
TYPICAL_WEIGHT, TYPICAL_DURATION = 1 / 250, 150.0
"""Weight of this prior (nats per fix), and longest total driving time (s) with this weight.

Above this time, the weight is inversely proportional to the time. In a cost that is the mean over n independent fixes,
a prior has the weight 1 / n. For 150 s, n is set to 250.
"""
DEFAULT_INTERVAL = 0.01  # IMU interval, s, if no drive is known yet
IMU_DIMENSIONS = (
    Dimension("r_gyro", "imu_noise", 1, 1e-9, 1.0),
    Dimension("r_accel", "imu_noise", 1, 1e-6, 1e2),
)
"""Variances of gz and ax in the IMU's messages, for robot-localization."""
ENTRIES = {"imu_gate": ("gate_gyro", "gate_accel")}
"""Names of the dimensions of a field that is a tuple."""
NOISE_ONLY_OPTIONS = ("lateral", "odometer")
"""Options with several parameters, of which robot-localization has only the noise variance."""
KIND_DIMENSIONS: dict[FilterKind, tuple[Dimension, ...]] = {
    **dict.fromkeys(
        ("adaptive-ukf", "strong-tracking-ukf"),
        (Dimension("forgetting", "forgetting", 0, 0.9, 0.9999, logarithmic=False),),
    ),
    "fuzzy-ukf": (
        Dimension("forgetting", "forgetting", 0, 0.5, 0.999, logarithmic=False),
        Dimension("fuzzy_width_ratio", "fuzzy_widths", 1, 0.1, 1.0),
        Dimension("fuzzy_width_trend", "fuzzy_widths", 1, 0.1, 1.0),
        Dimension("fuzzy_gain_r", "fuzzy_gains", 1, 1.0, 100.0),
        Dimension("fuzzy_gain_q", "fuzzy_gains", 1, 1.0, 100.0),
    ),
}


@dataclass(frozen=True, eq=False)
class SearchSpace(Bounds):
    """Bounds of the parameters of a built-in model. ``fixed`` contains values of fields that are not searched."""

    fixed: dict[str, Any]

    def decode(self, points: Array) -> ParameterTable:
        """Convert points, shape (n, d), to parameter sets."""
        values = self.values(points)
        columns = {name: values[:, indices] for name, indices in self._indices.items()}
        return ParameterTable(self._any, columns, len(points))

    def point_of(self, parameters: FilterParameters) -> Array:
        """Convert a parameter set to a point, shape (d,), clipped to the bounds.

        A parameter that is None is replaced by the middle of its bounds.
        """
        own, here = parameters.nominal_interval, self.fixed["nominal_interval"]
        if own and here:
            noise = tuple(here / own * variance for variance in parameters.process_noise)
            parameters = replace(parameters, process_noise=noise)
        values = np.array([*self.values_of(parameters).values()], dtype=np.float64)  # None becomes NaN
        point = self._encode(np.clip(values, self.lowest, self.highest))
        return np.where(np.isfinite(values), np.clip(point, self.low, self.high), (self.low + self.high) / 2)

    def values_of(self, parameters: FilterParameters) -> dict[str, float]:
        values = dict[str, float]()
        for i, dimension in enumerate(self.dimensions):
            value, indices = getattr(parameters, dimension.field), self._indices[dimension.field]
            values[dimension.name] = value[indices.index(i)] if isinstance(indices, list) else value
        return values

    @cached_property
    def _indices(self) -> dict[str, int | list[int]]:
        indices: dict[str, int | list[int]] = {}
        for i, dimension in enumerate(self.dimensions):
            before = indices.get(dimension.field, [])
            assert isinstance(before, list)
            indices[dimension.field] = [*before, *[i] * dimension.entries] if dimension.entries else i
        return indices

    @cached_property
    def _any(self) -> FilterParameters:
        values = {name: self.lowest[indices].tolist() for name, indices in self._indices.items()}
        return FilterParameters(**self.fixed, **values)


def search_space(
    model: ModelName,
    scale: Scale,
    nominal_interval: float | None = None,
    *,
    kind: FilterKind = "ukf",
    use: Sequence[Option] = (),
    fix_std: float = UNSTATED_GPS_STD,
    has_truth: bool = False,
) -> SearchSpace:
    """Create the search space of a filter. ``scale`` applies to parameters whose range spans powers of ten.

    Bounds per second are converted to ``nominal_interval`` (s), by default 10 ms. ``fix_std`` is the receiver's
    standard deviation, m per axis, for fix-error. ``has_truth`` is True if the objective uses truth; it affects
    fix-error and slip.
    """
    if scale not in ("log10", "linear"):
        raise InputError(f"scale must be log10 or linear, not {scale!r}")
    unknown = [option for option in use if option not in OPTIONS]
    if unknown:
        raise InputError(f"a filter can't use {unknown[0]!r}; choose from {', '.join(OPTIONS)}")
    if "slip" in use and "lateral" not in use:
        raise InputError("the option slip (tire slip of the rear axle) needs the option lateral; add lateral")
    if reason := incompatibility(kind, use):
        raise InputError(reason)
    filter_types, options = (
        MODELS[model].filter_types,
        MODELS[model].options or [o for o in OPTIONS if o != "imu-gate"],
    )
    lacking = [option for option in use if option not in options]
    if lacking:
        raise InputError(f"{model} can't use {lacking[0]!r}; choose from {', '.join(options)}")
    if kind not in filter_types:
        raise InputError(f"{model} is not available as {kind}; use {' or '.join(filter_types)}")
    if kernel_name(model, kind, "fix-error" in use) not in FILTERS:
        raise InputError(f"fix-error can't be combined with {model} as {kind}; use ekf, or omit fix-error")
    fixed: dict[str, Any] = {"model": model, "kind": kind, "nominal_interval": nominal_interval}
    if "fix-error" in use:
        fixed["fix_std"] = fix_std
    if kind == "ekf":  # no sigma points
        fixed |= {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}
    searched: list[Option] = [option for option in use if option != "slip" or has_truth]
    if len(searched) < len(use):
        fixed["tire_slip"] = TYPICAL_SLIP
    interval = nominal_interval or DEFAULT_INTERVAL
    dimensions = tuple(_dimensions(model, kind, searched, interval))
    if MODELS[model].tilts:
        dimensions = tuple(_with_prior(dimensions, interval))
    if "fix-error" in use and not (has_truth and MODELS[model].tilts):
        if MODELS[model].tilts:
            fixed[FIX_ERROR_TIME] = TYPICAL_FIX_ERROR_TIME
        dimensions = tuple(_with_fixed_time(dimensions, fix_std, "accuracy" in use))
    return SearchSpace(dimensions, scale, fixed)


def _with_prior(dimensions: Sequence[Dimension], interval: float) -> Iterator[Dimension]:
    for dimension in dimensions:
        if typical := TYPICAL_NOISES.get(dimension.name):
            scale = interval if dimension.field == "process_noise" else 1.0
            dimension = replace(dimension, typical=(scale * typical[0], typical[1]))
        yield dimension


def _with_fixed_time(dimensions: Sequence[Dimension], fix_std: float, weighs: bool) -> Iterator[Dimension]:
    """Omit `FIX_ERROR_TIME`, and set a lower bound for R.

    ``weighs`` is True if R depends on the stated variance of a fix.
    """
    field, least = (
        ("accuracy_scale", MIN_SEARCHED_WHITE_SHARE)
        if weighs
        else ("measurement_noise", MIN_SEARCHED_WHITE_SHARE * fix_std**2)
    )
    for one in dimensions:
        if one.field != FIX_ERROR_TIME:
            yield replace(one, lowest=max(one.lowest, least)) if one.field == field else one


def _dimensions(
    model: ModelName, kind: FilterKind, use: Sequence[Option], interval: float
) -> Iterator[Dimension]:
    """Yield the dimensions in order. East and north have the same noise, except in planar5 without ``lateral``.

    With separate noises, a filter tuned on roads to the east had 1000 times as much velocity noise to the north as to
    the east. On a road to the north, the lateral constraint therefore corrected mostly the velocity along the road:
    docs/results/planar5.md, "One noise for both map axes".
    """
    if kind != "ekf":
        yield from SCALING
    described = MODELS[model]
    isotropic = described.isotropic or "lateral" in use
    for name, states in groupby(described.states, lambda state: state.shared if isotropic else state.name):
        alike = list(states)
        lowest, highest = alike[0].variance
        scale = interval if alike[0].per_second else 1.0
        bounds, inflation, least = (scale * lowest, scale * highest), 1.0, -math.inf
        if described.tilts:  # `tuning.inflation` states the measurements behind these numbers
            least = scale * INFLATION_MINIMA.get(name, 0.0)
            inflation = 1.0 if alike[0].bias_of else 0.0 if alike[0].unit == "rad" else 0.5
        elif alike[0].bias_of == "gyro" or (described.measures_imu and alike[0].unit.startswith("rad")):
            inflation = 0.0
        yield Dimension(f"q_{name}", "process_noise", len(alike), *bounds, inflation=inflation, least=least)
    fixes = ADDED_VARIANCE_BOUNDS if "accuracy" in use else described.fix_variance
    for name, entries in (("xy", 2),) if isotropic else (("x", 1), ("y", 1)):
        yield Dimension(f"r_{name}", "measurement_noise", entries, *fixes)
    if described.measures_imu:
        yield from IMU_DIMENSIONS
    for sensor in described.sensors:
        name, bounds = f"{sensor}_bias_std", SENSORS[sensor].start_std
        least = INFLATION_MINIMA[name] if described.tilts else -math.inf
        yield Dimension(name, "bias_std", 1, *bounds, least=least)
    yield from KIND_DIMENSIONS.get(kind, ())
    for option in (option for option in OPTIONS if option in use):
        wanted = [name for name, search in SEARCHED.items() if search.option == option]
        for field in wanted[:1] if described.measures_imu and option in NOISE_ONLY_OPTIONS else wanted:
            _, *bounds, logarithmic = SEARCHED[field]
            for name in ENTRIES.get(field, (field,)):
                yield Dimension(name, field, int(field in ENTRIES), *bounds, logarithmic=logarithmic)


def searched_name(name: str, known: Container[str], model: str) -> str:
    """Return the name of the searched parameter that sets a parameter, such as q_xy for q_x and q_tilt for q_roll."""
    states = MODELS[model].states if model in MODELS else ()
    shared = {f"q_{state.name}": f"q_{state.shared}" for state in states}
    return name if name in known else (shared | {"r_x": "r_xy", "r_y": "r_xy"}).get(name, name)
