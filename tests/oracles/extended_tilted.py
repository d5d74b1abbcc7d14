"""A car on a road that is not flat, in extended precision: what `extended_car` is for planar ones.

States are x, y, vx, vy, theta, the biases of ax, ay and gz, roll, pitch, and the biases of gx and gy. The attitude is a
matrix; its error turns it from the left, and all Jacobians are cross products with that error.
"""

import numpy as np

from oracles.extended import Extended, transposed
from oracles.extended_car import Measurement, linear
from oracles.extended_filters import JacobianForm

UP, TILT = 4, [8, 9]
ERROR = [*TILT, UP]
GYRO = [10, 11, 7]
GRAVITY = Extended("9.81")

__all__ = ["TiltedForm", "fix", "lateral", "linear", "odometer"]


def skew(v: np.ndarray) -> np.ndarray:
    """[v]x, (s, 3, 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def exponential(v: np.ndarray) -> np.ndarray:
    """The rotation about v, (s, 3), by its power series, halved until that is short and squared back."""
    halvings = 20
    step = skew(v) / 2**halvings
    term = total = np.tile(np.eye(3, dtype=Extended), (len(v), 1, 1))
    for k in range(1, 8):
        term = term @ step / k
        total = total + term
    rest = total - np.eye(3, dtype=Extended)
    for _ in range(halvings):  # of what is beside the identity, so that no digit of it is lost
        rest = 2 * rest + rest @ rest
    return rest + np.eye(3, dtype=Extended)


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    return exponential(angle[:, None] * np.eye(3, dtype=Extended)[axis])


def attitude(mean: np.ndarray) -> np.ndarray:
    roll, pitch, theta = (mean[:, i] for i in ERROR)
    return about(2, theta) @ about(1, pitch) @ about(0, roll)


def with_attitude(mean: np.ndarray, r: np.ndarray) -> np.ndarray:
    new = mean.copy()
    new[:, TILT[0]] = np.arctan2(r[:, 2, 1], r[:, 2, 2])
    new[:, TILT[1]] = np.arcsin(-r[:, 2, 0])
    new[:, UP] = np.arctan2(r[:, 1, 0], r[:, 0, 0])
    return new


class TiltedForm(JacobianForm):
    """The error-state Kalman filter; ``imu`` is ax, ay, az, gx, gy, gz."""

    def predict(self, mean, p, q, dt, imu) -> tuple[np.ndarray, np.ndarray]:
        force = np.tile(imu[:3], (len(mean), 1))
        force[:, :2] -= mean[:, 5:7]
        half = exponential((imu[3:] - mean[:, GYRO]) * dt / 2)
        middle = attitude(mean) @ half
        a = (middle @ force[..., None])[..., 0]
        new = with_attitude(mean, middle @ half)
        new[:, :2] += dt * mean[:, 2:4] + dt**2 / 2 * a[:, :2]
        new[:, 2:4] += dt * a[:, :2]
        a[:, 2] = GRAVITY
        f = np.tile(np.eye(mean.shape[1], dtype=Extended), (len(mean), 1, 1))
        for rows, scale in (([2, 3], dt), ([0, 1], dt**2 / 2)):
            f[:, [[rows[0]], [rows[1]]], ERROR] = -scale * skew(a)[:, :2]
            f[:, [[rows[0]], [rows[1]]], [5, 6]] = -scale * middle[:, :2, :2]
        f[:, 0, 2] = f[:, 1, 3] = dt
        f[:, np.array(ERROR)[:, None], GYRO] = -dt * middle
        return new, f @ p @ transposed(f) + q

    def absorb(self, mean, p, seen, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
        moved, covariance = super().absorb(mean, p, seen, z)
        error = moved - mean
        return with_attitude(moved, exponential(error[:, ERROR]) @ attitude(mean)), covariance


def fix(z: np.ndarray, lever: np.ndarray, latency: np.ndarray) -> Measurement:
    """The antenna's position, z (2,), ``lever`` (3,) m from the IMU, ``latency`` (s,) s ago."""

    def arm(mean: np.ndarray) -> np.ndarray:
        return (attitude(mean) @ lever.astype(Extended)[:, None])[..., 0]

    def innovation(mean: np.ndarray) -> np.ndarray:
        return z.astype(Extended) - mean[:, :2] + latency[:, None] * mean[:, 2:4] - arm(mean)[:, :2]

    def jacobian(mean: np.ndarray) -> np.ndarray:
        h = np.zeros((len(mean), 2, mean.shape[1]), dtype=Extended)
        h[:, 0, 0] = h[:, 1, 1] = 1
        h[:, 0, 2] = h[:, 1, 3] = -latency
        h[:, :, ERROR] = -skew(arm(mean))[:, :2]
        return h

    return Measurement(innovation, _nothing, jacobian)


def on_the_road(mean: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An axis of the body, the one upwards, and the velocity, which has no part along that; (s, 3) each."""
    r = attitude(mean)
    along, up = r[:, :, axis], r[:, :, 2]
    v = np.concatenate([mean[:, 2:4], np.zeros_like(mean[:, :1])], axis=1)
    v[:, 2] = -np.sum(up * v, axis=1) / up[:, 2]
    return along, up, v


def odometer(speed: np.ndarray, ax: float, delay: np.ndarray) -> Measurement:
    """The velocity forward along the road as it was ``delay`` (s,) s ago; on a slope gravity is a part of ax."""

    def innovation(mean: np.ndarray) -> np.ndarray:
        forward, _, v = on_the_road(mean, 0)
        gained = Extended(ax) - mean[:, 5] - GRAVITY * forward[:, 2]
        return (speed + delay * gained - np.sum(forward * v, axis=1))[:, None]

    def jacobian(mean: np.ndarray) -> np.ndarray:
        # As of `lateral`; and the slope, forward_z, changes by (e x forward)_z = e . (forward x up), up the world's.
        forward, up, v = on_the_road(mean, 0)
        slope = (forward[:, 2] / up[:, 2])[:, None]
        h = np.zeros((len(mean), 1, mean.shape[1]), dtype=Extended)
        h[:, 0, 2:4] = forward[:, :2] - slope * up[:, :2]
        h[:, 0, ERROR] = (transposed(skew(v)) @ (forward - slope * up)[..., None])[..., 0]
        h[:, 0, ERROR] += (delay * GRAVITY)[:, None] * np.cross(forward, [0, 0, 1])
        h[:, 0, 5] = delay
        return h

    return Measurement(innovation, _nothing, jacobian)


def lateral(gz: float, axle: np.ndarray) -> Measurement:
    """No velocity to the left at the rear axle, and none away from the road."""

    def innovation(mean: np.ndarray) -> np.ndarray:
        left, _, v = on_the_road(mean, 1)
        return (axle * (Extended(gz) - mean[:, 7]) - np.sum(left * v, axis=1))[:, None]

    def jacobian(mean: np.ndarray) -> np.ndarray:
        # Of left . v with up . v = 0: v changes by (dvx, dvy, dvz), left and up by e x left and e x up.
        left, up, v = on_the_road(mean, 1)
        slope = (left[:, 2] / up[:, 2])[:, None]
        h = np.zeros((len(mean), 1, mean.shape[1]), dtype=Extended)
        h[:, 0, 2:4] = left[:, :2] - slope * up[:, :2]
        h[:, 0, ERROR] = (transposed(skew(v)) @ (left - slope * up)[..., None])[..., 0]
        h[:, 0, 7] = axle
        return h

    return Measurement(innovation, _nothing, jacobian)


def _nothing(mean: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    raise NotImplementedError("no sigma points here")
