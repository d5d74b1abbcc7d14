"""The unscented filter of `textbook`, compiled with a user's f and h, for one parameter set over one log.

Numba cannot cache a user's function, so each process compiles the kernel at the first use. Loops compile faster than
NumPy expressions. Arrays are separate arguments, since a step takes twice as long with a tuple of arrays.
"""

import math
from collections import namedtuple
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from sigmaswarm.compilation import cached
from sigmaswarm.filters.constants import OUTLIERS, OUTLIERS_SPAN

_TWO_PI = 2 * math.pi

_kernel = cached(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorator of functions that only kernels call; compilation is faster without entry points for Python and C."""
_inlined = njit(error_model="numpy", inline="always")
"""Decorator of functions with a single caller, which LLVM would otherwise optimize twice: alone and inlined."""

_Weights = namedtuple("_Weights", "gamma center_mean center_covariance other")


def build_kernel(
    f: Callable[..., Any],
    h: Callable[..., Any],
    process_noise: Callable[..., Any],
    *,
    diagonal: bool,
) -> Any:
    """Build a filter from a user's functions; the filter is compiled at its first call.

    ``diagonal`` is True if process_noise returns the diagonal of Q. An index out of bounds in a user's function raises
    IndexError.
    """
    user = njit(error_model="numpy", boundscheck=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    f, h, process_noise = (user(getattr(g, "py_func", g)) for g in (f, h, process_noise))
    put = _put_diagonal if diagonal else _put_matrix

    @_inlined
    def predict(mean, covariance, root, drawn, moved, state, weights, dt, u, p, angles):
        """Propagate the sigma points by f, and add Q. Return False if P has no Cholesky factor."""
        if not _draw(mean, covariance, weights.gamma, root, drawn):
            return False
        for k in range(drawn.shape[0]):
            _copy(drawn[k], state)  # a copy: f may work in place
            _copy(f(state, dt, u, p), moved[k])
        _center(moved, drawn, angles, weights, mean)
        put(process_noise(dt, p), covariance)
        _add_products(moved, moved, weights, covariance)
        return True

    @_inlined
    def measure(
        mean, covariance, root, drawn, state, seen, predicted, nu, s, cross, weights, z, noise, p, angles
    ):
        """Compute nu, S and C from new sigma points. Return False if P has no Cholesky factor."""
        if not _draw(mean, covariance, weights.gamma, root, drawn):
            return False
        for k in range(drawn.shape[0]):
            _copy(drawn[k], state)
            _copy(h(state, p), seen[k])
            for i in range(mean.size):
                drawn[k, i] -= mean[i]
        _center(seen, seen[:, :0], angles, weights, predicted)
        for i in range(z.size):
            nu[i] = z[i] - predicted[i]
            if angles[i]:
                nu[i] -= _TWO_PI * np.rint(nu[i] / _TWO_PI)
        _put_matrix(noise, s)
        _add_products(seen, seen, weights, s)
        _clear(cross)
        _add_products(drawn, seen, weights, cross)
        return True

    def run(
        dt, source, updates, records, inputs, measurements, mean0, covariance0, angles, measured_angles,
        scaling, noise, limits, runs, p, means, covariances, nis, nll,
    ):  # fmt: skip
        """Run all steps: write means, covariances, nis and nll; update ``runs``. Return the step that failed, or -1."""
        m = measurements.shape[1]
        n, weights = mean0.size, _weights(mean0.size, scaling)
        mean, covariance, root, state = mean0.copy(), covariance0.copy(), np.zeros((n, n)), np.empty(n)
        drawn, moved, seen = np.empty((2 * n + 1, n)), np.empty((2 * n + 1, n)), np.empty((2 * n + 1, m))
        predicted, nu, cross = np.empty(m), np.empty(m), np.empty((n, m))
        s, root_s = np.empty((m, m)), np.zeros((m, m))
        for step in range(dt.size):
            row, at = updates[step], records[step]
            for i in range(m):
                runs[i, 1] += dt[step]
            if dt[step] > 0 and not predict(
                mean, covariance, root, drawn, moved, state, weights, dt[step], inputs[source[step]], p, angles
            ):  # fmt: skip
                return step
            if row >= 0:
                if not measure(
                    mean, covariance, root, drawn, state, seen, predicted, nu, s, cross, weights,
                    measurements[row], noise, p, measured_angles,
                ):  # fmt: skip
                    return step
                present = _leave_out(measurements[row], nu, s, cross)
                limit = limits[present - 1]
                nis[row], log_det = _whiten(nu, s, cross, root_s)
                if np.isnan(log_det):
                    return step
                share = _limited_share(measurements[row], nis[row], limit, runs)
                _update(mean, covariance, nu, cross, share)
                nll[row] = 0.5 * (_limited(nis[row], limit) + log_det + present * math.log(_TWO_PI))
            if not _finite(mean, covariance):
                return step
            if at >= 0:
                _copy(mean, means[at])
                if covariances.shape[0] > 0:
                    _put_matrix(covariance, covariances[at])
        return -1

    return njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True)(run)


@_kernel
def _weights(n, scaling):
    alpha, beta, kappa = scaling[0], scaling[1], scaling[2]
    gamma2 = alpha**2 * (n + kappa)
    center = 1 - n / gamma2
    return _Weights(math.sqrt(gamma2), center, center + 1 - alpha**2 + beta, 0.5 / gamma2)


@_kernel
def _draw(mean, covariance, gamma, root, sigmas):
    """Write the sigma points: the mean, and the mean plus and minus gamma times each column of the root.

    Return False if P has no Cholesky factor.
    """
    n = mean.size
    if not _root(covariance, root):
        return False
    for i in range(n):
        sigmas[0, i] = mean[i]
        for j in range(n):
            offset = gamma * root[i, j]
            sigmas[1 + j, i] = mean[i] + offset
            sigmas[1 + n + j, i] = mean[i] - offset
    return True


@_kernel
def _root(a, root):
    """Write the Cholesky factor of ``a`` to the lower half of ``root``. Return False if there is none."""
    for j in range(a.shape[0]):
        for i in range(j, a.shape[0]):
            s = a[i, j]
            for k in range(j):
                s -= root[i, k] * root[j, k]
            if i > j:
                root[i, j] = s / root[j, j]
            elif s > 0 and s < np.inf:
                root[j, j] = math.sqrt(s)
            else:
                return False
    return True


@_kernel
def _center(images, points, angles, weights, mean):
    """Write the weighted mean of ``images`` to ``mean``, and subtract the mean from the images.

    For an angle, the difference between an image and the first image is wrapped to within half a turn of the difference
    between the sigma points in ``points`` (of 0 if ``points`` has no columns).
    """
    for i in range(images.shape[1]):
        first, shift = images[0, i], 0.0
        for k in range(images.shape[0]):
            offset = images[k, i] - first
            if angles[i]:
                own = points[k, i] - points[0, i] if points.shape[1] > 0 else 0.0
                offset -= _TWO_PI * np.rint((offset - own) / _TWO_PI)
            images[k, i] = offset
            shift += (weights.center_mean if k == 0 else weights.other) * offset
        for k in range(images.shape[0]):
            images[k, i] -= shift
        mean[i] = first + shift


@_kernel
def _add_products(a, b, weights, out):
    for k in range(a.shape[0]):
        weight = weights.center_covariance if k == 0 else weights.other
        for i in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += weight * a[k, i] * b[k, j]


@_kernel
def _leave_out(z, nu, s, cross):
    """Make the update ignore elements that are NaN. Return the number of the other elements.

    For the elements that are NaN, nu and C become 0, and S becomes the identity. The result then has the same bits as
    that of a filter without these rows of h and R.
    """
    present = 0
    for i in range(z.size):
        if not np.isnan(z[i]):
            present += 1
            continue
        for j in range(z.size):
            s[i, j] = s[j, i] = 0.0
        for j in range(cross.shape[0]):
            cross[j, i] = 0.0
        nu[i], s[i, i] = 0.0, 1.0
    return present


@_kernel
def _whiten(nu, s, cross, root):
    """Replace nu by y = L^-1 nu and C by W = C L^-T, where S = L L^T.

    Return NIS and log det S, or NaN if there is no L.
    """
    n, m = cross.shape
    if not _root(s, root):
        return np.nan, np.nan
    nis, log_det = 0.0, 0.0
    for j in range(m):
        for k in range(j):
            nu[j] -= root[j, k] * nu[k]
            for i in range(n):
                cross[i, j] -= root[j, k] * cross[i, k]
        nu[j] /= root[j, j]
        nis += nu[j] * nu[j]
        log_det += 2 * math.log(root[j, j])
        for i in range(n):
            cross[i, j] /= root[j, j]
    return nis, log_det


@_kernel
def _update(mean, covariance, y, w, share):
    """Compute x + share K nu and P - share K S K^T, with K nu = W y and K S K^T = W W^T."""
    n, m = w.shape
    for j in range(m):
        for i in range(n):
            mean[i] += share * w[i, j] * y[j]
    for i in range(n):
        for j in range(n):
            for k in range(m):
                covariance[i, j] -= share * w[i, k] * w[j, k]


@_kernel
def _limited_share(z, nis, limit, runs):
    """Return the factor of an update: limit / NIS for an outlier, otherwise 1.

    After a long run of outliers, the factor is 1 again: see `Model.robust`.

    ``runs``: see `TextbookModel`.
    """
    lasts = True
    for i in range(z.size):
        if np.isnan(z[i]):
            continue
        if not nis > limit:
            runs[i, 0] = 0.0
            continue
        if runs[i, 0] == 0.0:
            runs[i, 1] = 0.0
        runs[i, 0] += 1.0
        lasts = lasts and runs[i, 0] >= OUTLIERS and runs[i, 1] >= OUTLIERS_SPAN - 1e-6
    return limit / nis if nis > limit and not lasts else 1.0


@_kernel
def _limited(nis, limit):
    """Return the contribution of an NIS to -2 log likelihood: NIS or, above the limit, limit (1 + log(NIS / limit)).

    Above the limit, the derivative of the result with respect to the innovation nu is 2 S^-1 nu limit / NIS, as if S
    were multiplied by NIS / limit.
    """
    return nis if nis <= limit else limit * (1 + math.log(nis / limit))


@_kernel
def _finite(mean, covariance):
    """Return True if all elements are finite: 0 times a finite element is 0, and 0 times inf or NaN is NaN."""
    total = 0.0
    for i in range(mean.size):
        total += 0.0 * mean[i]
        for j in range(mean.size):
            total += 0.0 * covariance[i, j]
    return total == 0.0


@_kernel
def _copy(a, out):
    for i in range(out.size):
        out[i] = a[i]


@_kernel
def _put_matrix(a, out):
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = a[i, j]


@_kernel
def _put_diagonal(a, out):
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = a[i] if i == j else 0.0


@_kernel
def _clear(a):
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            a[i, j] = 0.0
