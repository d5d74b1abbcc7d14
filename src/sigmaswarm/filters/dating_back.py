"""Initial state with tilts and accelerometer biases from the fixes before the start.

An alignment (`drives.alignment`) is planar and lacks these states. A filter over the earlier fixes estimates them. All
other states remain those of the alignment.
"""

from dataclasses import replace

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepare_drive
from sigmaswarm.filters.compiled.layout import state_rows
from sigmaswarm.filters.compiled.run import new_cursor
from sigmaswarm.filters.fix_error import FILTERS, STATES
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.models import THETA, require_driven_by_imu
from sigmaswarm.filters.packing import sound_lanes, unpack_states
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import run_steps, start_passes
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.filters.schedule import start_of

MAX_DURATION = 60.0  # s; fixes up to this long before the start are used
PRIOR_STD = np.array([2.0, 2.0, 1.0, 1.0, 0.03])  # at the first fix: m, m/s, rad; similar to an alignment


def dated_back(
    drive: Drive | PreparedDrive, parameters: FilterParameters, *, longest: float = MAX_DURATION
) -> InitialState:
    """Estimate the states that an alignment does not determine, at the time of the alignment.

    Roll, pitch and biases are those of a filter over the fixes before the start; the other states and the gyro bias
    about up are those of the alignment. Only data before the start are used.

    Parameters
    ----------
    drive : Drive or PreparedDrive
    parameters : FilterParameters
    longest : float
        Fixes up to this long before the start are used, s.

    Returns
    -------
    InitialState
        All states of the filter, for ``initial`` of `run_filter`, `smooth` and `LiveFilter`. If the filter fails or
        lacks these states, or if no earlier fix is usable, the result is the start of the alignment.

    Raises
    ------
    InputError
        If IMU samples are measurements of the model, as in robot-localization.
    """
    require_driven_by_imu(parameters.model, "dated_back")
    ready = prepare_drive(drive)
    start, gps = ready.initial, ready.drive.gps
    before = (gps.time > max(start.time - longest, ready.drive.imu.time[0])) & (gps.time < start.time)
    fixes = np.flatnonzero(before & ~ready.stale & np.isfinite(gps.x + gps.y))
    model = FILTERS[parameters.kernel]
    lacking = [
        i
        for i, state in enumerate(model.states)
        if i > THETA and i != model.gyro_bias and state not in STATES
    ]
    if len(fixes) < 2 or not lacking:
        return start
    past = _past(ready, _prior(ready.drive, start, int(fixes[0])), start.time)
    ended = _ended(past, parameters, start.time)
    if ended is None:
        return start
    mean, covariance = start_of(start, parameters)
    block = np.ix_(lacking, lacking)
    mean[lacking], covariance[block] = ended[0][lacking], ended[1][block]
    return InitialState(mean, covariance, start.time)


def _past(ready: PreparedDrive, start: InitialState, until: float) -> PreparedDrive:
    """Return the drive with another start, up to the first IMU sample after a time, s."""
    drive, imu = ready.drive, ready.drive.imu
    last = int(np.searchsorted(imu.time, until, side="right")) + 1
    past = replace(
        drive, imu=imu.select(slice(last)), gps=drive.gps.select(drive.gps.time <= until), truth=None
    )
    return PreparedDrive(past, start, as_recorded=ready.as_recorded)


def _prior(drive: Drive, start: InitialState, fix: int) -> InitialState:
    """Return a prior at an earlier fix: its position, the heading minus later turns, the mean velocity over 1 s."""
    gps, imu = drive.gps, drive.imu
    time = float(gps.time[fix])
    inside = (imu.time > time) & (imu.time <= start.time)
    theta = start.mean[4] - float(np.trapezoid(imu.gz[inside], imu.time[inside]))
    later = min(int(np.searchsorted(gps.time, time + 1.0)), int(np.searchsorted(gps.time, start.time)))
    moved = np.array([gps.x[later] - gps.x[fix], gps.y[later] - gps.y[fix]]) / (gps.time[later] - time)
    c, s = np.cos(theta), np.sin(theta)
    east, north = (
        drive.lever_arm[0] * c - drive.lever_arm[1] * s,
        drive.lever_arm[0] * s + drive.lever_arm[1] * c,
    )
    mean = np.array([gps.x[fix] - east, gps.y[fix] - north, *moved, theta])
    gyro = None if start.gyro is None else replace(start.gyro, turns=np.zeros(5))
    return InitialState(mean, np.diag(PRIOR_STD**2), time, gyro)


def _ended(ready: PreparedDrive, parameters: FilterParameters, until: float) -> tuple[Array, Array] | None:
    """Run to a time; return mean (n,) and covariance (n, n) of all states; None if the filter fails."""
    replay, array = whole_pass(ready), KernelArray([parameters])
    rows = start_passes([replay], array)[0]
    stop = int(np.searchsorted(replay.timeline.end, until, side="right"))
    run_steps(replay, array, rows, new_cursor(), stop)
    if not sound_lanes(rows[np.newaxis], parameters.kernel)[0, 0]:
        return None
    mean, covariance = unpack_states(rows[state_rows(parameters.kernel), :1], parameters.kernel)
    return mean[0], covariance[0]
