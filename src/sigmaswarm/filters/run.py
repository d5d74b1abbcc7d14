"""One filter over one drive: `run_filter` compiled, `run_reference` in the textbook's form."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.timeline import build_timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters.batch import Replay, Targets, record_innovations, record_replay
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
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
    drive: Drive, parameters: FilterParameters, *, initial: InitialState | None = None
) -> Estimate:
    """Run the compiled filter over a drive.

    Parameters
    ----------
    drive : Drive
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
    initial = initial or initial_state(drive)
    timeline = build_timeline(drive, initial.time)
    if not len(timeline.imu_time):
        raise InputError(f"{drive.name}: no IMU sample after the start at {initial.time:g} s; start earlier")
    replay = Replay(timeline, initial, Targets.none(timeline))
    mean, covariance, sound = record_replay(replay, parameters)
    mean[:, THETA] = wrap_angle(mean[:, THETA])
    estimate = Estimate(timeline.imu_time, mean, covariance, initial)
    if sound.all():
        return estimate
    first = int(np.argmin(sound))
    mean[first:], covariance[first:] = np.nan, np.nan
    failure = (
        f"{drive.name}: the filter failed at t = {timeline.imu_time[first]:.3f} s (covariance not positive "
        "definite, or NaN in the data); are all variances positive and all samples finite?"
    )
    return replace(estimate, failure=failure)


@dataclass(frozen=True, eq=False)
class Innovations:
    """What each fix said that a filter did not expect, before the fix was absorbed.

    Attributes
    ----------
    time : ndarray, shape (f,)
        s, of the fixes after the start.
    innovation : ndarray, shape (f, 2)
        nu, m east and north.
    covariance : ndarray, shape (f, 2, 2)
        S, m2.
    """

    time: Array
    innovation: Array
    covariance: Array

    @property
    def nis(self) -> Array:
        """nu^T S^-1 nu, shape (f,): chi-square with 2 degrees of freedom where the filter is consistent."""
        return np.square(self.normalized).sum(axis=1)

    @property
    def normalized(self) -> Array:
        """L^-1 nu with L L^T = S, shape (f, 2): white, of variance one, where the filter is consistent."""
        root = np.linalg.cholesky(self.covariance)
        return np.asarray(np.linalg.solve(root, self.innovation[..., None])[..., 0], np.float64)


def run_innovations(
    drive: Drive, parameters: FilterParameters, *, initial: InitialState | None = None
) -> Innovations:
    """The innovations of the compiled filter over a drive; parameters as in `run_filter`.

    Of a filter that failed they are NaN or nonsense from the failure on; `run_filter` says so.
    """
    initial = initial or initial_state(drive)
    timeline = build_timeline(drive, initial.time)
    rows = record_innovations(Replay(timeline, initial, Targets.none(timeline)), parameters)
    return Innovations(timeline.fix_time, rows[:, :2], rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2))


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
