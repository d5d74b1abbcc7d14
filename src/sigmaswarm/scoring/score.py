"""Compute the errors of one estimate against truth: the reference definitions in NumPy.

error = estimate - truth, at truth times from the common start of all methods to the last IMU sample. The estimate is
interpolated linearly. If the truth has standard deviations, errors are weighted: see `truth.py`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.drives.gaps import is_known
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.run import Estimate
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.truth import heading_weights, root_mean, weights_at

MIN_HEADING_SPEED = 2.0  # m/s, true speed
PIECE = 100_000  # estimates scored at once, to limit the memory


@dataclass(frozen=True)
class Score:
    """Errors of a method on one drive; undefined errors are NaN.

    Attributes
    ----------
    position_rmse : m, sqrt(mean(ex^2 + ey^2)) at truth times
    position_median, position_95 : m, the 50% and 95% quantiles of sqrt(ex^2 + ey^2) at truth times
    heading_rmse : rad, RMS of the wrapped error where the true speed is over 2 m/s
    outage_drift : m, RMS of the position errors at the ends of outages
    short_outage_drift, long_outage_drift : m, like outage_drift, for outages of 1 s and of 30 s
    fix_rmse : m, RMS residual of the fixes after their update (the paper's equation 4)
    forecast_rmse : m, RMS innovation of fixes hidden in windows of 3 to 5 s
    innovation_nll : nats, mean over the fixes of -ln N(nu; 0, S), before each update
    innovation_t : nats, mean of `negative_log_t` over the fixes, before each update, with v = 4
    forecast_t : nats, mean of `negative_log_t` over the hidden fixes of ``forecast_rmse``, with v = 8
    mean_nis : mean of nu^T S^-1 nu over the fixes; 2 if the covariance is correct
    mean_nees : mean of e^T P^-1 e of the position; 2 if the covariance is correct. P includes the variance of truth
    failed : bool
    """

    position_rmse: float = math.nan
    heading_rmse: float = math.nan
    outage_drift: float = math.nan
    fix_rmse: float = math.nan
    forecast_rmse: float = math.nan
    innovation_nll: float = math.nan
    innovation_t: float = math.nan
    forecast_t: float = math.nan
    mean_nis: float = math.nan
    mean_nees: float = math.nan
    position_median: float = math.nan
    position_95: float = math.nan
    short_outage_drift: float = math.nan
    long_outage_drift: float = math.nan
    failed: bool = False


def negative_log_t(innovation: Array, covariance: Array, dof: float, scale: float) -> Array:
    """Return the negative log-likelihood (nats) of innovations under a heavy-tailed distribution.

    The value is ln 2 pi + ln det S / 2 + (v + 2) / 2 ln(1 + NIS / c), shape (f,), where v is ``dof`` and c is
    ``scale``. Innovations have shape (f, 2), m, and S has shape (f, 2, 2), m2. With c = v, this is Student's t in two
    dimensions, up to a constant. For c see `sigmaswarm.filters.student`.
    """
    nis = np.einsum("fi,fi->f", innovation, np.linalg.solve(covariance, innovation[..., None])[..., 0])
    half_log_det = 0.5 * np.log(np.linalg.det(covariance))
    return np.asarray(np.log(2 * np.pi) + half_log_det + 0.5 * (dof + 2) * np.log1p(nis / scale))


class PieceErrors:
    """Errors against truth of an estimate that arrives in pieces; ``initial`` is the initial state of the method."""

    def __init__(self, truth: Truth, initial: InitialState) -> None:
        self._truth = truth
        self._first = self._next = int(np.searchsorted(truth.time, initial.time, side="left"))
        self._time, self._pose = initial.time, initial.mean[: THETA + 1].copy()
        self._position_errors: list[Array] = []
        self._variance: list[Array] = []
        self._heading_errors: list[Array] = []

    def add(self, time: Array, mean: Array, variance: Array | None = None) -> None:
        """Add times (r,), s, state means (r, n) and, optionally, position variances (r,), m2."""
        truth, first = self._truth, self._next
        self._next = int(np.searchsorted(truth.time, time[-1], side="right"))
        at, nodes = slice(first, self._next), np.concatenate([[self._time], time])
        pose = np.vstack([self._pose, mean[:, : THETA + 1]])
        pose[:, THETA] = np.unwrap(pose[:, THETA])
        x, y, theta = (np.interp(truth.time[at], nodes, pose[:, i]) for i in (0, 1, THETA))
        self._position_errors.append(np.hypot(x - truth.x[at], y - truth.y[at]))
        self._heading_errors.append(wrap_angle(theta - truth.theta[at]))
        if variance is not None:
            self._variance.append(np.interp(truth.time[at], time, variance))
        self._time, self._pose = time[-1], pose[-1]

    @property
    def errors(self) -> tuple[Array, Array, Array]:
        """Times of truth so far (s), and the variances (m2) and position errors (m) at these times."""
        none = np.empty(0)
        variance, error = (np.concatenate([none, *of]) for of in (self._variance, self._position_errors))
        return self._truth.time[self._first : self._next], variance, error

    @property
    def score(self) -> Score:
        if not self._position_errors:
            return Score()
        truth, scored = self._truth, slice(self._first, self._next)
        fast = np.hypot(truth.vx[scored], truth.vy[scored]) > MIN_HEADING_SPEED
        heading_error, weights = np.concatenate(self._heading_errors)[fast], heading_weights(truth)
        score = _position_score(np.concatenate(self._position_errors), weights_at(truth, truth.time[scored]))
        weights = None if weights is None else weights[scored][fast]
        return replace(score, heading_rmse=root_mean(heading_error**2, weights))


def truth_at(truth: Truth, time: Array) -> tuple[Array, Array]:
    """Return the true x and y (m), linearly interpolated; NaN at times without truth."""
    known = is_known(truth, time)
    x = np.where(known, np.interp(time, truth.time, truth.x), np.nan)
    y = np.where(known, np.interp(time, truth.time, truth.y), np.nan)
    return x, y


def distance_from(truth: Truth, time: Array, x: Array, y: Array) -> Array:
    true_x, true_y = truth_at(truth, time)
    return np.hypot(x - true_x, y - true_y)


def score_estimate(drive: Drive, estimate: Estimate) -> Score:
    """Score position and heading; NaN if there is no truth."""
    failed = estimate.failure is not None
    if drive.truth is None:
        return Score(failed=failed)
    errors = PieceErrors(drive.truth, estimate.initial)
    for first in range(0, len(estimate.time), PIECE):
        part = slice(first, first + PIECE)
        errors.add(estimate.time[part], estimate.mean[part])
    return replace(errors.score, failed=failed)


def score_raw_gps(drive: Drive, initial: InitialState) -> Score:
    """Score the raw fixes at their times after the common start."""
    if drive.truth is None:
        return Score()
    gps = drive.gps.select((drive.gps.time >= initial.time) & (drive.gps.time <= drive.imu.time[-1]))
    error = distance_from(drive.truth, gps.time, gps.x, gps.y)
    known = np.isfinite(error)
    return _position_score(error[known], weights_at(drive.truth, gps.time[known]))


def _position_score(errors: Array, weights: Array | None) -> Score:
    """Return RMSE and quantiles (linear between ranks) of errors (n,) in meters; NaN if there are no errors."""
    median, high = np.quantile(errors, [0.5, 0.95]).tolist() if errors.size else (math.nan, math.nan)
    return Score(root_mean(errors**2, weights), position_median=median, position_95=high)
