"""Train `noise-gru`: maximize the likelihood of the innovations with gradients through all steps of the filter.

Each segment of a drive starts from the state of the filter without a network.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.learned.fitting import (
    VALIDATION_SHARE,
    Examples,
    Loss,
    Settings,
    TrainingProblem,
    new_weights,
)
from sigmaswarm.learned.noise_gru import FEATURES


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
    """Cut drives into segments of ``length`` s. Without ``validation``, the end of each drive is validation data.

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
