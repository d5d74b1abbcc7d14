"""A Kalman filter that uses only the fixes: constant velocity with white acceleration, no IMU.

Source of the model: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 6.2.2.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD
from sigmaswarm.drives.timeline import FIX_VAR_X, FIX_X, Timeline
from sigmaswarm.filters.filter_run import EstimateChunk
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.filters.run import whole_pass

UNKNOWN_SPEED = 30.0  # m/s, standard deviation per axis before the first fix
FIRST_GUESS = (0.0, 0.0)  # log10 of the two noise parameters at the start of the search


@dataclass(frozen=True)
class MotionNoise:
    """Noise parameters of the filter without an IMU."""

    acceleration: float  # m2/s3, spectral density on each axis
    fix: float  # factor of the fixes' stated variances, or of 2.1^2 m2 if some are not stated

    @classmethod
    def typical(cls, noises: Iterable["MotionNoise"]) -> "MotionNoise":
        """Return the medians of the noise parameters of several drives, computed from logarithms."""
        density, fix = np.exp(np.median([(np.log(n.acceleration), np.log(n.fix)) for n in noises], axis=0))
        return cls(float(density), float(fix))


@cached(nogil=True)
def _filter(
    dt: Array, fixes: Array, variance: Array, density: float, start: Array, states: Array
) -> float:  # pragma: no cover
    """Filter fixes (k, 2). Return minus twice the log-likelihood, without its constant.

    ``states`` (k, 7) receives x, y, vx, vy, P_xx, P_xv and P_vv after each fix.
    """
    x, y, u, v, pp, pv, vv = start
    cost = 0.0
    for k in range(len(dt)):
        t = dt[k]
        x, y = x + t * u, y + t * v
        pp = pp + 2.0 * t * pv + t * t * vv + density * t * t * t / 3.0
        pv = pv + t * vv + density * t * t / 2.0
        vv = vv + density * t
        s = pp + variance[k]
        ex, ey = fixes[k, 0] - x, fixes[k, 1] - y
        cost += (ex * ex + ey * ey) / s + 2.0 * np.log(s)
        gain, gain_v = pp / s, pv / s
        x, y, u, v = x + gain * ex, y + gain * ey, u + gain_v * ex, v + gain_v * ey
        pp, pv, vv = (1.0 - gain) * pp, (1.0 - gain) * pv, vv - gain_v * pv
        states[k] = x, y, u, v, pp, pv, vv
    return cost


def _variances(line: Timeline) -> Array:
    """Return the variance of each fix per axis, m2; a typical variance if not all fixes have stated variances."""
    stated = line.fixes[:, FIX_VAR_X : FIX_VAR_X + 2].mean(axis=1)
    return stated if line.states_accuracy else np.full(len(stated), UNSTATED_GPS_STD**2)


def fit_noise(drive_pass: FilterPass) -> MotionNoise:
    """Estimate the noise parameters of a drive by maximum likelihood. For fewer than 3 fixes, both are 1."""
    line = drive_pass.timeline
    fixes, variance = np.ascontiguousarray(line.fixes[:, FIX_X : FIX_X + 2]), _variances(line)
    if len(fixes) < 3:
        return MotionNoise(1.0, 1.0)
    dt, states = np.diff(line.fix_time), np.empty((len(fixes) - 1, 7))
    start = np.array([*fixes[0], 0.0, 0.0, 0.0, 0.0, UNKNOWN_SPEED**2])

    def cost(noise: Array) -> float:
        density, fix = 10.0 ** np.clip(noise, -6.0, 6.0)
        start[4] = fix * variance[0]
        return _filter(dt, fixes[1:], fix * variance[1:], density, start, states)

    density, fix = 10.0 ** np.clip(minimize(cost, FIRST_GUESS, method="Nelder-Mead").x, -6.0, 6.0)
    return MotionNoise(float(density), float(fix))


def fitted_noise(ready: PreparedDrive) -> MotionNoise:
    return fit_noise(whole_pass(ready))


class FixesAlone:
    """Run of the filter that uses only fixes: an iterator of one piece, with estimates at the IMU samples."""

    failure: str | None = None
    restarts: Sequence[float] = ()

    def __init__(self, drive_pass: FilterPass, noise: MotionNoise) -> None:
        self._line, self._noise = drive_pass.timeline, noise
        self.initial: InitialState = drive_pass.initial

    def __iter__(self) -> Iterator[EstimateChunk]:
        yield self.at(self._line.imu_time)

    def at(self, time: Array) -> EstimateChunk:
        """Return the estimates at times from the start on, s."""
        line, noise = self._line, self._noise
        variance = noise.fix * _variances(line)
        moments = np.concatenate([[self.initial.time], line.fix_time])
        states = np.empty((len(moments), 7))
        first = variance[0] if len(variance) else noise.fix * UNSTATED_GPS_STD**2
        states[0] = *self.initial.mean[:4], first, 0.0, UNKNOWN_SPEED**2
        fixes = np.ascontiguousarray(line.fixes[:, FIX_X : FIX_X + 2])
        _filter(np.diff(moments), fixes, variance, noise.acceleration, states[0].copy(), states[1:])
        last = np.searchsorted(moments, time, side="right") - 1
        u, v = states[:, 2:4].T
        headings = np.where(np.hypot(u, v) > 0, np.arctan2(v, u), self.initial.mean[4])
        x, y, u, v, pp, pv, vv = states[last].T
        t, heading = time - moments[last], headings[last]
        covariance = np.zeros((len(t), 5, 5))
        spread = pp + 2 * t * pv + t**2 * vv + noise.acceleration * t**3 / 3
        covariance[:, [0, 1], [0, 1]] = spread[:, np.newaxis]
        mean = np.column_stack([x + t * u, y + t * v, u, v, heading])
        sound = np.ones(len(t), dtype=np.bool_)
        return EstimateChunk(time, mean, covariance, sound, ~sound)
