"""A better start: the filter runs over the fixes before the start again, up to the time of the start.

The alignment (`drives.alignment`) is a fit in the plane. It uses no tilts, accelerometer biases, standstills or lateral
constraint. A filter that runs over the same and earlier fixes uses all of them.
"""

from dataclasses import replace

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.filters.compiled.layout import state_rows
from sigmaswarm.filters.compiled.run import new_place
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.models import require_driven_by_imu
from sigmaswarm.filters.packing import sound_lanes, unpack_states
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.replay import run_steps, start_replays
from sigmaswarm.filters.run import replay_of
from sigmaswarm.filters.smoothing import smooth

LONGEST = 60.0
"""s before the start in which fixes are used."""
PRIOR_STD = np.array([2.0, 2.0, 1.0, 1.0, 0.03])
"""Standard deviations of the prior at the first of these fixes, m, m/s, rad, similar to those of an alignment. With
0.1 rad the heading error of colorado-1 after the start was up to three times larger."""


def dated_back(
    drive: Drive | PreparedDrive, parameters: FilterParameters, *, longest: float = LONGEST
) -> InitialState:
    """Run the filter over the fixes before the start, for a better start at the same time.

    There are two passes, since the filter linearizes. The first is smoothed back to the earliest of these fixes; the
    second starts from there with the same prior covariance. Only data before the start are used.

    Parameters
    ----------
    drive : Drive or PreparedDrive
    parameters : FilterParameters
    longest : float
        s before the start; earlier fixes are not used.

    Returns
    -------
    InitialState
        All states of the model, for ``initial`` of `run_filter` and `smooth`. Where a pass fails or there are fewer
        than two usable fixes, it is the start of the alignment.

    Raises
    ------
    InputError
        If the model measures the IMU: robot-localization.
    """
    require_driven_by_imu(parameters.model, "dated_back")
    ready = prepared(drive)
    found, gps = ready.initial, ready.drive.gps
    before = (gps.time > max(found.time - longest, ready.drive.imu.time[0])) & (gps.time < found.time)
    fixes = np.flatnonzero(before & ~ready.frozen & np.isfinite(gps.x + gps.y))
    if len(fixes) < 2:
        return found
    first = _prior(ready.drive, found, int(fixes[0]))
    smoothed = smooth(_past(ready, first, found.time), parameters, recover=False)
    if smoothed.failure:
        return found
    again = replace(first, mean=smoothed.initial.mean[:5])
    return _ended(_past(ready, again, found.time, more=1), parameters, found)


def _past(ready: PreparedDrive, start: InitialState, until: float, more: int = 0) -> PreparedDrive:
    """Return the drive up to a time and ``more`` IMU samples after it, with another start."""
    drive, imu = ready.drive, ready.drive.imu
    last = int(np.searchsorted(imu.time, until, side="right")) + more
    past = replace(
        drive, imu=imu.select(slice(last)), gps=drive.gps.select(drive.gps.time <= until), truth=None
    )
    return PreparedDrive(past, start, as_recorded=ready.as_recorded)


def _prior(drive: Drive, found: InitialState, fix: int) -> InitialState:
    """Return the prior at a fix before the start: its position, the heading minus later turns, a chord's velocity."""
    gps, imu = drive.gps, drive.imu
    time = float(gps.time[fix])
    inside = (imu.time > time) & (imu.time <= found.time)
    theta = found.mean[4] - float(np.trapezoid(imu.gz[inside], imu.time[inside]))
    later = min(int(np.searchsorted(gps.time, time + 1.0)), int(np.searchsorted(gps.time, found.time)))
    moved = np.array([gps.x[later] - gps.x[fix], gps.y[later] - gps.y[fix]]) / (gps.time[later] - time)
    c, s = np.cos(theta), np.sin(theta)
    forward, left = drive.lever_arm[:2]
    east, north = forward * c - left * s, forward * s + left * c
    mean = np.array([gps.x[fix] - east, gps.y[fix] - north, *moved, theta])
    gyro = None if found.gyro is None else replace(found.gyro, turns=np.zeros(5))
    return InitialState(mean, np.diag(PRIOR_STD**2), time, gyro)


def _ended(ready: PreparedDrive, parameters: FilterParameters, found: InitialState) -> InitialState:
    """Run to the fix of the start; return the alignment's start where the filter fails."""
    replay, array = replay_of(ready), KernelArray([parameters])
    rows = start_replays([replay], array)[0]
    line = replay.timeline
    stop = int(np.searchsorted(line.end, found.time, side="right"))
    run_steps(replay, array, rows, new_place(), stop)
    mean, covariance = unpack_states(rows[state_rows(parameters.kernel), :1], parameters.kernel)
    if not sound_lanes(rows[np.newaxis], parameters.kernel)[0, 0]:
        return found
    return InitialState(mean[0], covariance[0], found.time)
