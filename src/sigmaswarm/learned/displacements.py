"""Update a filter with a displacement of the vehicle between two times, 0 and 1.

The measurement

    z = R(theta_0)^T (p_1 - p_0) + noise

depends on the state at both times, as in stochastic cloning (S. Roumeliotis and J. Burdick, ICRA 2002). Here p is the
position, and R(theta) is the rotation from body to local frame. If p_0 were assumed to be known, each update would add
the error of p_0 again. The cross-covariance of the state errors e is Cov(e_1, e_0) = A P_0, since e_1 is A e_0 plus a
part that is independent of e_0. The columns of A are finite differences between runs of the filter, all in one call of
the compiled kernel.
"""

from typing import Any, NamedTuple

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters import tilted
from sigmaswarm.filters.compiled.layout import LANES, N_STATE, R, state_rows
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.packing import definite, pack_states, unpack_states
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, run_steps

_DIFFERENCE_STEP = 1e-3  # step of the finite differences, in standard deviations
GATE = 13.8  # largest accepted NIS of a displacement: 99.9% quantile of chi-square, two degrees of freedom


class DisplacementStart(NamedTuple):
    """State of a filter at the start of a displacement.

    ``rows`` (N_KEPT, columns) is the kernel's state; ``cursor`` (5,) contains the next step, fix, target and speed.
    """

    rows: Array
    cursor: Array


class Displacements:
    """Updates of one filter with displacements."""

    def __init__(self, drive_pass: FilterPass, parameters: FilterParameters) -> None:
        self._pass = drive_pass
        self._model = parameters.kernel
        n = len(FILTERS[self._model].states)
        self._array = KernelArray((parameters,) * (n + 1))
        tilts = FILTERS[self._model].tilts
        self._plus, self._minus = (tilted.plus, tilted.minus) if tilts else (np.add, np.subtract)

    def update(self, begin: DisplacementStart, rows: Array, stop: int, moved: Array, noise: Array) -> bool:
        """Update with a displacement that ends before step ``stop``. Return False if it was rejected.

        ``rows``, (N_KEPT, columns), is modified in place. ``moved``, (2,), m, is the displacement forward and left, in
        the body frame at its start; ``noise`` is its covariance, (2, 2), m2. A displacement is rejected if its NIS is
        too large, if the update would increase the residual, or if the covariance would not be positive definite.
        """
        x0, p0 = self._state(begin.rows)
        x1, p1 = self._state(rows)
        crossed = self._transported(begin, x0, p0, stop) @ p0  # Cov(e1, e0)
        expected = body_displacement(x0, x1)
        step0, step1 = (_DIFFERENCE_STEP * np.sqrt(np.diag(p)) for p in (p0, p1))
        h0 = np.array([body_displacement(self._plus(x0, e), x1) - expected for e in np.diag(step0)]).T / step0
        h1 = np.array([body_displacement(x0, self._plus(x1, e)) - expected for e in np.diag(step1)]).T / step1
        c = p1 @ h1.T + crossed @ h0.T
        both = h1 @ crossed @ h0.T
        s = h1 @ p1 @ h1.T + both + both.T + h0 @ p0 @ h0.T + noise
        innovation = moved - expected
        if not innovation @ np.linalg.solve(s, innovation) <= GATE:
            return False
        gain = np.linalg.solve(s, c.T).T
        mean, covariance = self._plus(x1, gain @ innovation), p1 - gain @ s @ gain.T
        covariance = 0.5 * (covariance + covariance.T)
        begun = self._plus(x0, np.linalg.solve(s, h0 @ p0 + h1 @ crossed).T @ innovation)
        residual = moved - body_displacement(begun, mean)
        # In a linear problem, the residual R S^-1 nu is smaller than nu. With a very uncertain heading, the problem
        # is not linear, and the residual may be larger.
        left, whole = (v @ np.linalg.solve(noise, v) for v in (residual, innovation))
        if left > whole or not definite(covariance[np.newaxis])[0]:
            return False
        columns, state = rows.shape[1], state_rows(self._model)
        means, covariances = (np.broadcast_to(v, (columns, *v.shape)) for v in (mean, covariance))
        rows[state] = pack_states(means, covariances, self._model)[state]
        rows[R.SIN_COS_VALID] = 0.0
        if FILTERS[self._model].tilts:
            rows[R.HEADING] = mean[THETA]
        return True

    def _state(self, rows: Array) -> tuple[Array, Array]:
        mean, covariance = unpack_states(rows[state_rows(self._model), :1], self._model)
        return mean[0], covariance[0]

    def _transported(self, begin: DisplacementStart, x0: Array, p0: Array, stop: int) -> Array:
        """Return A, the transition matrix of errors from the start of the displacement to step ``stop``, (n, n)."""
        n, step = len(x0), _DIFFERENCE_STEP * np.sqrt(np.diag(p0))
        moved = np.array([x0, *(self._plus(x0, e) for e in np.diag(step))])
        moved = np.vstack([moved, np.broadcast_to(x0, (LANES - n - 1, n))])
        rows = np.repeat(begin.rows[:, :1], LANES, axis=1)
        rows[R.SIN_COS_VALID] = 0.0
        rows[:N_STATE] = pack_states(moved, np.broadcast_to(p0, (LANES, n, n)), self._model)
        run_steps(self._pass, self._array, rows, begin.cursor.copy(), stop)
        means, _ = unpack_states(rows[state_rows(self._model)], self._model)
        return np.array([self._minus(mean, means[0]) for mean in means[1 : n + 1]]).T / step


def body_displacement(begin: Array, end: Array) -> Array:
    """Return the displacement (..., 2) between states (..., n), m forward and left in the body frame of ``begin``."""
    return to_body_axes(end[..., 0] - begin[..., 0], end[..., 1] - begin[..., 1], begin[..., THETA])


def to_body_axes(x: Any, y: Any, theta: Any) -> Array:
    """Return the components forward and left, (..., 2), of a vector (x east, y north) at a heading, rad."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([c * x + s * y, c * y - s * x], axis=-1)
