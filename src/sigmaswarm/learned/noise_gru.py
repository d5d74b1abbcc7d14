"""noise-gru: a filter whose Q and R are scaled by a network that sees the latest innovations.

After each fix the network takes one step. Its inputs are the innovation in the car's frame, in units of its expected
size, its NIS, and the time since the last fix. Its outputs, in bounds, are a factor of R and one of all of Q, from the
next IMU sample to the one after the next fix. So a factor never depends on the fix that it applies to.

It runs on the compiled filter, whose parameters change between two samples; `noise_filter` is its differentiable form.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.compiled.layout import Q0, R
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recording import SAMPLES, Recording
from sigmaswarm.filters.replay import Replay
from sigmaswarm.learned.cells import Weights, gru, head

NAME = "noise-gru"
FEATURES = 4
MOST_SCALE = 30.0
"""Largest factor of R and Q; the smallest is its inverse."""


def log_scales(xp: Any, weights: Weights, h: Any) -> Any:
    """Return ln of the factors of R and Q, (..., 2)."""
    return float(np.log(MOST_SCALE)) * xp.tanh(head(weights, h))


def features_of(xp: Any, nu: Any, s: Any, theta: Any, since: Any) -> Any:
    """Return the inputs at a fix, (..., FEATURES).

    Parameters
    ----------
    xp : numpy or jax.numpy
    nu : (..., 2) m east and north
    s : (..., 3) m2: xx, xy and yy of its covariance
    theta : (...) rad, of the car at the next IMU sample
    since : (...) s since the last fix
    """
    n1, n2, s11, s12, s22 = nu[..., 0], nu[..., 1], s[..., 0], s[..., 1], s[..., 2]
    nis = (s22 * n1 * n1 - 2.0 * s12 * n1 * n2 + s11 * n2 * n2) / (s11 * s22 - s12 * s12)
    unit = xp.sqrt(0.5 * (s11 + s22))
    c, sine = xp.cos(theta), xp.sin(theta)
    forward, left = (c * n1 + sine * n2) / unit, (c * n2 - sine * n1) / unit
    return xp.stack(
        [xp.arcsinh(forward), xp.arcsinh(left), xp.log1p(nis) - 1.0, xp.log(since + 0.01)], axis=-1
    )


class NoiseRun(Recording):
    """Run a filter whose Q and R a network scales over a replay.

    With an untrained network its pieces have the bits of `Recording`.

    Parameters
    ----------
    replay, parameters, samples, recover
        As of `Recording`.
    weights : mapping of str to ndarray
        Of the network: see `cells`.

    Attributes
    ----------
    initial : InitialState
    scales : list of (float, float)
        Factors of R and Q after each fix so far.
    """

    def __init__(
        self,
        replay: Replay,
        parameters: FilterParameters,
        weights: Mapping[str, Array],
        *,
        samples: int = SAMPLES,
        recover: bool = False,
    ) -> None:
        super().__init__(replay, parameters, samples=samples, recover=recover)
        self.initial = replay.initial
        self.scales: list[tuple[float, float]] = []
        self._weights, self._h = weights, np.zeros(weights["hidden"].shape[0])
        line = replay.timeline
        self._q = slice(Q0, Q0 + parameters.n_states)
        self._own_q, self._own_r = self._rows[0, self._q].copy(), self._rows[0, [R.RX, R.RY]].copy()
        steps, samples_at = np.flatnonzero(line.absorbs), np.flatnonzero(line.sampled)
        seen = samples_at[np.minimum(np.searchsorted(samples_at, steps), len(samples_at) - 1)]
        fixes = np.cumsum(line.absorbs | line.hides)[steps] - 1
        # By the step of the next sample; of the fixes between two samples the network sees the last.
        self._last = dict(
            zip(seen.tolist(), zip(fixes.tolist(), line.end[steps].tolist(), strict=True), strict=True)
        )
        self._before = line.start

    def _run_to(self, stops: NDArray[np.intp], record: Array) -> NDArray[np.bool_]:
        due = [i for i, stop in enumerate((stops - 1).tolist()) if stop in self._last]
        lost, row = np.zeros(len(stops), dtype=np.bool_), 0
        for i in due:
            lost[row : i + 1] = super()._run_to(stops[row : i + 1], record[row : i + 1])
            self._adapt(int(stops[i]) - 1)
            row = i + 1
        if row < len(stops):
            lost[row:] = super()._run_to(stops[row:], record[row:])
        return lost

    def _adapt(self, step: int) -> None:
        """Run the network at the last fix before a step's end, and set the scales."""
        fix, time = self._last[step]
        seen, theta = self._innovations[fix], float(self._estimate()[0][THETA])
        since, self._before = time - self._before, time
        features = features_of(np, seen[:2], seen[2:], theta, since)
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
