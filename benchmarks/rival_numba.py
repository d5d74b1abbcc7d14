"""A textbook UKF as one would write it with Numba: plain loops, one filter at a time.

Sigma points are drawn with the Cholesky factor in the order of the states, propagated by the process, and drawn again
for the fix, as in `run_textbook(..., heading_first=False)`; `check` compares the results.
"""

import math

import numpy as np
from numba import njit

from rival_pyswarms import Course
from sigmaswarm import Drive, FilterParameters, clip, run_textbook


@njit(cache=True, error_model="numpy")
def draw(mean, covariance, gamma, points):
    """Write the sigma points, (2n + 1, n)."""
    n = len(mean)
    root = np.zeros((n, n))
    for j in range(n):
        for i in range(j, n):
            total = covariance[i, j]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = math.sqrt(total) if i == j else total / root[j, j]
    for i in range(n):
        points[0, i] = mean[i]
        for j in range(n):
            points[1 + j, i] = mean[i] + gamma * root[i, j]
            points[1 + n + j, i] = mean[i] - gamma * root[i, j]


@njit(cache=True, error_model="numpy")
def predict(mean, covariance, points, gamma, wm, wc, q, dt, ax, ay, gz):
    """Propagate the points by Newton's equations; write mean and covariance."""
    n = len(mean)
    draw(mean, covariance, gamma, points)
    for p in range(len(points)):
        s = points[p]
        sin, cos = math.sin(s[4]), math.cos(s[4])
        east, north = cos * ax - sin * ay, sin * ax + cos * ay
        s[0] += s[2] * dt + 0.5 * east * dt * dt
        s[1] += s[3] * dt + 0.5 * north * dt * dt
        s[2] += east * dt
        s[3] += north * dt
        s[4] += gz * dt
    average(points, wm, mean)
    for i in range(n):
        for j in range(i + 1):
            total = q[i] if i == j else 0.0
            for p in range(len(points)):
                total += wc[p] * (points[p, i] - mean[i]) * (points[p, j] - mean[j])
            covariance[i, j] = covariance[j, i] = total


@njit(cache=True, error_model="numpy")
def average(points, wm, mean):
    """Compute the weighted mean relative to the center point, since the weights are very large for a small alpha."""
    for i in range(len(mean)):
        shift = 0.0
        for p in range(1, len(points)):
            shift += wm[p] * (points[p, i] - points[0, i])
        mean[i] = points[0, i] + shift


@njit(cache=True, error_model="numpy")
def update(mean, covariance, points, gamma, wm, wc, r, zx, zy):
    """Update with a fix; write mean and covariance."""
    n = len(mean)
    draw(mean, covariance, gamma, points)
    z = np.zeros(2)
    average(points, wm, z)
    s11, s12, s22 = r[0], 0.0, r[1]
    cross = np.zeros((n, 2))
    for p in range(len(points)):
        dx, dy = points[p, 0] - z[0], points[p, 1] - z[1]
        s11 += wc[p] * dx * dx
        s12 += wc[p] * dx * dy
        s22 += wc[p] * dy * dy
        for i in range(n):
            cross[i, 0] += wc[p] * (points[p, i] - mean[i]) * dx
            cross[i, 1] += wc[p] * (points[p, i] - mean[i]) * dy
    det = s11 * s22 - s12 * s12
    for i in range(n):
        k1 = (cross[i, 0] * s22 - cross[i, 1] * s12) / det
        k2 = (cross[i, 1] * s11 - cross[i, 0] * s12) / det
        mean[i] += k1 * (zx - z[0]) + k2 * (zy - z[1])
        for j in range(n):
            covariance[i, j] -= k1 * cross[j, 0] + k2 * cross[j, 1]


@njit(cache=True, error_model="numpy")
def run(mean, covariance, gamma, wm, wc, q, r, dt, q_scale, imu, updates, sampled, fixes, track):
    """Run the filter over a course; write ``track``, (n_samples, 5)."""
    points = np.empty((2 * len(mean) + 1, len(mean)))
    n_fixes = n_samples = 0
    for k in range(len(dt)):
        predict(
            mean, covariance, points, gamma, wm, wc, q * q_scale[k], dt[k], imu[k, 0], imu[k, 1], imu[k, 2]
        )
        if updates[k]:
            update(mean, covariance, points, gamma, wm, wc, r, fixes[n_fixes, 0], fixes[n_fixes, 1])
            n_fixes += 1
        if sampled[k]:
            track[n_samples] = mean
            n_samples += 1


def means(course: Course, p: FilterParameters) -> np.ndarray:
    """Return the means at the IMU samples of a course, (n_samples, 5)."""
    n = 5
    gamma2 = p.alpha**2 * (n + p.kappa)
    wm = np.full(2 * n + 1, 0.5 / gamma2)
    wm[0] = 1 - n / gamma2
    wc = wm.copy()
    wc[0] += 1 - p.alpha**2 + p.beta
    track = np.empty((course.n_samples, n))
    mean, covariance = course.initial.mean.copy(), course.initial.covariance.copy()
    q, r = np.array(p.process_noise), np.array(p.measurement_noise)
    steps = (course.dt, course.q_scale, course.imu, course.updates, course.sampled, course.fixes)
    run(mean, covariance, math.sqrt(gamma2), wm, wc, q, r, *steps, track)
    return track


def check(drive: Drive, course: Course, p: FilterParameters, seconds: float) -> None:
    """Raise AssertionError unless the results equal those of the textbook filter."""
    short = clip(drive, drive.imu.time[0], course.initial.time + seconds)
    book = run_textbook(short, p, initial=course.initial, heading_first=False).mean
    ours = means(course, p)[: len(book)]
    turn = np.exp(1j * ours[:, 4]) / np.exp(1j * book[:, 4])  # one heading is wrapped, the other not
    np.testing.assert_allclose(ours[:, :4], book[:, :4], rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.angle(turn), 0.0, atol=1e-6)
