"""The attitude of estimates as quaternions: that of a heading, or of a tilted model's roll, pitch and heading."""

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters import tilted
from sigmaswarm.filters.models import THETA


def quaternions(mean: Array) -> Array:
    """Of means (..., n), (..., 4): x, y, z, w, as files have them."""
    if mean.shape[-1] == tilted.N:
        return np.roll(tilted.quaternion_of(mean), -1, axis=-1)
    half = mean[..., THETA] / 2
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=-1)


def rotations(mean: Array) -> Array:
    """Of means (k, n), (k, 3, 3): from the body to the local frame."""
    if mean.shape[-1] == tilted.N:
        return tilted.rotation(mean)
    c, s = np.cos(mean[:, THETA]), np.sin(mean[:, THETA])
    zero, one = np.zeros_like(c), np.ones_like(c)
    return np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]), -1, 0)
