"""State rows of the compiled kernel: packing, unpacking and checks."""

import math
from functools import cache

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.tables import Indices, Mask
from sigmaswarm.filters import tilted
from sigmaswarm.filters.compiled.layout import N_STATE, P0, R, state_rows
from sigmaswarm.filters.kernels import FILTERS, base_model_name
from sigmaswarm.filters.models import THETA

_FIRST_SHOWN, _LAST_SHOWN = R.SQ_POSITION, R.LOG_DET  # rows of `kernel_array.KernelSums`
RESULT_SUMS = slice(_FIRST_SHOWN, _LAST_SHOWN + 1)


def pack_states(mean: Array, covariance: Array, model: str) -> Array:
    """Return the state rows (..., N_STATE, r) of r means (..., r, n) and covariances (..., r, n, n)."""
    rows, columns = _upper(mean.shape[-1])
    state = np.zeros((*mean.shape[:-2], N_STATE, mean.shape[-2]))
    if FILTERS[model].measures_imu:
        mean, covariance = _turned(mean, covariance, -1.0)
    parts = [mean]
    if FILTERS[model].tilts:
        parts = [mean.copy(), tilted.quaternion_of(mean)]
        parts[0][..., tilted.ATTITUDE] = 0.0  # the error; the quaternion contains the attitude
    packed = np.concatenate([*parts, covariance[..., rows, columns]], axis=-1)
    state[..., state_rows(model), :] = packed.swapaxes(-1, -2)
    return state


def unpack_states(state: Array, model: str) -> tuple[Array, Array]:
    """Return the means (..., r, n) and covariances (..., r, n, n) from the `state_rows` of a model, (..., s, r)."""
    n = len(FILTERS[model].states)
    rows, columns = _upper(n)
    mean, packed = state[..., :n, :].swapaxes(-1, -2).copy(), state[..., -len(rows) :, :].swapaxes(-1, -2)
    if FILTERS[model].tilts:
        mean[..., tilted.ATTITUDE] = tilted.angles_of(state[..., n : n + 4, :].swapaxes(-1, -2))
    covariance = np.empty((*packed.shape[:-1], n, n))
    covariance[..., rows, columns] = packed
    covariance[..., columns, rows] = packed
    return mean, covariance


def state_estimate(state: Array, model: str) -> tuple[Array, Array]:
    """Return the means and covariances like `unpack_states`, without the correlated fix error.

    For a model with roll and pitch, the covariance is that of the angles. For a model with ``measures_imu``, the result
    has planar5's five states, with the velocity east and north, m/s.
    """
    mean, covariance = unpack_states(state, model)
    if FILTERS[model].fix_error:
        model = base_model_name(model)
        n = len(FILTERS[model].states)
        mean, covariance = mean[..., :n], covariance[..., :n, :n]
    if FILTERS[model].measures_imu:
        return _turned(mean[..., : THETA + 1], covariance[..., : THETA + 1, : THETA + 1], 1.0)
    return mean, tilted.as_angles(mean, covariance) if FILTERS[model].tilts else covariance


def _turned(mean: Array, covariance: Array, sign: float) -> tuple[Array, Array]:
    """Rotate a velocity and its covariance (to first order) by the heading, body to local frame (sign 1) or back."""
    c, s = np.cos(mean[..., THETA]), sign * np.sin(mean[..., THETA])
    vx, vy = mean[..., 2], mean[..., 3]
    turned, jacobian = mean.copy(), np.zeros_like(covariance) + np.eye(mean.shape[-1])
    turned[..., 2], turned[..., 3] = c * vx - s * vy, s * vx + c * vy
    jacobian[..., 2, 2], jacobian[..., 2, 3], jacobian[..., 2, THETA] = c, -s, -sign * turned[..., 3]
    jacobian[..., 3, 2], jacobian[..., 3, 3], jacobian[..., 3, THETA] = s, c, sign * turned[..., 2]
    turned_covariance = jacobian @ covariance @ jacobian.swapaxes(-1, -2)
    return turned, (turned_covariance + turned_covariance.swapaxes(-1, -2)) / 2


@cache
def _upper(n: int) -> tuple[Indices, Indices]:
    """Return the row and column indices of the upper triangle, column by column, as the kernel packs it."""
    columns, rows = np.tril_indices(n)
    return rows, columns


def sound_columns(rows: Array, model: str) -> Mask:
    """Return a mask (m, r), True where the final rows (m, N_KEPT, r) show no failure and a positive definite P."""
    sound = np.empty((len(rows), rows.shape[2]), dtype=np.bool_)
    _find_definite(rows, P0, len(FILTERS[model].states), R.OK, sound)
    return sound


def definite(covariance: Array) -> Mask:
    """Return True where covariances (..., n, n) are positive definite up to rounding.

    The test adds 1e-9 to the diagonal of the correlation matrix. If all pivots are then positive, the eigenvalues of
    the correlation matrix are above -1e-9.
    """
    n = covariance.shape[-1]
    packed = covariance[(..., *_upper(n))].reshape(-1, n * (n + 1) // 2, 1)
    result = np.empty((len(packed), 1), dtype=np.bool_)
    _find_definite(packed, 0, n, -1, result)
    return result.reshape(covariance.shape[:-2])


@cached(nogil=True, error_model="numpy")
def _find_definite(rows: Array, first: int, n: int, ok: int, definite: Mask) -> None:
    """Find positive definite covariances (n, n), packed in rows (m, s, r) from row ``first`` on, as in `_upper`.

    ``ok`` is the row that must be 1 (the filter never failed); the state and sums must then also be finite. If ``ok``
    is -1, the rows contain only covariances. The results are written to ``definite``, (m, r).
    """
    scale, a = np.empty(n), np.empty((n, n))
    for m in range(rows.shape[0]):
        for column in range(rows.shape[2]):
            sound, row = True, first
            for j in range(n):
                for i in range(j + 1):
                    a[i, j] = rows[m, row, column]
                    sound &= math.isfinite(a[i, j])
                    row += 1
                scale[j] = math.sqrt(a[j, j]) if a[j, j] > 0.0 else math.nan
            if ok >= 0:
                sound &= rows[m, ok, column] == 1.0
                for r in range(first):
                    sound &= math.isfinite(rows[m, r, column])
                for r in range(_FIRST_SHOWN, _LAST_SHOWN + 1):
                    sound &= math.isfinite(rows[m, r, column])
            for i in range(n):
                for j in range(i, n):
                    a[i, j] /= scale[i] * scale[j]
                a[i, i] += 1e-9
            for k in range(n):
                sound &= a[k, k] > 0.0
                for i in range(k + 1, n):
                    factor = a[k, i] / a[k, k]
                    for j in range(i, n):
                        a[i, j] -= factor * a[k, j]
            definite[m, column] = sound
