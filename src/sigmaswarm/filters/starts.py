"""Mean and covariance at the start of a filter, shared by all implementations of a filter."""

from collections.abc import Sequence

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.filters.fix_error import add_start
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.models import SENSORS, CarModel
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.tilted import add_tilt_evidence


def start_of(initial: InitialState, p: FilterParameters) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) at the start of a filter on a drive."""
    mean, covariance = starts_of([initial], FILTERS[p.kernel], start_std(p)[np.newaxis])
    return mean[0, 0], covariance[0, 0]


def start_std(p: FilterParameters) -> Array:
    """Return initial standard deviations, (3,), of accelerometer bias (m/s2), gyro bias (rad/s) and fix error (m)."""
    return np.array([*p.bias_std, np.sqrt(p.fix_error or 0.0) * p.fix_std])


def starts_of(initial: Sequence[InitialState], model: CarModel, std: Array) -> tuple[Array, Array]:
    """Return means (m, r, n) and covariances (m, r, n, n) for m starts and std of shape (r, 3).

    All starts have the same number of states. States that a start does not contain begin at 0; their standard deviation
    is ``std`` (see `start_std`) for a bias or fix error, otherwise the state's ``start_std``. The evidence of the
    alignment is included: see `GyroBiasEvidence.update` and `add_tilt_evidence`.
    """
    n = len(model.states)
    known = known_states(n, len(initial[0].mean))
    shape = len(initial), len(std), n
    mean, covariance = np.zeros(shape), np.zeros((*shape, n))
    for k, start in enumerate(initial):
        mean[k, :, :known] = start.mean[:known]
        covariance[k, :, :known, :known] = start.covariance[:known, :known]
    sensors = [*SENSORS]
    for i, state in enumerate(model.states[known:], known):
        if state.bias_of is not None:
            covariance[..., i, i] = std[:, sensors.index(state.bias_of)] ** 2
        else:
            covariance[..., i, i] = state.start_std**2
    gyro = std[:, sensors.index("gyro")]
    for k, j in np.ndindex(shape[:2]):
        state, start = (mean[k, j], covariance[k, j]), initial[k]
        if start.gyro is not None and model.gyro_axes:
            start.gyro.update(*state, model.gyro_indices, gyro[j])
        if start.tilt is not None and model.tilts:
            add_tilt_evidence(*state, start.tilt.numbers)
    if model.fix_error and known < n:
        add_start(mean, covariance, std[:, 2] ** 2)
    return mean, covariance


_LENGTHS = {len(model.states) for model in FILTERS.values() if model.fix_error}


def known_states(n: int, given: int) -> int:
    """Return the number of a model's n states that are also in an initial state with ``given`` states."""
    if n == given:
        return n
    return min(n - 2 if n in _LENGTHS else n, given - 2 if given in _LENGTHS else given)
