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

from collections.abc import Callable, Sequence
from dataclasses import replace

from sigmaswarm.arrays import Array
from sigmaswarm.filters.models import MODELS, CarModel, State

STATES = tuple(State(name, "m", (0.0, 0.0), name) for name in ("fix_error_x", "fix_error_y"))
SUFFIX = "+fix-error"  # end of the name of a model with the states b


def with_fix_error(model: CarModel) -> CarModel:
    """Return a model with the states b appended to the states of the given model."""

    def position(lever: Sequence[float], latency: float) -> Callable[[Array], Array]:
        antenna = model.position(lever, latency)
        return lambda state: antenna(state) + state[-2:]

    return replace(
        model,
        states=(*model.states, *STATES),
        position=position,
        filter_types=("ekf",) if model.tilts else ("ukf", "ekf"),
        fix_error=True,
    )


def add_start(mean: Array, covariance: Array, variance: Array) -> None:
    """Add b to initial means (..., n) and covariances (..., n, n), in place. ``variance`` (...) is g s^2, m2."""
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
