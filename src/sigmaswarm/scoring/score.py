"""Compute the errors of one estimate against truth: the reference definitions in NumPy.

error = estimate - truth, at truth times from the common start of all methods to the last IMU sample. The estimate is
interpolated linearly. If the truth has standard deviations, errors are weighted. This module also detects a constant
offset between truth and fixes.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.windows import Complex
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.drives.gaps import is_known
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.run import Estimate
from sigmaswarm.geodesy import wrap_angle

POSITION_FLOOR = 0.3
"""Standard deviation of truth, m per axis, below which the weight hardly increases.

The value is the accuracy of the best filters with cheap receivers. Without this limit, the parts of a drive under open
sky, where every filter is accurate, would have nearly all of the weight.
"""
HEADING_FLOOR = math.radians(0.3)  # rad, the same limit for the true heading
N_BLOCKS = 8  # parts of a drive; the spread of the offset over them shows the effect of correlated errors
MIN_OFFSET_SIGMAS = 5.0  # smallest ratio of a reported offset to its standard deviation
MIN_OFFSET = 0.3, 0.3  # smallest reported offset: m, and as a fraction of the scatter of the fixes


def weights_at(truth: Truth, time: Array) -> Array | None:
    """Return the weights floor^2 / (sigma^2 + floor^2) of squared position errors at ``time``, s, or None if all are 1.

    sigma^2 is the mean variance of both axes.
    """
    if truth.std is None:
        return None
    std_x, std_y = (np.interp(time, truth.time, std) for std in truth.std)
    return POSITION_FLOOR**2 / ((std_x**2 + std_y**2) / 2 + POSITION_FLOOR**2)


def heading_weights(truth: Truth) -> Array | None:
    """Return the weights of squared heading errors, shape (m,); None if all are 1."""
    return None if truth.std_theta is None else HEADING_FLOOR**2 / (truth.std_theta**2 + HEADING_FLOOR**2)


def root_mean(squares: Array, weights: Array | None = None) -> float:
    """Return the weighted RMS from squared errors; NaN if there are no errors."""
    if not squares.size:
        return float("nan")
    return float(np.sqrt(np.mean(squares) if weights is None else np.average(squares, weights=weights)))


def truth_offset(drive: Drive) -> str:
    """Return a sentence on a constant offset of the fixes from truth, with a remedy; "" if there is no offset.

    The offset is constant in the map frame (east, north) or in the vehicle frame (forward, left). The function chooses
    the frame in which the medians of `N_BLOCKS` parts of the drive agree better.
    """
    gps, truth = drive.gps, drive.truth
    if truth is None or len(truth) < 2 or not np.any(used := is_known(truth, gps.time)):
        return ""
    time = gps.time[used]
    heading = np.exp(1j * np.interp(time, truth.time, np.unwrap(truth.theta)))
    x, y = (np.interp(time, truth.time, column) for column in (truth.x, truth.y))
    arm = complex(*drive.lever_arm)
    error = gps.x[used] - x + 1j * (gps.y[used] - y) - arm * heading
    (world, world_clear), (body, body_clear) = _constant(error), _constant(error / heading)
    offset = world if world_clear > body_clear else body
    scatter = float(np.median(np.abs(error - np.median(error.real) - 1j * np.median(error.imag))))
    least = max(MIN_OFFSET[0], MIN_OFFSET[1] * scatter)
    if max(world_clear, body_clear) < MIN_OFFSET_SIGMAS or abs(offset) < least:
        return ""
    origin = (
        f"if the truth has another origin or datum, import with --origin, or add {world.real:.2f} and "
        f"{world.imag:.2f} m to x and y of truth.csv"
    )
    length = arm + body
    lever = (
        "if the antenna is not at the point to which the truth refers, write "
        f"gps_lever_arm_m = [{length.real:.2f}, {length.imag:.2f}, 0.0] at the top of drive.toml"
    )
    causes = [
        cause
        for cause, clear, other in ((lever, body_clear, world_clear), (origin, world_clear, body_clear))
        if clear > MIN_OFFSET_SIGMAS and clear > other / 2  # a straight road does not distinguish the frames
    ]
    return (
        f"the fixes of {drive.name} have a constant offset of {abs(offset):.2f} m from the truth; all position "
        f"errors contain this offset. It is {world.real:+.2f} m east and {world.imag:+.2f} m north, or "
        f"{body.real:+.2f} m forward and {body.imag:+.2f} m left. Remedy: {'; '.join(causes)}"
    )


def _constant(error: Complex) -> tuple[complex, float]:
    """Return the mean of the medians of `N_BLOCKS` parts (m) and the ratio of this mean to its standard deviation."""
    if len(error) < 2 * N_BLOCKS:
        return 0j, 0.0
    parts = np.array_split(error, N_BLOCKS)
    means = np.array([np.median(part.real) + 1j * np.median(part.imag) for part in parts])
    mean = complex(np.mean(means))
    std = float(np.sqrt(np.sum(np.abs(means - mean) ** 2) / (N_BLOCKS - 1) / N_BLOCKS))
    return mean, abs(mean) / max(std, 1e-9)


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
    dimensions, up to a constant. For c see `sigmaswarm.filters.constants`.
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
