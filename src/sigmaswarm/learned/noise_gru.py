"""noise-gru: a filter with a network that scales Q and R according to the latest innovations.

The network runs one step after each fix. The factors apply from the next IMU sample to the sample after the next fix,
so they do not depend on the fix whose R they scale. The inputs are functions of the innovation (in the body frame,
divided by its RMS standard deviation), of the NIS, and of the time since the previous fix.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.compiled.layout import Q0, R
from sigmaswarm.filters.filter_run import InterruptibleRun
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.learned.fitting import Weights, gru, head

NAME = "noise-gru"
FEATURES = 4
MAX_SCALE = 30.0  # largest factor of R and Q; the smallest is its inverse


def log_scales(xp: Any, weights: Weights, h: Any) -> Any:
    """Return ln of the factors of R and Q, (..., 2)."""
    return float(np.log(MAX_SCALE)) * xp.tanh(head(weights, h))


def features_of(xp: Any, nu: Any, s: Any, theta: Any, since: Any) -> Any:
    """Return the inputs at a fix, (..., FEATURES).

    ``nu`` is the innovation (..., 2), m east and north. ``s`` contains xx, xy and yy of its covariance (..., 3), m2.
    ``theta`` is the heading at the next IMU sample, rad. ``since`` is the time since the previous fix, s.
    """
    n1, n2 = nu[..., 0], nu[..., 1]
    nis, _ = nis_of(nu, s)
    unit = xp.sqrt(0.5 * (s[..., 0] + s[..., 2]))
    c, sine = xp.cos(theta), xp.sin(theta)
    forward, left = (c * n1 + sine * n2) / unit, (c * n2 - sine * n1) / unit
    return xp.stack(
        [xp.arcsinh(forward), xp.arcsinh(left), xp.log1p(nis) - 1.0, xp.log(since + 0.01)], axis=-1
    )


def nis_of(nu: Any, s: Any) -> tuple[Any, Any]:
    """Return the NIS of innovations (..., 2) and det S, (...), with S (..., 3) as in `features_of`."""
    n1, n2, s11, s12, s22 = nu[..., 0], nu[..., 1], s[..., 0], s[..., 1], s[..., 2]
    det = s11 * s22 - s12 * s12
    return (s22 * n1 * n1 - 2.0 * s12 * n1 * n2 + s11 * n2 * n2) / det, det


class NoiseRun(InterruptibleRun):
    """Run of a filter over a drive with a network that scales Q and R.

    ``scales`` contains the factors on R and Q after each fix. With a new network, the results equal those of
    `FilterRun`.
    """

    def __init__(
        self,
        drive_pass: FilterPass,
        parameters: FilterParameters,
        weights: Mapping[str, Array],
        **options: Any,
    ) -> None:
        super().__init__(drive_pass, parameters, **options)
        self.scales: list[tuple[float, float]] = []
        self._weights, self._h = weights, np.zeros(weights["hidden"].shape[0])
        line = drive_pass.timeline
        self._q = slice(Q0, Q0 + parameters.n_states)
        self._own_q, self._own_r = self._rows[0, self._q].copy(), self._rows[0, [R.RX, R.RY]].copy()
        steps, samples_at = np.flatnonzero(line.updates), np.flatnonzero(line.sampled)
        next_sample = np.minimum(np.searchsorted(samples_at, steps), len(samples_at) - 1).tolist()
        fixes = (np.cumsum(line.updates | line.hides)[steps] - 1).tolist()
        # The last fix before each sample, and its time.
        self._last = dict(zip(next_sample, zip(fixes, line.end[steps].tolist(), strict=True), strict=True))
        self._marks = np.array([*self._last], dtype=np.intp)
        self._before = line.start

    def _at(self, sample: int, stop: int, record: Array, *, lost: bool) -> None:
        fix, time = self._last[sample]
        innovation, theta = self._innovations[fix], float(self._estimate()[0][THETA])
        since, self._before = time - self._before, time
        features = features_of(np, innovation[:2], innovation[2:], theta, since)
        if np.isfinite(features).all():
            self._h = gru(np, self._weights, self._h, features)
            scales = np.exp(log_scales(np, self._weights, self._h))
            self.scales.append((float(scales[0]), float(scales[1])))
        self._scale()

    def _scale(self) -> None:
        r, q = self.scales[-1] if self.scales else (1.0, 1.0)
        self._rows[0, self._q] = q * self._own_q
        self._rows[0, [R.RX, R.RY]] = r * self._own_r

    def _reset(self, start: Any) -> None:
        super()._reset(start)
        self._scale()
