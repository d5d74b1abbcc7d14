"""FilterPy's filters for comparison with the live filter: one sample at a time, with the same work as our filters.

The models use floats, since NumPy is slow for single numbers. FilterPy has no detection of standstills, so sigmaswarm's
compiled functions detect them; Python code would take longer.
"""

import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from rival_pyswarms import position, process
from sigmaswarm.drives.events import CORNERING
from sigmaswarm.drives.odometer import INTERVAL
from sigmaswarm.drives.standstill import (
    FIX_WINDOW,
    MEANS,
    fixes_are_still,
    is_calm,
    matches_stop,
    new_memory,
)
from sigmaswarm.filters.constants import STANDSTILL_RATE_NOISE
from sigmaswarm.filters.starts import start_of


def slot(time, start, interval):
    """Return the number of the interval that contains a time; a constraint is applied at most once per interval."""
    return math.floor((time - start) / interval + 1e-6)


def process8(s, dt, u):
    """Propagate planar8: `process` with the biases subtracted."""
    ax, ay, yaw_rate = u
    moved = process(s[:5], dt, (ax - s[5], ay - s[6], yaw_rate - s[7]))
    return np.array([*moved, s[5], s[6], s[7]])


def velocity(s):
    return s[2:4]


def gyro_bias(s):
    return s[7:]


class Ukf:
    """FilterPy's unscented filter for a car, with the lateral constraint and standstills if they are set."""

    def __init__(self, parameters, initial):
        p, n = parameters, parameters.n_states
        mean, covariance = start_of(initial, p)
        points = MerweScaledSigmaPoints(n, p.alpha, p.beta, p.kappa)
        fx = process if n == 5 else process8
        self.filter = UnscentedKalmanFilter(n, 2, dt=1.0, hx=position, fx=fx, points=points)
        self.filter.x, self.filter.P = mean, covariance
        self.filter.Q, self.filter.R = np.diag(p.process_noise), np.diag(p.measurement_noise)
        self.p, self.start, self.slots = p, initial.time, [-1, -1]
        self.memory, self.stop = new_memory(), np.array([-np.inf, 0.0, 0.0])
        self.fixes = []

    @property
    def mean(self):
        return self.filter.x

    def predict(self, t, dt, u):
        self.filter.predict(dt=dt, u=u)

    def update(self, t, z):
        self.filter.update(z)
        if self.p.standstill_noise is not None:
            self.fixes.append((t, *z))
            while self.fixes[0][0] < t - FIX_WINDOW - 1.0:
                del self.fixes[0]

    def constrain(self, t, u):
        """Apply the constraints of a car; draw new sigma points first, since FilterPy draws them only in `predict`."""
        p = self.p
        if p.lateral_noise is not None and abs(u[1]) <= CORNERING:
            now = slot(t, self.start, INTERVAL)
            if now != self.slots[0]:
                self.slots[0] = now
                self._absorb(np.zeros(1), p.lateral_noise * np.eye(1), lambda s: self._sideways(s, u[2]))
        if p.standstill_noise is not None and self._stands(t, u):
            now = slot(t, self.start, INTERVAL)
            if now != self.slots[1]:
                self.slots[1] = now
                self._absorb(np.zeros(2), p.standstill_noise * np.eye(2), velocity)
                self._absorb(np.array([u[2]]), STANDSTILL_RATE_NOISE * np.eye(1), gyro_bias)

    def _absorb(self, z, noise, h):
        self.filter.sigmas_f = self.filter.points_fn.sigma_points(self.filter.x, self.filter.P)
        self.filter.update(z, R=noise, hx=h)

    def _sideways(self, s, yaw_rate):
        left = s[3] * math.cos(s[4]) - s[2] * math.sin(s[4])
        return np.array([left - self.p.rear_axle * (yaw_rate - s[7])])

    def _stands(self, t, u):
        if not is_calm(self.memory, t, *u) or not self.fixes:
            return False
        recent = np.array([fix for fix in self.fixes if fix[0] >= t - FIX_WINDOW]).reshape(-1, 3)
        if not fixes_are_still(recent, np.zeros(len(recent)), len(recent), t, np.empty(1)):
            return False
        passed, self.stop[0] = t - self.stop[0], t
        return matches_stop(self.stop[1:], passed, self.memory[MEANS])


class Ekf:
    """FilterPy's extended filter for planar5, without constraints."""

    def __init__(self, parameters, initial):
        mean, covariance = start_of(initial, parameters)
        self.filter = ExtendedKalmanFilter(5, 2)
        self.filter.x, self.filter.P = mean, covariance
        self.filter.Q, self.filter.R = (
            np.diag(parameters.process_noise),
            np.diag(parameters.measurement_noise),
        )
        self.h = np.eye(2, 5)

    @property
    def mean(self):
        return self.filter.x

    def predict(self, t, dt, u):
        before = self.filter.x
        sin, cos = math.sin(before[4]), math.cos(before[4])
        # derivative of the acceleration with respect to the heading
        east, north = -sin * u[0] - cos * u[1], cos * u[0] - sin * u[1]
        f = np.eye(5)
        f[0, 2] = f[1, 3] = dt
        f[2, 4], f[3, 4] = dt * east, dt * north
        f[0, 4], f[1, 4] = 0.5 * dt * f[2, 4], 0.5 * dt * f[3, 4]
        self.filter.F = f
        self.filter.predict()
        self.filter.x = process(before, dt, u)  # in place of F x

    def update(self, t, z):
        self.filter.update(np.array(z), lambda s: self.h, position)

    def constrain(self, t, u):
        pass
