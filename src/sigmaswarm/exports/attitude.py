"""Attitudes of estimates, and velocities in body axes. In planar models, roll and pitch are 0."""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters import tilted
from sigmaswarm.filters.models import THETA


def tilt_indices(n: int) -> tuple[int, ...]:
    """Return the indices of roll and pitch in a state of n numbers; empty for planar models."""
    return (tilted.ROLL, tilted.PITCH) if n == tilted.N else ()


def quaternions(mean: Array) -> Array:
    """Return the quaternions (..., 4) of means (..., n), in the order of the exported files: x, y, z, w."""
    if tilt_indices(mean.shape[-1]):
        return np.roll(tilted.quaternion_of(mean), -1, axis=-1)
    half = mean[..., THETA] / 2
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=-1)


def rotations(mean: Array) -> Array:
    """Return the rotation matrices (k, 3, 3) from body to local frame for means (k, n)."""
    if tilt_indices(mean.shape[-1]):
        return tilted.rotation(mean)
    c, s = np.cos(mean[:, THETA]), np.sin(mean[:, THETA])
    zero, one = np.zeros_like(c), np.ones_like(c)
    return np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]), -1, 0)


def body_velocity(mean: Array) -> tuple[Array, Array]:
    """Return the velocity along the body axes x and y, (k, 2) m/s, for means (k, n), and its Jacobian (k, 2, 3 or 5).

    The velocity is R^T (vx, vy, vz), with vz such that the velocity along the body's z axis is 0. The columns of the
    Jacobian are vx, vy, theta and, if the model has them, roll and pitch.
    """
    c, s, vx, vy = np.cos(mean[:, THETA]), np.sin(mean[:, THETA]), mean[:, 2], mean[:, 3]
    ahead, left = c * vx + s * vy, c * vy - s * vx  # planar
    tilts = tilt_indices(mean.shape[1])
    roll, pitch = mean[:, tilts].T if tilts else np.zeros((2, len(mean)))
    cr, cp, tr, tp = np.cos(roll), np.cos(pitch), np.tan(roll), np.tan(pitch)
    velocity = np.stack([ahead / cp - tp * tr * left, left / cr], axis=-1)
    forwards = [c / cp + tp * tr * s, s / cp - tp * tr * c, left / cp + tp * tr * ahead]
    leftwards = [-s / cr, c / cr, -ahead / cr]
    if tilts:
        forwards += [-tp / cr**2 * left, tp / cp * ahead - tr / cp**2 * left]
        leftwards += [tr / cr * left, 0 * left]
    return velocity, np.stack([np.stack(forwards, axis=-1), np.stack(leftwards, axis=-1)], axis=1)
