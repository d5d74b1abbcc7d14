"""Vehicle models in the textbook's form: the process f(state, dt, imu) and measurements h(state).

`UnscentedKalmanFilter` and `ExtendedKalmanFilter` take any such functions; these are the ones that the compiled filter
knows in closed form. Arrays: state (n,); imu (3,) = ax, ay (m/s2), yaw rate (rad/s), body frame.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

THETA = 4
"""Index of the heading in planar5 and planar8."""


def planar5(state: Array, dt: float, imu: Array) -> Array:
    """Newton's equations in the plane, driven by the IMU (the paper's process model); state x, y, vx, vy, theta."""
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


def planar8(state: Array, dt: float, imu: Array) -> Array:
    """planar5 with the biases of accelerometer (x, y) and gyro (z) taken off the IMU; they stay as they are."""
    return np.concatenate([planar5(state[:5], dt, imu - state[5:]), state[5:]])


PROCESSES: dict[str, Callable[[Array, float, Array], Array]] = {"planar5": planar5, "planar8": planar8}


def gps_position(lever: tuple[float, float] = (0.0, 0.0), latency: float = 0.0) -> Callable[[Array], Array]:
    """The fix that a state predicts: where the antenna, ``lever`` m forward and left, was ``latency`` s ago."""

    def h(state: Array) -> Array:
        c, s = np.cos(state[THETA]), np.sin(state[THETA])
        arm = np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]])
        return state[:2] - latency * state[2:4] + arm

    return h


def velocity(state: Array) -> Array:
    """Velocity over ground, m/s east and north."""
    return state[2:4].copy()


def lateral_velocity(yaw_rate: float, rear_axle: float) -> Callable[[Array], Array]:
    """Velocity to the left (m/s) at the rear axle, ``rear_axle`` m behind the IMU: a car on its wheels has none."""

    def h(state: Array) -> Array:
        bias = state[7] if len(state) == 8 else 0.0
        left = np.cos(state[THETA]) * state[3] - np.sin(state[THETA]) * state[2]
        return np.array([left - rear_axle * (yaw_rate - bias)])

    return h


def gyro_bias(state: Array) -> Array:
    """What the gyro shows while the car stands, rad/s."""
    return state[7:8].copy()
