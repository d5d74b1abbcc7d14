"""IMU-only dead reckoning: Newton's equations from the start, no fix after it."""

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.filters.run import Estimate
from sigmaswarm.geodesy import wrap_angle


def run_imu_only(drive: Drive | PreparedDrive, *, initial: InitialState | None = None) -> Estimate:
    """Integrate the IMU from the same start as every filter; the same steps as `models.planar5`."""
    ready = prepared(drive, initial)
    line, initial = ready.timeline(), ready.initial
    x, y, vx, vy, theta = initial.mean
    heading = theta + np.cumsum(line.gz * line.dt)
    before = np.concatenate([[theta], heading[:-1]])
    a = (line.ax + 1j * line.ay) * np.exp(1j * before)  # m/s2, east + i north
    v = vx + 1j * vy + np.cumsum(a * line.dt)
    v_before = np.concatenate([[vx + 1j * vy], v[:-1]])
    p = x + 1j * y + np.cumsum(v_before * line.dt + a * line.dt**2 / 2)
    del a, before, v_before
    states = (p.real, p.imag, v.real, v.imag, wrap_angle(heading))
    mean = np.column_stack([state[line.sampled] for state in states])
    return Estimate(line.imu_time, mean, np.empty(0), initial)
