"""Start of a filter on a drive: the data that the filter requires, and mean and covariance at its start."""

from collections.abc import Collection, Sequence
from dataclasses import fields

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters.kernels import FILTERS, add_start
from sigmaswarm.filters.models import MODELS, NOISE_OF, SENSORS, CarModel
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.tilted import add_tilt_evidence


def measured_by(p: FilterParameters) -> frozenset[str]:
    """Return the names in `MEASURED` of a parameter set's measurements, and "ay" if ay has its own noise."""
    used = {name for name, noise in NOISE_OF.items() if getattr(p, noise) is not None}
    return frozenset(used | ({"ay"} if len(p.imu_noise) > 2 else set()))


def require_odometer(drive: Drive) -> None:
    if drive.odometer is None:
        raise InputError(
            f"{drive.name}: the filter uses the wheel speed (odometer_noise), but the drive has no odometer.csv; "
            "use a filter that was tuned without an odometer"
        )


def require_accuracy(line: Timeline) -> None:
    if not line.states_accuracy:
        raise InputError(
            f"{line.drive.name}: the filter weights each fix by the accuracy that the receiver states "
            "(accuracy_scale), but gps.csv does not contain std_x and std_y for all fixes; use a filter that "
            "was tuned without the option accuracy"
        )


def require_axes(drive: Drive, model: ModelName) -> None:
    require_named_axes(
        drive.name, [f.name for f in fields(drive.imu) if getattr(drive.imu, f.name) is not None], model
    )


def require_named_axes(name: str, axes: Collection[str], model: ModelName) -> None:
    lacking = [axis for axis in MODELS[model].imu if axis not in axes]
    if lacking:
        raise InputError(
            f"{name}: imu.csv has no {', '.join(lacking)}, which {model} needs; "
            "use planar8, which needs only ax, ay and gz"
        )


def start_of(initial: InitialState, p: FilterParameters) -> tuple[Array, Array]:
    """Return the mean (n,) and covariance (n, n) at the start of a filter on a drive."""
    mean, covariance = starts_of([initial], FILTERS[p.kernel], start_std(p)[np.newaxis])
    return mean[0, 0], covariance[0, 0]


def start_std(p: FilterParameters) -> Array:
    """Return initial standard deviations, (3,), of accelerometer bias (m/s2), gyro bias (rad/s) and fix error (m)."""
    return np.array([*p.bias_std, np.sqrt(p.fix_error or 0.0) * p.fix_std])


def starts_of(initial: Sequence[InitialState], model: CarModel, std: Array) -> tuple[Array, Array]:
    """Return the means (m, r, n) and covariances (m, r, n, n) for m starts and std of shape (r, 3).

    All starts have the same number of states. States that a start does not contain begin at 0. Their standard deviation
    is ``std`` (see `start_std`) for a bias or fix error, otherwise the state's ``start_std``. The evidence of the
    alignment is included (see `GyroBiasEvidence.update` and `add_tilt_evidence`).
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
