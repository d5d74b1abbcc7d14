"""tilted12: a car on a road that is not flat; process and measurements in textbook form.

The attitude is a rotation R from body to local frame, R = Rz(theta) Ry(pitch) Rx(roll): pitch is positive with the nose
down, roll with the left side up. The covariance describes a small rotation ``e`` about east, north and up, multiplied
from the left: R_true = exp([e]x) R (J. Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 7:
the global error). In state vectors, e has the indices of roll, pitch and theta. To first order, the covariance does not
change when e is injected. There is no vertical channel, since the car stays on the road. The Jacobians assume that the
specific force along the local up axis is gravity; with the measured force, bumps would make the Jacobians noisy.
"""

from collections.abc import Callable, Sequence

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.tilt_evidence import (
    ASSUMED,
    ASSUMED_VARIANCE,
    CHANGE,
    DRIFT,
    FORCE,
    FORWARD_STD,
    GRAVITY,
    MEAN_SPEED,
    TURN,
    VARIANCE,
)

THETA, ACCEL_X, ACCEL_Y, GYRO, ROLL, PITCH, GYRO_X, GYRO_Y, N = range(4, 13)
# Indices of the error about east, north and up; also of roll, pitch and theta
ATTITUDE = [ROLL, PITCH, THETA]
ACCEL_BIAS, GYRO_BIAS = [ACCEL_X, ACCEL_Y], [GYRO_X, GYRO_Y, GYRO]  # axes: forward, left; forward, left, up
STEP_FIRST, MEASURED_FIRST = (7, 10, 11, 4, 8, 9), (4, 8, 9)
"""States whose columns come first in the square root of P, for the sigma points of a step and of a measurement.

If these states are fixed, process and measurements are linear in all other states.
"""
AXES = ("ax", "ay", "az", "gx", "gy", "gz")


def rotation(state: Array) -> Array:
    """Return the rotation matrices R (..., 3, 3) from body to local frame for states (..., 12)."""
    angles = [state[..., i] for i in ATTITUDE]
    (cr, cp, ct), (sr, sp, st) = np.cos(angles), np.sin(angles)
    rows = [
        [ct * cp, ct * sp * sr - st * cr, ct * sp * cr + st * sr],
        [st * cp, st * sp * sr + ct * cr, st * sp * cr - ct * sr],
        [-sp, cp * sr, cp * cr],
    ]
    r = np.array(rows)
    return r if state.ndim == 1 else np.moveaxis(r, (0, 1), (-2, -1))


def with_rotation(state: Array, r: Array) -> Array:
    """Return the state with the attitude R; theta in (-pi, pi]."""
    new = state.copy()
    new[ATTITUDE] = (
        np.arctan2(r[2, 1], r[2, 2]),
        np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0])),
        np.arctan2(r[1, 0], r[0, 0]),
    )
    return new


def quaternion_of(states: Array) -> Array:
    """Return the attitude of states (..., 12) as quaternions (..., 4), the scalar first."""
    roll, pitch, theta = np.moveaxis(states[..., ATTITUDE] / 2, -1, 0)
    cr, cp, ct, sr, sp, st = (*map(np.cos, (roll, pitch, theta)), *map(np.sin, (roll, pitch, theta)))
    parts = (
        ct * cp * cr + st * sp * sr,
        ct * cp * sr - st * sp * cr,
        ct * sp * cr + st * cp * sr,
        st * cp * cr - ct * sp * sr,
    )
    return np.stack(parts, axis=-1)


def angles_of(quaternion: Array) -> Array:
    """Return roll, pitch and theta (..., 3) of quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    forward = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)  # the first column of R
    parts = (
        np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        np.arctan2(-forward[2], np.hypot(forward[0], forward[1])),
        np.arctan2(forward[1], forward[0]),
    )
    return np.stack(parts, axis=-1)


def _sinc(x: float) -> float:
    """Return sin(pi x) / (pi x); `np.sinc` is slow for a single number."""
    return float(np.sin(np.pi * x) / (np.pi * x)) if x else 1.0


def turn(vector: Array) -> Array:
    """Return exp([v]x), (3, 3), by Rodrigues' formula: the rotation about a vector (3,) by its length, rad."""
    angle = float(np.sqrt(vector @ vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = _sinc(angle / (2 * np.pi))  # sin(a / 2) / (a / 2)
    return np.eye(3) + _sinc(angle / np.pi) * cross + 0.5 * half**2 * cross @ cross


def turn_of(r: Array) -> Array:
    """Return the vector v (3,) with R = exp([v]x), shorter than half a turn."""
    doubled = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])  # 2 sin a, along the axis
    sine, cosine = np.sqrt(doubled @ doubled) / 2, (r[0, 0] + r[1, 1] + r[2, 2] - 1) / 2
    angle = float(np.arctan2(sine, cosine))
    return 0.5 * doubled / _sinc(angle / np.pi)


def plus(state: Array, error: Array) -> Array:
    """Inject an error (n,) into a state (n,)."""
    return with_rotation(state + error, turn(error[ATTITUDE]) @ rotation(state))


def minus(state: Array, other: Array) -> Array:
    """Return the error (n,) that changes ``other`` into the state."""
    error = state - other
    error[ATTITUDE] = turn_of(rotation(state) @ rotation(other).T)
    return error


def nearest(error: Array, near: Array) -> Array:
    """Add whole turns to the rotation vector of an error (12,), to bring it as near as possible to that of ``near``."""
    vector, other = error[ATTITUDE], near[ATTITUDE]
    angle = np.sqrt(vector @ vector)
    if not angle > 0:
        return error
    turns = np.round((vector @ other / angle - angle) / (2 * np.pi))
    new = error.copy()
    new[ATTITUDE] = vector * (1 + 2 * np.pi * turns / angle)
    return new


def _middle(state: Array, dt: float, imu: Array) -> tuple[Array, Array, Array]:
    """Return R (3, 3) at the middle of a step, the rotation (3, 3) from middle to end, and the acceleration (3,)."""
    force = imu[:3] - [*state[ACCEL_BIAS], 0.0]
    half = turn((imu[3:] - state[GYRO_BIAS]) * dt / 2)
    r = rotation(state) @ half
    return r, half, r @ force


def tilted12(state: Array, dt: float, imu: Array) -> Array:
    """Propagate by Newton's equations for any attitude, with constant IMU biases; imu (6,) in the order of `AXES`."""
    r, half, a = _middle(state, dt, imu)
    new = with_rotation(state, r @ half)
    new[:2] += state[2:4] * dt + a[:2] * dt**2 / 2
    new[2:4] += a[:2] * dt
    return new


def transition(state: Array, dt: float, imu: Array) -> Array:
    """Return F, (n, n): the transition of a small error over a step."""
    r, _, a = _middle(state, dt, imu)
    of_error = np.zeros((2, len(state)))  # derivatives of the acceleration's error, e x a - R b
    of_error[:, ATTITUDE] = [[0.0, GRAVITY, -a[1]], [-GRAVITY, 0.0, a[0]]]
    of_error[:, ACCEL_BIAS] = -r[:2, :2]
    f = np.eye(len(state))
    f[2:4] += dt * of_error
    f[:2] += dt**2 / 2 * of_error
    f[0, 2] = f[1, 3] = dt
    f[np.ix_(ATTITUDE, GYRO_BIAS)] = -dt * r
    return f


def antenna(lever: Sequence[float], latency: float = 0.0) -> Callable[[Array], Array]:
    """Predict a fix: the position, ``latency`` s ago, of an antenna ``lever`` m forward, left and up of the IMU."""
    return lambda state: state[:2] - latency * state[2:4] + (rotation(state) @ lever)[:2]


def rear_axle(yaw_rate: float, distance: float) -> Callable[[Array], Array]:
    """Predict the velocity to the left (m/s) at the rear axle of a car that moves along the road.

    ``distance`` is the distance from the rear axle forward to the IMU, m. ``yaw_rate`` is in rad/s.
    """

    def h(state: Array) -> Array:
        _, left, up = rotation(state).T
        return np.array([left @ along_the_road(state, up) - distance * (yaw_rate - state[GYRO])])

    return h


def wheels(ax: float, delay: float) -> Callable[[Array], Array]:
    """Predict the forward velocity along the road (m/s) that the wheels measured ``delay`` s ago.

    ``ax`` is the forward specific force (m/s2), which on a slope contains a component of gravity.
    """

    def h(state: Array) -> Array:
        forward, _, up = rotation(state).T
        gained = ax - state[ACCEL_X] - GRAVITY * forward[2]
        return np.array([forward @ along_the_road(state, up) - delay * gained])

    return h


def heading(near: float) -> Callable[[Array], Array]:
    """Predict the heading (rad) of two antennas: the yaw of the attitude, within half a turn of ``near``."""

    def h(state: Array) -> Array:
        theta = state[[THETA]]
        return theta - 2 * np.pi * np.round((theta.real - near) / (2 * np.pi))

    return h


def along_the_road(state: Array, up: Array) -> Array:
    """Return the velocity (3,) of a car that stays on its road. ``up`` (3,) is the road's normal."""
    vx, vy = state[2:4]
    return np.array([vx, vy, -(up[0] * vx + up[1] * vy) / up[2]])


@cached(error_model="numpy")
def add_tilt_evidence(mean: Array, covariance: Array, seen: Array) -> None:
    """Update the mean (12,) and covariance (12, 12) of a level start with `TiltEvidence.numbers`, in place.

    The evidence is the mean specific force, forward and left, which gives two Kalman updates. The state of the
    alignment depends on an assumed distribution of the forward force; the updated distribution replaces it here.
    """
    c, s = np.cos(mean[THETA]), np.sin(mean[THETA])
    re, im = GRAVITY * (seen[TURN] * c + seen[TURN + 1] * s), GRAVITY * (seen[TURN + 1] * c - seen[TURN] * s)
    drift_re, drift_im = GRAVITY * seen[DRIFT], GRAVITY * seen[DRIFT + 1]
    h, gain, change = np.zeros(N), np.zeros(N), np.zeros(N)
    for axis in range(2):
        ahead = axis == 0
        h[ROLL], h[PITCH] = -im if ahead else re, -re if ahead else -im
        h[GYRO_X], h[GYRO_Y] = -drift_im if ahead else drift_re, -drift_re if ahead else -drift_im
        h[GYRO], h[ACCEL_X], h[ACCEL_Y] = 0.0 if ahead else -seen[MEAN_SPEED], 1.0 - axis, 0.0 + axis
        for i in range(5):
            change[i] = seen[CHANGE + i] if ahead else 0.0
        force, square = 0.0, FORWARD_STD * FORWARD_STD if ahead else 0.0
        for i in range(N):
            gain[i] = 0.0
            for j in range(N):
                gain[i] += covariance[i, j] * h[j]
            square += h[i] * gain[i]
            force += h[i] * mean[i]
        share = square / (square + seen[VARIANCE + axis])  # of the measured force
        more = share * (seen[FORCE + axis] - force)
        spread = square * (1.0 - share) - seen[ASSUMED_VARIANCE]
        for i in range(N):
            mean[i] += gain[i] * (more / square) + change[i] * (force + more - seen[ASSUMED])
            for j in range(N):
                covariance[i, j] += (1.0 - share) * (gain[i] * change[j] + change[i] * gain[j])
                covariance[i, j] += spread * change[i] * change[j] - share / square * gain[i] * gain[j]
    c, s = np.cos(mean[THETA]), np.sin(mean[THETA])
    re, im = mean[ROLL], mean[PITCH]
    mean[ROLL], mean[PITCH] = c * re + s * im, c * im - s * re


@np.errstate(all="ignore")  # a failed filter has no finite values
def as_angles(state: Array, covariance: Array) -> Array:
    """Return the covariance (..., n, n) of states (..., n), with roll, pitch and theta instead of the error e."""
    to_angles = angles_by_error(state)
    return to_angles @ covariance @ to_angles.swapaxes(-1, -2)


def angles_by_error(state: Array) -> Array:
    """Return the derivative of states (..., n) with respect to the error, (..., n, n).

    For small changes of the angles, e = A (d_roll, d_pitch, d_theta); the columns of A are the axes of rotation.
    """
    theta, pitch = state[..., ATTITUDE[2]], state[..., ATTITUDE[1]]
    ct, st, tan, sec = np.cos(theta), np.sin(theta), np.tan(pitch), 1 / np.cos(pitch)
    to_angles = np.zeros((*state.shape, state.shape[-1])) + np.eye(state.shape[-1])
    roll, nose, up = ATTITUDE
    to_angles[..., roll, roll], to_angles[..., roll, nose] = ct * sec, st * sec
    to_angles[..., nose, roll], to_angles[..., nose, nose] = -st, ct
    to_angles[..., up, roll], to_angles[..., up, nose] = ct * tan, st * tan
    return to_angles
