"""A car on a road that is not flat, in extended precision, like `extended_car` for planar models.

States are x, y, vx, vy, theta, the biases of ax, ay and gz, roll, pitch, and the biases of gx and gy. The attitude is a
matrix, which its error rotates from the left; all Jacobians are cross products with this error. The 25 sigma points are
such errors: each is added to the mean, transformed by process or measurement, and compared with the center.
"""

from collections.abc import Callable

import numpy as np

from oracles.extended import PI, Extended, transposed
from oracles.extended_car import Measurement, linear
from oracles.extended_filters import JacobianForm, SigmaPointForm

UP, TILT = 4, [8, 9]
ERROR = [*TILT, UP]
GYRO = [10, 11, 7]
GRAVITY = Extended("9.81")

__all__ = ["TiltedForm", "TiltedPoints", "fix", "lateral", "linear", "odometer"]


def skew(v: np.ndarray) -> np.ndarray:
    """Return [v]x, (s, 3, 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def exponential(v: np.ndarray) -> np.ndarray:
    """Return the rotation about v, (s, 3), by Rodrigues' formula; half angles keep all digits of small rotations."""
    half = np.sqrt(np.sum(v**2, axis=-1))[:, None, None] / 2
    sinc = np.where(half > 0, np.sin(half) / np.where(half > 0, half, 1), 1)
    cross = skew(v)
    return np.eye(3, dtype=Extended) + np.cos(half) * sinc * cross + sinc**2 / 2 * (cross @ cross)


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    return exponential(angle[:, None] * np.eye(3, dtype=Extended)[axis])


def attitude(mean: np.ndarray) -> np.ndarray:
    roll, pitch, theta = (mean[:, i] for i in ERROR)
    return about(2, theta) @ about(1, pitch) @ about(0, roll)


def with_attitude(mean: np.ndarray, r: np.ndarray) -> np.ndarray:
    new = mean.copy()
    new[:, TILT[0]] = np.arctan2(r[:, 2, 1], r[:, 2, 2])
    new[:, TILT[1]] = np.arctan2(-r[:, 2, 0], np.hypot(r[:, 0, 0], r[:, 1, 0]))
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

    def correct(self, mean, p, seen, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
        moved, covariance = super().correct(mean, p, seen, z)
        return plus(mean, moved - mean), covariance


class TiltedPoints(SigmaPointForm):
    """The unscented filter on the manifold.

    In the square root of P, the columns of the gyro's biases and of the attitude come first for a prediction, and those
    of the attitude for a measurement.
    """

    def __init__(self, sets) -> None:
        super().__init__(sets)
        self.order = [UP, *TILT, 0, 1, 2, 3, 5, 6, 7, 10, 11]

    def predict(self, mean, p, q, dt, imu) -> tuple[np.ndarray, np.ndarray]:
        measured, self.order = self.order, [7, 10, 11, UP, *TILT, 0, 1, 2, 3, 5, 6]
        offsets, self.order = self.offsets(p), measured
        sets, points, n = offsets.shape
        flat = np.repeat(mean, points, axis=0)
        r, a = self._driven(plus(flat, offsets.reshape(-1, n)), dt, imu)
        r, a = r.reshape(sets, points, 3, 3), a.reshape(sets, points, 3)
        errors = offsets.copy()  # relative to the center after the step
        change = (a - a[:, :1])[..., :2]
        errors[..., :2] += dt * offsets[..., 2:4] + dt**2 / 2 * change
        errors[..., 2:4] += dt * change
        turned = logarithm((r @ transposed(r[:, :1])).reshape(-1, 3, 3)).reshape(sets, points, 3)
        errors[..., ERROR] = nearest(turned, offsets[..., ERROR])
        shift, spread = self._moments(errors)
        centre = with_attitude(mean, r[:, 0])
        centre[:, :2] += dt * mean[:, 2:4] + dt**2 / 2 * a[:, 0, :2]
        centre[:, 2:4] += dt * a[:, 0, :2]
        return plus(centre, shift), transposed(self.wc[..., None] * spread) @ spread + q

    def _driven(self, states, dt, imu) -> tuple[np.ndarray, np.ndarray]:
        """Return the attitude and the acceleration after a step."""
        force = np.tile(imu[:3], (len(states), 1))
        force[:, :2] -= states[:, 5:7]
        half = exponential((imu[3:] - states[:, GYRO]) * dt / 2)
        middle = attitude(states) @ half
        return middle @ half, (middle @ force[..., None])[..., 0]

    def correct(self, mean, p, seen, z: Measurement) -> tuple[np.ndarray, np.ndarray]:
        moved, covariance = super().correct(mean, p, seen, z)
        return plus(mean, moved - mean), covariance


def plus(mean: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Add errors to means, (s, n) each."""
    return with_attitude(mean + error, exponential(error[:, ERROR]) @ attitude(mean))


def logarithm(r: np.ndarray) -> np.ndarray:
    """Return the rotation vector, (s, 3), of at most half a turn."""
    axis = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=-1) / 2
    sine = np.sqrt(np.sum(axis**2, axis=1))
    angle = np.arctan2(sine, (np.trace(r, axis1=1, axis2=2) - 1) / 2)
    return axis * np.where(sine > 0, angle / np.where(sine > 0, sine, 1), 1)[:, None]


def nearest(vector: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (..., 3) of the same rotations that are nearest to ``other``."""
    angle = np.sqrt(np.sum(vector**2, axis=-1, keepdims=True))
    axis = vector / np.where(angle > 0, angle, 1)
    turns = np.floor((np.sum(axis * other, axis=-1, keepdims=True) - angle) / (2 * PI) + Extended(0.5))
    return vector + 2 * PI * turns * axis


def pushed(innovation: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the function of the predicted change of a measurement, given its innovation z - h at means."""

    def change(mean: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        sets, points, n = offsets.shape
        flat = np.repeat(mean[:, 0], points, axis=0)
        moved = innovation(plus(flat, offsets.reshape(-1, n))).reshape(sets, points, -1)
        return innovation(mean[:, 0])[:, None] - moved

    return change


def each(values: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Repeat a value of each parameter set (s,) for its means, which are adjacent."""
    return np.repeat(values, len(mean) // len(values))


def fix(z: np.ndarray, lever: np.ndarray, latency: np.ndarray) -> Measurement:
    """Measure the antenna's position z (2,), ``lever`` (3,) m from the IMU, ``latency`` (s,) s ago."""

    def arm(mean: np.ndarray) -> np.ndarray:
        return (attitude(mean) @ lever.astype(Extended)[:, None])[..., 0]

    def innovation(mean: np.ndarray) -> np.ndarray:
        return (
            z.astype(Extended) - mean[:, :2] + each(latency, mean)[:, None] * mean[:, 2:4] - arm(mean)[:, :2]
        )

    def jacobian(mean: np.ndarray) -> np.ndarray:
        h = np.zeros((len(mean), 2, mean.shape[1]), dtype=Extended)
        h[:, 0, 0] = h[:, 1, 1] = 1
        h[:, 0, 2] = h[:, 1, 3] = -latency
        h[:, :, ERROR] = -skew(arm(mean))[:, :2]
        return h

    return Measurement(innovation, pushed(innovation), jacobian)


def on_the_road(mean: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an axis of the body, the upward axis, and the velocity, which is orthogonal to the latter; (s, 3) each."""
    r = attitude(mean)
    along, up = r[:, :, axis], r[:, :, 2]
    v = np.concatenate([mean[:, 2:4], np.zeros_like(mean[:, :1])], axis=1)
    v[:, 2] = -np.sum(up * v, axis=1) / up[:, 2]
    return along, up, v


def odometer(speed: np.ndarray, ax: float, delay: np.ndarray) -> Measurement:
    """Measure the forward velocity ``delay`` (s,) s ago; on a slope, ax contains a component of gravity."""

    def innovation(mean: np.ndarray) -> np.ndarray:
        forward, _, v = on_the_road(mean, 0)
        gained = Extended(ax) - mean[:, 5] - GRAVITY * forward[:, 2]
        return (each(speed, mean) + each(delay, mean) * gained - np.sum(forward * v, axis=1))[:, None]

    def jacobian(mean: np.ndarray) -> np.ndarray:
        # As in `lateral`; the slope forward_z also changes by (e x forward)_z = e . (forward x up), up of the world.
        forward, up, v = on_the_road(mean, 0)
        slope = (forward[:, 2] / up[:, 2])[:, None]
        h = np.zeros((len(mean), 1, mean.shape[1]), dtype=Extended)
        h[:, 0, 2:4] = forward[:, :2] - slope * up[:, :2]
        h[:, 0, ERROR] = (transposed(skew(v)) @ (forward - slope * up)[..., None])[..., 0]
        h[:, 0, ERROR] += (delay * GRAVITY)[:, None] * np.cross(forward, [0, 0, 1])
        h[:, 0, 5] = delay
        return h

    return Measurement(innovation, pushed(innovation), jacobian)


def lateral(gz: float, axle: np.ndarray) -> Measurement:
    """Measure zero lateral velocity at the rear axle; the vertical velocity relative to the road is zero."""

    def innovation(mean: np.ndarray) -> np.ndarray:
        left, _, v = on_the_road(mean, 1)
        return (each(axle, mean) * (Extended(gz) - mean[:, 7]) - np.sum(left * v, axis=1))[:, None]

    def jacobian(mean: np.ndarray) -> np.ndarray:
        # Derivative of left . v with up . v = 0: v changes by (dvx, dvy, dvz), left and up by e x left and e x up.
        left, up, v = on_the_road(mean, 1)
        slope = (left[:, 2] / up[:, 2])[:, None]
        h = np.zeros((len(mean), 1, mean.shape[1]), dtype=Extended)
        h[:, 0, 2:4] = left[:, :2] - slope * up[:, :2]
        h[:, 0, ERROR] = (transposed(skew(v)) @ (left - slope * up)[..., None])[..., 0]
        h[:, 0, 7] = axle
        return h

    return Measurement(innovation, pushed(innovation), jacobian)
