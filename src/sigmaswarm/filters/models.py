"""Vehicle models in the textbook's form: the process f(state, dt, imu) and the measurement h(state).

`UnscentedKalmanFilter` in reference.py takes any such pair of functions; these are the ones that the compiled
filter knows in closed form.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

THETA = 4
"""Index of the heading in planar5."""


def planar5(state: Array, dt: float, imu: Array) -> Array:
    """Newton's equations in the plane, driven by the IMU (the paper's process model).

    Parameters
    ----------
    state : ndarray, shape (5,)
        x, y (m), vx, vy (m/s), theta (rad).
    dt : float
        s.
    imu : ndarray, shape (3,)
        ax, ay (m/s2), yaw rate (rad/s), body frame.
    """
    x, y, vx, vy, theta = state
    ax, ay, yaw_rate = imu
    a_e = np.cos(theta) * ax - np.sin(theta) * ay
    a_n = np.sin(theta) * ax + np.cos(theta) * ay
    return np.array(
        [
            x + vx * dt + a_e * dt**2 / 2,
            y + vy * dt + a_n * dt**2 / 2,
            vx + a_e * dt,
            vy + a_n * dt,
            theta + yaw_rate * dt,
        ]
    )


def gps_position(state: Array) -> Array:
    """The fix that a state predicts: x, y (m)."""
    return state[:2].copy()
