"""Test functions for optimizers, evaluated at many points; the optimum is not in the middle of the bounds."""

import numpy as np
from scipy.stats import ortho_group

DIMENSIONS = 10
LOW, HIGH = np.full(DIMENSIONS, -5.0), np.full(DIMENSIONS, 5.0)
_RNG = np.random.default_rng(42)
OPTIMUM = _RNG.uniform(-3, 3, DIMENSIONS)
ROTATION = ortho_group.rvs(DIMENSIONS, random_state=_RNG)
AXES = 10 ** (4 * np.arange(DIMENSIONS) / (DIMENSIONS - 1))  # condition number 1e4
OUTSIDE = np.where(np.arange(DIMENSIONS) % 2, 7.0, OPTIMUM)  # every other coordinate is outside the bounds


def sphere(x: np.ndarray) -> np.ndarray:
    return np.sum((x - OPTIMUM) ** 2, axis=1)


def ellipsoid(x: np.ndarray) -> np.ndarray:
    return np.sum(AXES * (x - OPTIMUM) ** 2, axis=1)


def rotated_ellipsoid(x: np.ndarray) -> np.ndarray:
    return np.sum(AXES * ((x - OPTIMUM) @ ROTATION.T) ** 2, axis=1)


def rosenbrock(x: np.ndarray) -> np.ndarray:
    return np.sum(100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2, axis=1)


def ellipsoid_at_bounds(x: np.ndarray) -> np.ndarray:
    """Return the cost of an ellipsoid with condition number 100; the optimum, 0, is on five of the bounds."""
    best = np.clip(OUTSIDE, LOW, HIGH)
    return np.sum(np.sqrt(AXES) * ((x - OUTSIDE) ** 2 - (best - OUTSIDE) ** 2), axis=1)


LANDSCAPES = {
    "sphere": sphere,
    "ellipsoid": ellipsoid,
    "rotated ellipsoid": rotated_ellipsoid,
    "Rosenbrock": rosenbrock,
}
