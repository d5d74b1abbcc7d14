"""FilterPy 2.0.0's UnscentedKalmanFilter on a sigmaswarm time line: the filter that everybody else runs."""

from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter, unscented_transform
from scipy.linalg import cholesky

THETA_FIRST = [4, 0, 1, 2, 3]


def upper_root_theta_first(p: np.ndarray) -> np.ndarray:
    """U with U^T U = P, from the factor with theta put first (FilterPy takes the rows of U as offsets)."""
    root = np.empty_like(p)
    root[:, THETA_FIRST] = cholesky(p[np.ix_(THETA_FIRST, THETA_FIRST)])
    return root


def _newton(s: np.ndarray, dt: float, u: np.ndarray) -> np.ndarray:
    rotation = np.array([[np.cos(s[4]), -np.sin(s[4])], [np.sin(s[4]), np.cos(s[4])]])
    a = rotation @ u[:2]
    return np.concatenate([s[:2] + s[2:4] * dt + a * dt**2 / 2, s[2:4] + a * dt, [s[4] + u[2] * dt]])


class FilterPyUkf:
    """FilterPy's filter for planar5, for one row of a table of parameter sets (see extended_ukf.py).

    The heading is a number on the real line, as in any plain script: f does not wrap it, so nothing needs to.

    Parameters
    ----------
    row : (10,)
    theta_first : bool
        FilterPy's own root of P, or the one of the compiled filter.
    redraw : bool
        False: as FilterPy 1.4.5, whose update pushes the propagated sigma points through h.
    """

    def __init__(self, row: np.ndarray, *, theta_first: bool, redraw: bool = True) -> None:
        alpha, beta, kappa = (float(value) for value in row[:3])
        self.q, self.redraw = np.diag(row[3:8]), redraw
        root: Callable[[np.ndarray], np.ndarray] | None = upper_root_theta_first if theta_first else None
        points = MerweScaledSigmaPoints(5, alpha, beta, kappa, sqrt_method=root)
        self.ukf = UnscentedKalmanFilter(5, 2, dt=1.0, hx=lambda s: s[:2], fx=_newton, points=points)
        self.ukf.R = np.diag(row[8:])

    @property
    def mean(self) -> np.ndarray:
        return self.ukf.x

    @property
    def covariance(self) -> np.ndarray:
        return self.ukf.P

    def restart(self, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.ukf.x, self.ukf.P = mean.copy(), covariance.copy()

    def step(self, timeline: Any, k: int, fix: np.ndarray | None) -> None:
        """Step ``k`` of a `sigmaswarm.drives.timeline.Timeline`; ``fix`` is absorbed at its end."""
        u = np.array([timeline.ax[k], timeline.ay[k], timeline.gz[k]])
        self.ukf.Q = self.q * timeline.q_scale[k]
        if self.redraw:
            self.ukf.predict(dt=timeline.dt[k], u=u)
        else:
            self.ukf.compute_process_sigmas(timeline.dt[k], u=u)
            self.ukf.x, self.ukf.P = unscented_transform(
                self.ukf.sigmas_f, self.ukf.Wm, self.ukf.Wc, self.ukf.Q
            )
        if fix is not None:
            self.ukf.update(fix[:2])
