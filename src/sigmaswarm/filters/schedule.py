"""Initial states, constants of measurements, and checks of required data, shared by all implementations of a filter."""

from collections.abc import Collection, Sequence
from dataclasses import fields

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters import tilted
from sigmaswarm.filters.fix_error import FILTERS, add_start, known_states
from sigmaswarm.filters.models import MODELS, NOISE_OF, SENSORS, THETA, CarModel
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters

STANDSTILL_RATE_NOISE = np.radians(0.5) ** 2  # rad2/s2, variance of the gyro's reading around its bias
SLIP_GATE = 9.0
"""Largest accepted NIS of a wheel speed: three sigmas. The errors of slipping or locked wheels last for seconds, so
even updates with small weights would add up. The number of consecutive rejections is not limited: the fixes determine
the speed meanwhile, and P grows until it includes the true speed.
"""
HEADING_GATE = 9.0
"""Largest NIS of a heading. If the NIS is larger, the variance is increased until the NIS has this value (G. Chang,
Robust Kalman filtering based on Mahalanobis distance as outlier judging criterion, Journal of Geodesy 88, 2014). A
filter with a wrong heading can therefore recover.
"""
MOST_REJECTED = 5  # the gate rejects at most this many consecutive fixes, so that a filter can recover

# Standard deviations of the motion in an IMU gap relative to the mean of the adjacent samples
GAP_TURN_STD = 0.1  # rad/s; 0.05 to 0.3 give equal results
GAP_ACCELERATION_STD = 1.0  # m/s2 per axis; 0.5 to 2 give equal results
GAP_TILT_STD = 0.01  # rad/s about east and north; 0.02 gives equal results


def measured_by(p: FilterParameters) -> frozenset[str]:
    """Return the names in `MEASURED` of a parameter set's measurements, and "ay" if ay has its own noise."""
    used = {name for name, noise in NOISE_OF.items() if getattr(p, noise) is not None}
    return frozenset(used | ({"ay"} if len(p.imu_noise) > 2 else set()))


def require_odometer(drive: Drive) -> None:
    if drive.odometer is None:
        raise InputError(
            f"{drive.name}: the filter uses the wheel speed (odometer_noise), but the drive has no odometer.csv; "
            "use a filter that was tuned without odometer"
        )


def require_accuracy(line: Timeline) -> None:
    if not line.states_accuracy:
        raise InputError(
            f"{line.drive.name}: the filter weights each fix by the accuracy that the receiver states "
            "(accuracy_scale), but gps.csv does not contain std_x and std_y for all fixes; use a filter that "
            "was tuned without accuracy"
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


def gap_covariance(n: int, dt: float, gap: float) -> Array:
    """Return the covariance (n, n) that a step of ``dt`` s in a gap of ``gap`` s adds to P + Q; 0 if there is no gap.

    The unobserved motion is a constant turn rate and a constant acceleration over the gap. Together, the steps in a gap
    therefore add (GAP_TURN_STD gap)^2 to the variance of the heading and (GAP_ACCELERATION_STD gap)^2 to that of each
    velocity; in each step, the position changes by dt / 2 times the change of velocity. `GAP_TILT_STD` is not included.
    """
    added = np.zeros((n, n))
    g = GAP_ACCELERATION_STD**2 * gap * dt
    for p, v in ((0, 2), (1, 3)):
        added[v, v] = g
        added[p, p] = g * dt * dt / 4.0
        added[p, v] = added[v, p] = g * dt / 2.0
    added[THETA, THETA] = GAP_TURN_STD**2 * gap * dt
    return added


def start_of(initial: InitialState, p: FilterParameters) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) at the start of a drive."""
    mean, covariance = starts_of([initial], FILTERS[p.kernel], start_std(p)[np.newaxis])
    return mean[0, 0], covariance[0, 0]


def start_std(p: FilterParameters) -> Array:
    """Return the initial standard deviations of the biases, m/s2 and rad/s, and of b of `fix_error`, m; (3,)."""
    return np.array([*p.bias_std, np.sqrt(p.fix_error or 0.0) * p.fix_std])


def starts_of(initial: Sequence[InitialState], model: CarModel, std: Array) -> tuple[Array, Array]:
    """Return means (m, r, n) and covariances (m, r, n, n) for m starts and std of shape (r, 3).

    All starts have the same number of states. States that a start lacks begin at 0; their standard deviation is ``std``
    (see `start_std`) for a bias or fix error, and otherwise the state's ``start_std``. The evidence of the alignment is
    included: see `GyroBiasEvidence.update` and `add_tilt_evidence`.
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
            start.gyro.update(*state, model.gyro_places, gyro[j])
        if start.tilt is not None and model.tilts:
            tilted.add_tilt_evidence(*state, start.tilt.numbers)
    if model.fix_error and known < n:
        add_start(mean, covariance, std[:, 2] ** 2)
    return mean, covariance


def process_noise_per_step(p: FilterParameters, nominal_interval: float) -> Array:
    """Convert the diagonal of Q, (n,), from ``p.nominal_interval`` to the nominal IMU interval (s) of a drive."""
    return nominal_interval / (p.nominal_interval or nominal_interval) * np.array(p.process_noise)
