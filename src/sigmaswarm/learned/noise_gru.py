"""noise-gru: a filter with a network that scales Q and R according to the latest innovations.

The network runs one step after each fix. The factors apply from the next IMU sample to the sample after the next fix,
so they do not depend on the fix whose R they scale. The inputs are functions of the innovation (in the body frame,
divided by its RMS standard deviation), of the NIS, and of the time since the previous fix.

The training maximizes the likelihood of the innovations, with gradients of the whole filter (`noise_filter`). Each
segment of a drive starts from the state of the filter without a network.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.layout import Q0, R
from sigmaswarm.filters.filter_run import FilterRun, InterruptibleRun
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.learned.fitting import (
    VALIDATION_SHARE,
    Examples,
    Loss,
    Settings,
    TrainingProblem,
    Weights,
    gru,
    head,
    new_weights,
)

NAME = "noise-gru"
FEATURES = 4
MAX_SCALE = 30.0  # largest factor of R and Q; the smallest is its inverse


def log_scales(xp: Any, weights: Weights, h: Any) -> Any:
    """Return ln of the factors of R and Q, (..., 2)."""
    return float(np.log(MAX_SCALE)) * xp.tanh(head(weights, h))


def features_of(xp: Any, nu: Any, s: Any, theta: Any, since: Any) -> Any:
    """Return the inputs at a fix, (..., FEATURES).

    ``nu``: innovation (..., 2), m east and north. ``s``: xx, xy and yy of its covariance (..., 3), m2. ``theta``:
    heading at the next IMU sample, rad. ``since``: time since the previous fix, s.
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

    ``scales``: factors on R and Q after each fix. With a new network, the results equal those of `FilterRun`.
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


def require_supported(p: FilterParameters) -> None:
    if p.model not in ("planar5", "planar8"):
        raise InputError(
            f"noise-gru does not support {p.model}; tune with --model planar8, and train noise-gru for this filter"
        )
    if p.kind not in ("ukf", "ekf"):
        raise InputError(
            f"{p.kind} adapts its noise, so noise-gru does not support it; tune with --kind ukf or --kind ekf"
        )
    for name in ("velocity_noise", "odometer_noise", "heading_noise", "fix_error"):
        if getattr(p, name) is not None:
            option = name.removesuffix("_noise").replace("_", "-")
            raise InputError(f"noise-gru does not support {name}; tune a filter without {option} in --use")


def segments_of(
    drives: Sequence[Drive], parameters: FilterParameters, length: float, validation: Sequence[Drive] = ()
) -> Examples:
    """Cut drives into segments of ``length`` s; without ``validation``, the end of each drive is validation data.

    The arrays of r segments are initial means (r, n) and covariances (r, n, n), steps (r, k, N_COLUMNS), Q (r, n), and
    lever arms (r, 2).
    """
    from sigmaswarm.learned.noise_filter import FilterConstants, columns_of

    require_supported(parameters)
    ekf = replace(parameters, kind="ekf")
    parts, held_back = list[tuple[Array, ...]](), list[bool]()
    for group, validates in [(drives, False), (validation, True)] if validation else [(drives, None)]:
        before = len(parts)
        for drive in group:
            drive_pass = whole_pass(drive)
            settings = FilterConstants.of(drive_pass, ekf)
            columns, ends = columns_of(drive_pass, ekf)
            estimate = FilterRun(drive_pass, ekf).whole()
            last = float(estimate.time[-1])
            since = last - VALIDATION_SHARE * (last - drive_pass.initial.time)
            for start in np.arange(drive_pass.initial.time, last - length, length):
                sample = int(np.searchsorted(estimate.time, start))
                span = [estimate.time[sample], estimate.time[sample] + length]
                first, stop = np.searchsorted(ends, span, side="right")
                if not (estimate.sound[sample] and columns[first:stop, 6].any()):
                    continue
                begin = estimate.mean[sample], estimate.covariance[sample]
                parts.append((*begin, columns[first:stop], settings.q, settings.lever))
                held_back.append(bool(start + length > since) if validates is None else validates)
        if len(parts) == before:
            raise InputError(
                f"no drive has {length:g} s with fixes after the start of the filter; use longer drives"
            )
    most = max(len(part[2]) for part in parts)
    padded = [(*p[:2], np.pad(p[2], ((0, most - len(p[2])), (0, 0))), *p[3:]) for p in parts]
    return Examples(tuple(np.array(column) for column in zip(*padded, strict=True)), np.array(held_back))


def loss(parameters: FilterParameters) -> Loss:
    """Return the loss of a batch of segments: the mean negative log-likelihood of their fixes, nats."""
    import jax
    import jax.numpy as jnp

    from sigmaswarm.learned.noise_filter import FilterConstants, innovation_loss, run

    ekf = replace(parameters, kind="ekf")

    def loss_of_segment(weights: Any, mean: Any, covariance: Any, columns: Any, q: Any, lever: Any) -> Any:
        settings = FilterConstants(q, lever, ekf)
        return innovation_loss(settings, run(settings, weights, mean, covariance, columns)[0])

    def of(weights: Any, batch: tuple[Any, ...]) -> Any:
        sums, counts = jax.vmap(loss_of_segment, in_axes=(None, 0, 0, 0, 0, 0))(weights, *batch)
        return jnp.sum(sums) / jnp.sum(counts)

    return of


class NoiseLearner:
    epochs, batch, patience = 60, 8, 10
    start: Mapping[str, float] = {"units": 8, "window": 20.0, "learning_rate": 2.0**-7}
    box: Mapping[str, tuple[float, float]] = {"units": (1, 5), "window": (3, 5), "learning_rate": (-10, -4)}

    def __init__(
        self, drives: Sequence[Drive], validation: Sequence[Drive], parameters: FilterParameters, seed: int
    ) -> None:
        del seed  # segments need no random numbers
        require_supported(parameters)
        self._drives, self._validation, self._parameters = drives, validation, parameters

    def training_problem(self, settings: Settings, seed: int) -> TrainingProblem:
        segments = segments_of(self._drives, self._parameters, settings["window"], self._validation)
        rng = np.random.default_rng([seed, 2])
        weights = new_weights(rng, 3, FEATURES, int(settings["units"]), 2)
        shown, test = segments.part(held_back=False), segments.part(held_back=True)
        return TrainingProblem(loss(self._parameters), weights, shown, test)

    def finish(
        self, settings: Settings, weights: Mapping[str, Array]
    ) -> tuple[Mapping[str, Array], dict[str, Any]]:
        """Return the weights unchanged: the network has no variances to calibrate."""
        del settings
        return weights, {}
