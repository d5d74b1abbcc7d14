"""Compiled backward pass of Rauch, Tung and Striebel over the logged steps of one filter, from the last to the first.

    G   = P A^T (P-)^-1
    m^s = m + G (m^s' - m-)
    P^s = P + G (P^s' - P-) G^T

A is the transition of a step: see `transition`. m and P are the filtered mean and covariance before the step, m- and P-
the predicted mean and covariance after the step. m^s and P^s are the smoothed values before the step, m^s' and P^s'
those after the step. X = G^T solves P- X = A P. For a model with roll and pitch, `tilted` defines differences and sums.
`filters.smoothing.smooth` lists the sources.
"""

import math

import numpy as np
from numba import njit

from sigmaswarm.compilation import call_once
from sigmaswarm.filters.compiled.lanes import OPTIONS
from sigmaswarm.filters.compiled.layout import QUATERNION, state_rows
from sigmaswarm.filters.compiled.run import cached_by_sources
from sigmaswarm.filters.compiled.transition import COEFFICIENTS, TRANSITIONS, phi_index
from sigmaswarm.filters.compiled.unroll import unrolled
from sigmaswarm.filters.kernels import FILTERS, base_model_name


def _plain(function, **known):
    return njit(unrolled(function, **known), **OPTIONS)


def _transition_times(move, p, ap, *, n, coefficients, transition):
    """Compute A P for the n states without the fix error.

    ``move`` contains the length of the step and the coefficients of A.
    """
    f = tuple(move[1 + k] for k in coefficients)
    for c in range(p.shape[1]):
        moved = transition(f, move[0], tuple(p[k, c] for k in range(n)))
        for k in range(n):
            ap[k, c] = moved[k]


def _unpack_covariance(state, p, *, n, first):
    """Write the covariance (n, n) to ``p`` from its upper triangle, stored column by column in ``state``."""
    at = first
    for b in range(n):
        for a in range(b + 1):
            p[a, b] = p[b, a] = state[at]
            at += 1


def _solve(s, x, *, n):
    """Replace x (n, n) by S^-1 x, and the symmetric S (n, n) by its Cholesky factor."""
    for a in range(n):
        for b in range(a):
            s[a, a] -= s[a, b] * s[a, b]
        s[a, a] = math.sqrt(s[a, a])
        one = 1.0 / s[a, a]
        for c in range(a + 1, n):
            for b in range(a):
                s[c, a] -= s[c, b] * s[a, b]
            s[c, a] *= one
    for a in range(n):
        one = 1.0 / s[a, a]
        for b in range(a):
            for c in range(n):
                x[a, c] -= s[a, b] * x[b, c]
        for c in range(n):
            x[a, c] *= one
    for a in range(n - 1, -1, -1):
        one = 1.0 / s[a, a]
        for b in range(a + 1, n):
            for c in range(n):
                x[a, c] -= s[b, a] * x[b, c]
        for c in range(n):
            x[a, c] *= one


@_plain
def _turn_between(q, p, error):
    """Write the rotation vector e with q = exp(e) p, for quaternions (4,), to elements 8, 9 and 4 of the error."""
    w = q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3]
    x = -q[0] * p[1] + q[1] * p[0] - q[2] * p[3] + q[3] * p[2]
    y = -q[0] * p[2] + q[1] * p[3] + q[2] * p[0] - q[3] * p[1]
    z = -q[0] * p[3] - q[1] * p[2] + q[2] * p[1] + q[3] * p[0]
    if w < 0.0:  # the same attitude by the shorter rotation
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    k = 2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0
    error[8], error[9], error[4] = k * x, k * y, k * z


@_plain
def _turned(q, x, y, z, out):
    """Write the quaternion q, rotated from the left by the rotation vector (x, y, z), to ``out``."""
    angle = 0.5 * math.sqrt(x * x + y * y + z * z)
    k = 0.5 * math.sin(angle) / angle if angle > 0.0 else 0.5
    c, x, y, z = math.cos(angle), k * x, k * y, k * z
    w0 = c * q[0] - x * q[1] - y * q[2] - z * q[3]
    w1 = c * q[1] + x * q[0] + y * q[3] - z * q[2]
    w2 = c * q[2] - x * q[3] + y * q[0] + z * q[1]
    w3 = c * q[3] + x * q[2] - y * q[1] + z * q[0]
    one = 1.0 / math.sqrt(w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3)
    out[0], out[1], out[2], out[3] = one * w0, one * w1, one * w2, one * w3


def _step_back(
    before, noted, behind, work, *, n, n_state, first, tilted, phi, transition_times, unpack_covariance, solve
):
    """Smooth one step: replace the smoothed state after the step, ``behind`` (n_state,), by that before the step."""
    prior = noted[n_state : 2 * n_state]
    p, change, x, s = work[0], work[1], work[2], work[3]
    error, shift = work[4, 0], work[4, 1]
    unpack_covariance(before, p)
    transition_times(noted[2 * n_state :], p, x)
    if phi:
        for b in (n - 2, n - 1):
            for a in range(n):
                x[b, a] = noted[2 * n_state + phi] * p[b, a]
    unpack_covariance(prior, s)
    unpack_covariance(behind, change)
    for a in range(n):
        error[a] = behind[a] - prior[a]
        for b in range(n):
            change[a, b] -= s[a, b]
    if tilted:
        _turn_between(behind[n:first], prior[n:first], error)
    solve(s, x)  # X = G^T
    for a in range(n):
        shift[a] = 0.0
    for b in range(n):
        for a in range(n):
            shift[a] += x[b, a] * error[b]
    for a in range(n):
        behind[a] = before[a] + shift[a]
    if tilted:
        _turned(before[n:first], shift[8], shift[9], shift[4], behind[n:first])
        behind[8] = behind[9] = behind[4] = 0.0
    for a in range(n):  # (P^s' - P-) X
        for b in range(n):
            s[a, b] = 0.0
        for c in range(n):
            for b in range(n):
                s[a, b] += change[a, c] * x[c, b]
    for c in range(n):
        for a in range(n):
            for b in range(n):
                p[a, b] += x[c, a] * s[c, b]
    at = first
    for b in range(n):
        for a in range(b + 1):
            behind[at] = 0.5 * (p[a, b] + p[b, a])
            at += 1


def _backwards(step_log, start, ends, started, sampled, behind, out, *, n, step_back):
    work = np.empty((5, n, n))
    written, starts = out.shape[0], started.shape[0]
    for s in range(step_log.shape[0] - 1, -1, -1):
        if sampled[s]:
            written -= 1
            out[written] = behind
        if starts > 0 and ends[starts - 1] == s:
            starts -= 1
            behind[:] = step_log[s, : len(behind)]
        before = step_log[s - 1] if s > 0 else start
        if starts > 0 and ends[starts - 1] == s - 1:
            before = started[starts - 1]
        step_back(before, step_log[s], behind, work)


@call_once
def _kernel_of(name):
    n, tilted = len(FILTERS[name].states), int(FILTERS[name].tilts)
    first = n + (len(QUATERNION) if tilted else 0)

    def known():
        own = base_model_name(name)
        transition_times = _plain(
            _transition_times, n=len(FILTERS[own].states), coefficients=range(len(COEFFICIENTS[own])),
            transition=_plain(TRANSITIONS[own]),
        )  # fmt: skip
        step_back = _plain(
            _step_back, n=n, n_state=len(state_rows(name)), first=first, tilted=tilted, phi=phi_index(name),
            transition_times=transition_times,
            unpack_covariance=_plain(_unpack_covariance, n=n, first=first), solve=_plain(_solve, n=n),
        )  # fmt: skip
        return {"n": n, "step_back": step_back}

    return cached_by_sources(_backwards, f"{name}, backwards", known)


def smooth_back(name, step_log, start, ends, started, sampled, behind, out):
    """Smooth the logged steps, starting from the smoothed state after the last step.

    Parameters
    ----------
    name : name of the kernel of the forward pass
    step_log : (k, t) `transition.logged_rows` of each step
    start : (s,) the filter's `state_rows` before the first step
    ends, started : (a,) int, (a, s) the steps after which the filter was reset, and the states after these resets;
        smoothed states before a reset do not depend on later steps
    sampled : (k,) bool: the steps whose smoothed states are returned
    behind : (s,) changed from the smoothed state after the last step to that before the first step
    out : (r, s) written: the smoothed states after the ``sampled`` steps
    """
    _kernel_of(name)(step_log, start, ends, started, sampled, behind, out)
