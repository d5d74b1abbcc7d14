"""Process and measurements of a car in extended precision, with manual Jacobians.

States are x, y, vx, vy, theta, and for planar8 the biases of ax, ay and the yaw rate. A sigma point is given as mean
(s, 1, n) and offset (s, p, n): with alpha = 1e-3, the sum of a mean of hundreds of meters and a small offset would lose
digits, even with 64 bits. Therefore, linear operations are applied to means and offsets separately. The leading axis is
that of the s parameter sets.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oracles.extended import THETA, Extended, wrap


@dataclass(frozen=True)
class Measurement:
    """A measurement of a sensor.

    innovation : z - h at the mean (s, n), shape (s, m)
    change : h of the points less h at the mean, (s, 1, n) and (s, p, n) to (s, p, m)
    jacobian : of h at the mean (s, n), shape (s, m, n)
    """

    innovation: Callable[[np.ndarray], np.ndarray]
    change: Callable[[np.ndarray, np.ndarray], np.ndarray]
    jacobian: Callable[[np.ndarray], np.ndarray]


def _biases(mean: np.ndarray, offsets: np.ndarray) -> list[np.ndarray]:
    """Return the three biases of all points, each (s, p); they are zero for planar5."""
    if mean.shape[-1] == THETA + 1:
        return [np.zeros(offsets.shape[:-1], dtype=Extended)] * 3
    return list(np.moveaxis(mean[..., 5:] + offsets[..., 5:], -1, 0))


def _heading(mean: np.ndarray, offsets: np.ndarray | int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return cosine and sine; the mean is wrapped first, since a heading of many turns has few digits left."""
    turn = offsets if isinstance(offsets, int) else offsets[..., THETA]
    theta = wrap(mean[..., THETA]) + turn
    return np.cos(theta), np.sin(theta)


def newton(mean: np.ndarray, offsets: np.ndarray, dt: Extended, imu: np.ndarray) -> np.ndarray:
    """Return new offsets (s, p, n), relative to the mean after coasting with the gyro's turn.

    Newton's equations are the same in a frame that moves with the mean.
    """
    bias_x, bias_y, _ = _biases(mean, offsets)
    c, s = _heading(mean, offsets)
    fx, fy = imu[0] - bias_x, imu[1] - bias_y
    east, north = c * fx - s * fy, s * fx + c * fy
    new = offsets.copy()
    x, y, u, v = np.moveaxis(offsets[..., :4], -1, 0)
    new[..., 0], new[..., 1] = x + u * dt + east * dt**2 / 2, y + v * dt + north * dt**2 / 2
    new[..., 2], new[..., 3] = u + east * dt, v + north * dt
    if offsets.shape[-1] == 8:
        new[..., THETA] -= offsets[..., 7] * dt
    return new


def coasted(mean: np.ndarray, dt: Extended, gz: Extended) -> np.ndarray:
    """Return the mean (s, n) after a step without acceleration."""
    new = mean.copy()
    new[:, :2] += mean[:, 2:4] * dt
    new[:, THETA] += (gz - (mean[:, 7] if mean.shape[1] == 8 else 0)) * dt
    return new


def newton_jacobian(mean: np.ndarray, dt: Extended, imu: np.ndarray) -> np.ndarray:
    """Return F, (s, n, n)."""
    sets, n = mean.shape
    here, nothing = mean[:, None], np.zeros((sets, 1, n), dtype=Extended)
    bias_x, bias_y, _ = (b[:, 0] for b in _biases(here, nothing))
    c, s = _heading(mean)
    fx, fy = imu[0] - bias_x, imu[1] - bias_y
    east, north = c * fx - s * fy, s * fx + c * fy
    by_state = np.zeros((sets, 2, n), dtype=Extended)  # d (east, north) / d state
    by_state[:, 0, THETA], by_state[:, 1, THETA] = -north, east
    if n == 8:
        by_state[:, 0, 5], by_state[:, 0, 6] = -c, s
        by_state[:, 1, 5], by_state[:, 1, 6] = -s, -c
    f = np.tile(np.eye(n, dtype=Extended), (sets, 1, 1))
    f[:, :2] += by_state * dt**2 / 2
    f[:, 2:4] += by_state * dt
    f[:, 0, 2], f[:, 1, 3] = dt, dt
    if n == 8:
        f[:, THETA, 7] = -dt
    return f


def fix(z: np.ndarray, lever: np.ndarray, latency: np.ndarray) -> Measurement:
    """Measure the antenna's position z (2,), ``lever`` (2,) m forward and left of the IMU, ``latency`` (s,) s ago."""
    forward, left = lever[:2].astype(Extended)

    def arm(c: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.stack([c * forward - s * left, s * forward + c * left], axis=-1)

    def innovation(mean: np.ndarray) -> np.ndarray:
        return z.astype(Extended) - mean[:, :2] + latency[:, None] * mean[:, 2:4] - arm(*_heading(mean))

    def change(mean: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        turned = arm(*_heading(mean, offsets)) - arm(*_heading(mean))
        return offsets[..., :2] - latency[:, None, None] * offsets[..., 2:4] + turned

    def jacobian(mean: np.ndarray) -> np.ndarray:
        c, s = _heading(mean)
        h = np.zeros((len(mean), 2, mean.shape[1]), dtype=Extended)
        h[:, 0, 0] = h[:, 1, 1] = 1
        h[:, 0, 2] = h[:, 1, 3] = -latency
        h[:, 0, THETA], h[:, 1, THETA] = -s * forward - c * left, c * forward - s * left
        return h

    return Measurement(innovation, change, jacobian)


def linear(z: np.ndarray, states: list[int]) -> Measurement:
    """Measure some of the states."""
    return Measurement(
        innovation=lambda mean: z.astype(Extended) - mean[:, states],
        change=lambda mean, offsets: offsets[..., states],
        jacobian=lambda mean: np.tile(np.eye(mean.shape[1], dtype=Extended)[states], (len(mean), 1, 1)),
    )


def lateral(gz: float, axle: np.ndarray) -> Measurement:
    """Measure zero lateral velocity at the rear axle, ``axle`` (s,) m behind the IMU."""

    def innovation(mean: np.ndarray) -> np.ndarray:
        c, s = _heading(mean)
        rate = Extended(gz) - (mean[:, 7] if mean.shape[1] == 8 else 0)
        return -(c * mean[:, 3] - s * mean[:, 2] - axle * rate)[:, None]

    def change(mean: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        (c0, s0), (c, s) = _heading(mean), _heading(mean, offsets)
        moved = c * offsets[..., 3] - s * offsets[..., 2]
        turned = (c - c0) * mean[..., 3] - (s - s0) * mean[..., 2]
        rate = -offsets[..., 7] if mean.shape[-1] == 8 else 0
        return (moved + turned - axle[:, None] * rate)[..., None]

    def jacobian(mean: np.ndarray) -> np.ndarray:
        c, s = _heading(mean)
        h = np.zeros((len(mean), 1, mean.shape[1]), dtype=Extended)
        h[:, 0, 2], h[:, 0, 3] = -s, c
        h[:, 0, THETA] = -(s * mean[:, 3] + c * mean[:, 2])
        if mean.shape[1] == 8:
            h[:, 0, 7] = axle
        return h

    return Measurement(innovation, change, jacobian)


def odometer(speed: np.ndarray, ax: float, delay: np.ndarray) -> Measurement:
    """Measure the forward velocity ``delay`` (s,) s ago; ``speed`` (s,) m/s."""

    def innovation(mean: np.ndarray) -> np.ndarray:
        c, s = _heading(mean)
        gained = Extended(ax) - (mean[:, 5] if mean.shape[1] == 8 else 0)
        return (speed - (c * mean[:, 2] + s * mean[:, 3]) + delay * gained)[:, None]

    def change(mean: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        (c0, s0), (c, s) = _heading(mean), _heading(mean, offsets)
        moved = c * offsets[..., 2] + s * offsets[..., 3]
        turned = (c - c0) * mean[..., 2] + (s - s0) * mean[..., 3]
        gained = -offsets[..., 5] if mean.shape[-1] == 8 else 0
        return (moved + turned - delay[:, None] * gained)[..., None]

    def jacobian(mean: np.ndarray) -> np.ndarray:
        c, s = _heading(mean)
        h = np.zeros((len(mean), 1, mean.shape[1]), dtype=Extended)
        h[:, 0, 2], h[:, 0, 3] = c, s
        h[:, 0, THETA] = c * mean[:, 3] - s * mean[:, 2]
        if mean.shape[1] == 8:
            h[:, 0, 5] = delay
        return h

    return Measurement(innovation, change, jacobian)
