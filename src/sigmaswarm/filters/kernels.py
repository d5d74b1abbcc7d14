"""The compiled models: names of the kernels, the model of each kernel, and models with correlated fix errors.

The errors are two Gauss-Markov states b: an option of every model with the IMU as input.
Many receivers smooth their fixes, so the errors of successive fixes are correlated. The states b (m, east and north)
are appended to the model's states; the model's process does not depend on b. A fix measures p + b + v, where p is the
position of the antenna, b the correlated error and v white noise. Between two fixes dt apart

    b <- phi b,    P_bb <- phi^2 P_bb + g s^2 (1 - phi^2),    phi = exp(-dt / tau)

where g and tau are the parameters ``fix_error`` and ``fix_error_time``, and s is the stated standard deviation of the
later fix or, if none is stated, ``fix_std``. A filter starts at a fix with an estimate of 0 for b. Therefore the
initial error of the position contains b, and that of the estimate of b is -b: P_bb = g s^2, P_pb = -g s^2, and g s^2 is
added to P_pp. Returned estimates omit b.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.models import MODELS, CarModel, State, Tilts

STATES = tuple(State(name, "m", (0.0, 0.0), name) for name in ("fix_error_x", "fix_error_y"))
SUFFIX = "+fix-error"  # end of the name of a model with the states b


@dataclass(frozen=True)
class AugmentedMeasurement:
    """A measurement of a model with the states b; ``gain`` is 1 if the measurement contains b, otherwise 0."""

    own: Any
    gain: float = 0.0

    def __call__(self, state: Array) -> Array:
        measured = self.own(state[:-2])
        return measured + state[-2:] if self.gain else measured

    def jacobian(self, state: Array) -> Array:
        own = self.own.jacobian(state[:-2])
        return np.hstack([own, self.gain * np.eye(len(own), 2)])


def _appended(
    measure: Callable[[Any, Any], Any], gain: float = 0.0
) -> Callable[[Any, Any], AugmentedMeasurement]:
    return lambda a, b: AugmentedMeasurement(measure(a, b), gain)


def with_fix_error(model: CarModel) -> CarModel:
    """Return a model with the states b appended to the states of the given model."""

    def process(state: Array, dt: float, imu: Array) -> Array:
        return np.concatenate([model.process(state[:-2], dt, imu), state[-2:]])

    def heading(near: float) -> AugmentedMeasurement:
        return AugmentedMeasurement(model.heading(near))

    return replace(
        model,
        states=(*model.states, *STATES),
        process=process,
        position=_appended(model.position, 1.0),
        velocity=AugmentedMeasurement(model.velocity),
        lateral=_appended(model.lateral),
        odometer=_appended(model.odometer),
        heading=heading,
        rates_at_rest=AugmentedMeasurement(model.rates_at_rest),
        tilts=_tilts(model.tilts) if model.tilts else None,
        filter_types=("ekf",) if model.tilts else ("ukf", "ekf"),
        fix_error=True,
    )


def _tilts(own: Tilts) -> Tilts:
    def on_own_states(function: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
        both = np.add if function is own.plus else np.subtract
        return lambda a, b: np.concatenate([function(a[:-2], b[:-2]), both(a[-2:], b[-2:])])

    def nearest(a: Array, b: Array) -> Array:
        return np.concatenate([own.nearest(a[:-2], b[:-2]), a[-2:]])

    def transition(state: Array, dt: float, imu: Array) -> Array:
        f = np.eye(len(state))
        f[:-2, :-2] = own.transition(state[:-2], dt, imu)
        return f

    def as_angles(state: Array, covariance: Array) -> Array:
        return own.as_angles(state[..., :-2], covariance[..., :-2, :-2])

    return Tilts(on_own_states(own.plus), on_own_states(own.minus), nearest, transition, as_angles)


def add_start(mean: Array, covariance: Array, variance: Array) -> None:
    """Add b to initial means (..., n) and covariances (..., n, n), in place; ``variance`` (...) is g s^2, m2."""
    for position, b in ((0, -2), (1, -1)):
        mean[..., b] = 0.0
        covariance[..., b, b] = variance
        covariance[..., position, position] += variance
        covariance[..., position, b] = covariance[..., b, position] = -variance


UNSCENTED = "tilted12, unscented"
"""Kernel of tilted12 with sigma points. A planar model has one kernel for all filter types."""
FILTERS = (
    MODELS
    | {name + SUFFIX: with_fix_error(model) for name, model in MODELS.items() if not model.measures_imu}
    | {UNSCENTED: MODELS["tilted12"]}
)
"""Compiled models, by the name of the kernel."""


def kernel_name(model: str, kind: str, fix_error: bool = False) -> str:
    name = UNSCENTED if model == "tilted12" and kind != "ekf" else model
    return name + SUFFIX if fix_error else name


def base_model_name(model: str) -> str:
    return model.removesuffix(SUFFIX)
