"""Integrals, means, overlapping windows of fixes, and least squares with common and separate unknowns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array

Complex = NDArray[np.complexfloating[Any, Any]]
Values = TypeVar("Values", Array, Complex)

CAUCHY_SCALE = 4.0  # scale of the Cauchy weights, in median residuals
_NODES, _GAUSS = np.polynomial.legendre.leggauss(8)
_PARABOLA = _GAUSS * (1 - _NODES**2) / np.sum(_GAUSS * (1 - _NODES**2))


def integral(time: Array, values: Values) -> Values:
    """Integrate by the trapezoidal rule from the first sample, (n,)."""
    total: Any = np.empty_like(values, shape=len(time))
    total[:1] = 0.0
    steps = values[1:] + values[:-1]
    steps *= 0.5
    steps *= np.diff(time)
    np.cumsum(steps, out=total[1:])
    return total


def smoothed(time: Array, values: Values, at: Array, span: float) -> Values:
    """Average over ``span`` s around times ``at``, with parabolic weights: fit a line to the integral."""
    points = at[:, None] + _NODES * span / 2
    return np.einsum("nk,k->n", np.interp(points, time, values), _PARABOLA)


def moving_mean(rows: Array, count: int) -> Array:
    """Compute the moving mean of rows (r, n), mirrored at their ends.

    The import of `scipy.ndimage.uniform_filter1d` would take longer than all checks.
    """
    left = count // 2
    padded = np.pad(rows, ((0, 0), (left, count - left - 1)), mode="symmetric")
    first = np.cumsum(padded[:, :count], axis=1)[:, -1:]
    return np.cumsum(np.hstack([first, padded[:, count:] - padded[:, :-count]]), axis=1) / count


def without_lines(weight: Array, t: Array) -> Callable[[Array], Array]:
    """Return a function that multiplies angles by ``weight`` and subtracts a straight line in ``t`` from each window.

    All arrays have the shape (w, n): w windows of n fixes.
    """
    q = np.linalg.qr(weight[:, :, None] * np.stack([np.ones_like(t), t], axis=-1))[0]

    def rest(angles: Array) -> Array:
        weighted = (weight * angles)[:, :, None]
        return (weighted - q @ (q.transpose(0, 2, 1) @ weighted))[:, :, 0]

    return rest


def windows_of(time: Array, usable: NDArray[np.bool_], length: float) -> NDArray[np.intp]:
    """Return the indices (w, n) of windows of about ``length`` s that overlap by half and contain no gap."""
    index = np.flatnonzero(usable)
    interval = float(np.median(np.diff(time)))
    count = max(round(length / interval), 8)
    starts = np.arange(0, len(index) - count + 1, count // 2)
    rows = index[starts[:, None] + np.arange(count)]
    return rows[time[rows[:, -1]] - time[rows[:, 0]] <= 1.3 * count * interval]


@dataclass(frozen=True, eq=False)
class Regression:
    """A robust fit of y = sum over k of solution[k] columns[k] + the terms of each window's unknowns."""

    solution: Array  # (k,)
    residual: Complex  # (w, n)
    weight: Array  # (w, n), the robust weight of each value, 0 to 1
    known: Array  # (w, n), the weight of each value without robust weights
    # (w, k, 2n), weighted, orthogonal to the columns `own`; real and imaginary parts alternate
    columns: Array
    left: Array  # (w, 2n), the weighted residuals; real and imaginary parts alternate
    own: int  # number of unknowns of each window

    @cached_property
    def size(self) -> Array:
        """The magnitude of the weighted residual, without robust weights, (w, n)."""
        return np.abs(self.residual) * self.known

    @property
    def cost(self) -> float:
        return float(np.mean(self.size))

    @cached_property
    def covariance(self) -> Array:
        """The covariance (k, k) of the solution, for overlapping windows and correlated residuals."""
        return _covariance(self.columns, self.left, self.own)

    def unexplained(self, k: int) -> float:
        """Return the norm of the part of a column that the other columns do not explain."""
        column, others = self.columns[:, k], np.delete(self.columns, k, axis=1)
        gram = np.sum(others @ others.transpose(0, 2, 1), axis=0)
        along = np.einsum("wkn,wn->k", others, column)
        return float(np.sqrt(max(np.sum(column**2) - along @ pinv(gram) @ along, 0.0)))


def regress(
    y: Complex, columns: Sequence[Complex], own: Sequence[Complex], weight: Array, rounds: int
) -> Regression:
    """Solve robust least squares over windows. ``y``, ``weight`` and each of ``columns`` and ``own`` are (w, n).

    Coefficients of ``columns`` are real and common to all windows; those of ``own`` are complex and differ by window.
    ``weight`` is the inverse of the known part of the standard deviation, up to a factor. Rounds after the first reduce
    the weight of outliers.
    """
    fit = _solve(y, columns, own, weight, np.ones(y.shape))
    for _ in range(rounds - 1):
        usual = max(float(np.median(fit.size)), 1e-9)
        fit = _solve(y, columns, own, weight, 1 / (1 + (fit.size / (CAUCHY_SCALE * usual)) ** 2))
    return fit


def _solve(
    y: Complex, columns: Sequence[Complex], own: Sequence[Complex], weight: Array, robust: Array
) -> Regression:
    """Project out the columns of each window (QR), then solve for the common unknowns.

    Normal equations of scaled columns are accurate enough here. `numpy.linalg.lstsq` takes ten times as long if
    BLAS has two threads, which wait for each other.
    """
    root = weight * np.sqrt(robust)
    q = np.linalg.qr(np.stack([root * c for c in own], axis=-1))[0]

    v = root[:, None] * np.stack([*columns, y], axis=1, dtype=np.complex128)
    v -= (v @ q.conj()) @ q.transpose(0, 2, 1)  # orthogonal to the window's own columns
    rows = v.view(np.float64)  # (w, k + 1, 2n), real and imaginary parts in turn
    gram = np.sum(rows @ rows.transpose(0, 2, 1), axis=0)
    size = np.sqrt(np.diag(gram))[:-1]
    size[size == 0.0] = 1.0
    solution = pinv(gram[:-1, :-1] / np.outer(size, size)) @ (gram[:-1, -1] / size) / size
    left = rows[:, -1] - solution @ rows[:, :-1]
    residual = left.view(np.complex128) / np.maximum(root, 1e-12)
    return Regression(solution, residual, robust, weight, rows[:, :-1], left, q.shape[-1])


def pinv(gram: Array) -> Array:
    """Invert a symmetric matrix (k, k). The result is 0 in directions that the matrix does not determine.

    `numpy.linalg.pinv` has the same result, but takes twice as long for matrices of this size.
    """
    values, vectors = np.linalg.eigh(gram)
    order = np.argsort(np.abs(values))[::-1]
    values, vectors = values[order], vectors[:, order]
    known = np.abs(values) > 1e-12 * np.max(np.abs(values))
    inverse = np.divide(1.0, np.abs(values), where=known, out=np.zeros(len(values)))
    return (vectors * np.sign(values)) @ (inverse[:, None] * vectors.T)


def with_prior(solution: Array, covariance: Array, k: int, mean: float, std: float) -> tuple[Array, Array]:
    """Return the solution and its covariance after a Kalman update with a prior for unknown ``k``."""
    gain = covariance[:, k] / (covariance[k, k] + std**2)
    return solution + gain * (mean - solution[k]), covariance - np.outer(gain, covariance[k])


def _covariance(a: Array, left: Array, own: int) -> Array:
    """Return the covariance of the solution, from the columns (w, k, n) and the residuals (w, n).

    The result is the larger of two estimates: the covariance for white residuals, and the sandwich estimate of White
    (1980) with windows as clusters. It is doubled, since each fix is in two windows.
    """
    inverse = pinv(np.sum(a @ a.transpose(0, 2, 1), axis=0))
    white = inverse * float(np.sum(left**2)) / max(left.size - 2 * own * len(left), 1)
    pull = (a @ left[:, :, None])[:, :, 0]
    sandwich = inverse @ (pull.T @ pull) @ inverse
    ratio = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(white), 1e-300), 1.0))
    return 2 * white * np.outer(ratio, ratio)
