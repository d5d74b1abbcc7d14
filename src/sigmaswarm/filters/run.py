"""One filter over one drive: `run_filter` compiled, `run_reference` in the textbook's form."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.drives.timeline import build_timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters.batch import Replay, Targets
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recording import Innovations, Recording
from sigmaswarm.filters.textbook_car import TextbookCar
from sigmaswarm.geodesy import wrap_angle

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a filter believed at each IMU sample after its start, after all fixes up to that time.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s, the IMU's times after ``initial.time``.
    mean : ndarray, shape (n, n_states)
        x, y (m), vx, vy (m/s), theta (rad, wrapped to (-pi, pi]), and planar8's biases. NaN from a failure on.
    covariance : ndarray, shape (n, n_states, n_states) or (0,)
        Of ``mean``; empty for dead reckoning, which has none.
    initial : InitialState
        Where the filter started.
    failure : str or None
        What went wrong and when; None where nothing did.
    """

    time: Array
    mean: Array
    covariance: Array
    initial: InitialState
    failure: str | None = None


def run_filter(
    drive: Drive | PreparedDrive, parameters: FilterParameters, *, initial: InitialState | None = None
) -> Estimate:
    """Run the compiled filter over a drive.

    Parameters
    ----------
    drive : Drive or PreparedDrive
        Its truth, if any, is not looked at.
    parameters : FilterParameters
    initial : InitialState, optional
        Where to start; `initial_state(drive)` by default.

    Returns
    -------
    Estimate
        With ``failure`` set where the covariance lost its definiteness or something became NaN.

    Raises
    ------
    AlignmentError
        If ``initial`` is not given and the drive never moves far enough.
    """
    replay = _replay(drive, initial)
    if not len(replay.timeline.imu_time):
        start = replay.initial.time
        raise InputError(
            f"{replay.timeline.drive.name}: no IMU sample after the start at {start:g} s; start earlier"
        )
    recording = Recording(replay, parameters)
    whole = recording.whole()
    return Estimate(whole.time, whole.mean, whole.covariance, replay.initial, recording.failure)


def run_innovations(
    drive: Drive | PreparedDrive, parameters: FilterParameters, *, initial: InitialState | None = None
) -> Innovations:
    """The innovations of the compiled filter over a drive; parameters as in `run_filter`.

    Of a filter that failed they are NaN or nonsense from the failure on; `run_filter` says so.
    """
    recording = Recording(_replay(drive, initial), parameters)
    for _ in recording:
        pass
    return recording.innovations


def _replay(drive: Drive | PreparedDrive, initial: InitialState | None) -> Replay:
    """The whole drive, compared with nothing."""
    ready = prepared(drive, initial)
    timeline = ready.timeline()
    return Replay(timeline, ready.initial, Targets.none(timeline))


def run_reference(
    drive: Drive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    heading_first: bool = True,
    redraw_sigma_points: bool = True,
) -> Estimate:
    """Run the textbook filter over a drive: some ten thousand times slower than `run_filter`.

    Parameters
    ----------
    drive, parameters, initial
        As in `run_filter`.
    heading_first : bool
        Take the square root of P with theta first, as the compiled filter does. False: plain Cholesky in state
        order, as FilterPy does.
    redraw_sigma_points : bool
        See `UnscentedKalmanFilter`.

    Raises
    ------
    NotPositiveDefiniteError
        When the filter fails.
    """
    initial = initial or initial_state(drive)
    timeline = build_timeline(drive, initial.time)
    car = TextbookCar(
        timeline, parameters, initial, heading_first=heading_first, redraw_sigma_points=redraw_sigma_points
    )
    means, covariances = [], []
    for step, sampled in enumerate(timeline.sampled):
        car.step(step)
        if sampled:
            means.append(car.filter.mean)
            covariances.append(car.filter.covariance)
    mean = np.array(means)
    mean[:, THETA] = wrap_angle(mean[:, THETA])
    return Estimate(timeline.imu_time, mean, np.array(covariances), initial)
