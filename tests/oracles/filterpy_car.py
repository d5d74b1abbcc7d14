"""Filters of FilterPy 2.0.0 on a timeline of sigmaswarm."""

from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import (
    ExtendedKalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
    unscented_transform,
)
from scipy.linalg import cholesky

from oracles.extended import Extended
from oracles.extended_car import Measurement, fix, lateral, linear, newton_jacobian
from sigmaswarm.drives.events import FIX, LATERAL, STANDSTILL, VELOCITY
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.parameters import FilterParameters

Function = Callable[[np.ndarray], np.ndarray]


def upper_root_theta_first(p: np.ndarray) -> np.ndarray:
    """Return U with U^T U = P, from the factor with theta first (FilterPy uses the rows of U as offsets)."""
    order = [4, 0, 1, 2, 3, 5, 6, 7][: len(p)]
    root = np.empty_like(p)
    root[:, order] = cholesky(p[np.ix_(order, order)])
    return root


def _newton(s: np.ndarray, dt: float, u: np.ndarray) -> np.ndarray:
    if len(s) == 8:
        u = u - s[5:]
    rotation = np.array([[np.cos(s[4]), -np.sin(s[4])], [np.sin(s[4]), np.cos(s[4])]])
    a = rotation @ u[:2]
    return np.concatenate([s[:2] + s[2:4] * dt + a * dt**2 / 2, s[2:4] + a * dt, [s[4] + u[2] * dt], s[5:]])


def _unseen(n: int, dt: float, gap: float) -> np.ndarray:
    """Return the covariance of the unknown motion in a gap of the IMU: 1 m/s2 per axis and 0.1 rad/s."""
    added = np.zeros((n, n))
    added[:4, :4] = np.kron([[dt**2 / 4, dt / 2], [dt / 2, 1.0]], np.eye(2)) * gap * dt
    added[4, 4] = 0.1**2 * gap * dt
    return added


def _velocity(s: np.ndarray) -> np.ndarray:
    return s[2:4]


class FilterPyCar:
    """FilterPy's unscented or extended filter for a car; the Jacobians are those of the oracle.

    The heading is not wrapped, since f does not wrap it.

    Parameters
    ----------
    timeline : Timeline
    p : FilterParameters
        Of kind "ukf" or "ekf", without a gate.
    theta_first : bool
        FilterPy's root of P, or that of the compiled filter.
    redraw : bool
        False: as in FilterPy 1.4.5, whose update propagates the predicted sigma points through h.
    """

    def __init__(
        self, timeline: Timeline, p: FilterParameters, *, theta_first: bool, redraw: bool = True
    ) -> None:
        self.line, self.p, self.redraw = timeline, p, redraw
        self.q = np.diag(p.process_noise)
        root = upper_root_theta_first if theta_first else None
        n = p.n_states
        points = MerweScaledSigmaPoints(n, p.alpha, p.beta, p.kappa, sqrt_method=root)
        self.filter: Any = (
            ExtendedKalmanFilter(n, 2)
            if p.kind == "ekf"
            else UnscentedKalmanFilter(n, 2, dt=1.0, hx=lambda s: s[:2], fx=_newton, points=points)
        )

    @property
    def mean(self) -> np.ndarray:
        return self.filter.x

    @property
    def covariance(self) -> np.ndarray:
        return self.filter.P

    def restart(self, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.filter.x, self.filter.P = mean.copy(), covariance.copy()

    def step(self, i: int, happens: int, z: np.ndarray | None) -> None:
        """Run step i of the timeline: predict, then update with the measurements in ``happens``."""
        p, line, gz = self.p, self.line, self.line.gz[i]
        self._predict(i)
        self._first, none = True, np.zeros(2)
        if happens & FIX and z is not None:
            by_hand = fix(z, line.lever, np.array([p.latency]))
            self._update(z[:2], self._antenna, by_hand, np.diag(p.measurement_noise))
            if happens & VELOCITY:
                self._update(z[2:4], _velocity, linear(none, [2, 3]), p.velocity_noise * np.eye(2))
        if happens & LATERAL:
            arm = p.rear_axle - p.tire_slip * float(self.mean[2:4] @ self.mean[2:4])
            by_hand = lateral(gz, np.array([arm]))
            self._update(none[:1], lambda s: self._sideways(s, gz, arm), by_hand, p.lateral_noise * np.eye(1))
        if happens & STANDSTILL:
            self._update(none, _velocity, linear(none, [2, 3]), p.standstill_noise * np.eye(2))
            if len(self.mean) == 8:
                rate, noise = linear(none, [7]), np.radians(0.5) ** 2 * np.eye(1)
                self._update(np.array([gz]), lambda s: s[7:], rate, noise)

    def _antenna(self, s: np.ndarray) -> np.ndarray:
        cos, sin, (forward, left) = np.cos(s[4]), np.sin(s[4]), self.line.lever[:2]
        arm = np.array([cos * forward - sin * left, sin * forward + cos * left])
        return s[:2] + arm - self.p.latency * s[2:4]

    def _sideways(self, s: np.ndarray, gz: float, arm: float) -> np.ndarray:
        rate = gz - s[7] if len(s) == 8 else gz
        return np.array([s[3] * np.cos(s[4]) - s[2] * np.sin(s[4]) - arm * rate])

    def _predict(self, i: int) -> None:
        line, ours = self.line, self.filter
        u, dt = np.array([line.ax[i], line.ay[i], line.gz[i]]), line.dt[i]
        ours.Q = self.q * line.q_scale[i] + _unseen(len(ours.x), dt, line.gap[i])
        if self.p.kind == "ekf":
            ours.F = newton_jacobian(ours.x[None].astype(Extended), Extended(dt), u)[0].astype(float)
            moved = _newton(ours.x, dt, u)
            ours.predict()
            ours.x = moved  # instead of F x
        elif self.redraw:
            ours.predict(dt=dt, u=u)
        else:
            ours.compute_process_sigmas(dt, u=u)
            ours.x, ours.P = unscented_transform(ours.sigmas_f, ours.Wm, ours.Wc, ours.Q)
        self.prior = ours.P

    def _update(self, z: np.ndarray, h: Function, by_hand: Measurement, r: np.ndarray) -> None:
        if self.p.kind == "ekf":
            self.filter.update(
                z, lambda s: by_hand.jacobian(s[None].astype(Extended))[0].astype(float), h, R=r
            )
            return
        if not self._first:  # FilterPy draws sigma points only in predict
            self.filter.sigmas_f = self.filter.points_fn.sigma_points(self.mean, self.covariance)
        self.filter.update(z, R=r, hx=h)
        self._first = False
