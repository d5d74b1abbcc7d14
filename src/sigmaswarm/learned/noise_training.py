"""Train `noise-gru` end to end, through the filter, on the likelihood of the fixes before each update.

Drives are cut into segments, each of which starts from the state of the plain filter; truth is not used.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recording import Recording
from sigmaswarm.filters.run import replay_of
from sigmaswarm.learned.cells import new_weights
from sigmaswarm.learned.fitting import Lesson
from sigmaswarm.learned.noise_filter import (
    N_COLUMNS,
    Settings,
    columns_of,
    innovation_loss,
    require_supported,
    run,
)
from sigmaswarm.learned.noise_gru import FEATURES

HELD_BACK = 0.25
"""Share at the end of each drive, where no held-back drives are given."""


@dataclass(frozen=True, eq=False)
class Segments:
    """Parts of drives.

    Attributes
    ----------
    arrays : tuple of ndarray
        Initial means (s, n) and covariances (s, n, n), steps (s, k, N_COLUMNS), Q (s, n), levers (s, 2).
    held_back : ndarray of bool, shape (s,)
    """

    arrays: tuple[Array, ...]
    held_back: NDArray[np.bool_]

    def part(self, *, held_back: bool) -> tuple[Array, ...]:
        """Return those that are held back, or the others."""
        return tuple(array[self.held_back == held_back] for array in self.arrays)


def segments_of(
    drives: Sequence[Drive], parameters: FilterParameters, length: float, *, held_back: bool | None
) -> Segments:
    """Cut drives into segments of ``length`` s; ``held_back``: all, none, or (None) those at the end of each."""
    require_supported(parameters)
    twin = replace(parameters, kind="ekf")
    parts: list[tuple[Array, ...]] = []
    held: list[bool] = []
    for drive in drives:
        replay = replay_of(drive)
        settings = Settings.of(replay, twin)
        columns, ends = columns_of(replay, twin)
        estimate = Recording(replay, twin).whole()
        last = float(estimate.time[-1])
        since = last - HELD_BACK * (last - replay.initial.time)
        for start in np.arange(replay.initial.time, last - length, length):
            sample = int(np.searchsorted(estimate.time, start))
            first, stop = np.searchsorted(
                ends, [estimate.time[sample], estimate.time[sample] + length], side="right"
            )
            if not (estimate.sound[sample] and columns[first:stop, 6].any()):
                continue
            begin = estimate.mean[sample], estimate.covariance[sample]
            parts.append((*begin, columns[first:stop], settings.q, settings.lever))
            held.append(bool(start + length > since) if held_back is None else held_back)
    if not parts:
        raise InputError(f"no drive is longer than {length:g} s from its start on; give longer ones")
    most = max(len(part[2]) for part in parts)
    padded = [(*p[:2], np.vstack([p[2], np.zeros((most - len(p[2]), N_COLUMNS))]), *p[3:]) for p in parts]
    return Segments(tuple(np.array(column) for column in zip(*padded, strict=True)), np.array(held))


def joined(parts: Sequence[Segments]) -> Segments:
    """Join segments."""
    most = max(part.arrays[2].shape[1] for part in parts)

    def column(i: int) -> Array:
        arrays = [part.arrays[i] for part in parts]
        if i == 2:
            arrays = [np.pad(a, ((0, 0), (0, most - a.shape[1]), (0, 0))) for a in arrays]
        return np.concatenate(arrays)

    return Segments(
        tuple(column(i) for i in range(len(parts[0].arrays))),
        np.concatenate([part.held_back for part in parts]),
    )


def loss(parameters: FilterParameters) -> Callable[[Any, tuple[Any, ...]], Any]:
    """Return the loss: the negative log-likelihood, nats, mean over the fixes of a batch of segments."""
    import jax
    import jax.numpy as jnp

    twin = replace(parameters, kind="ekf")

    def of_one(weights: Any, mean: Any, covariance: Any, columns: Any, q: Any, lever: Any) -> Any:
        settings = Settings(q, np.array(twin.measurement_noise), lever, twin)
        return innovation_loss(settings, run(settings, weights, mean, covariance, columns)[0])

    def of(weights: Any, batch: tuple[Any, ...]) -> Any:
        sums, counts = jax.vmap(of_one, in_axes=(None, 0, 0, 0, 0, 0))(weights, *batch)
        return jnp.sum(sums) / jnp.sum(counts)

    return of


class NoiseLearner:
    """Trains `noise_gru`."""

    epochs, batch, patience = 60, 8, 10
    start: Mapping[str, float] = {"units": 8, "window": 20.0, "learning_rate": 2.0**-7}
    box: Mapping[str, tuple[float, float]] = {"units": (1, 5), "window": (3, 5), "learning_rate": (-10, -4)}

    def __init__(
        self, drives: Sequence[Drive], validation: Sequence[Drive], parameters: FilterParameters, seed: int
    ) -> None:
        del seed  # nothing is random
        require_supported(parameters)
        self._drives, self._validation, self._parameters = drives, validation, parameters

    def lesson(self, settings: Mapping[str, float], seed: int) -> Lesson:
        """Prepare a training."""
        window, held_back = settings["window"], False if self._validation else None
        segments = segments_of(self._drives, self._parameters, window, held_back=held_back)
        if self._validation:
            more = segments_of(self._validation, self._parameters, window, held_back=True)
            segments = joined([segments, more])
        rng, units = np.random.default_rng([seed, 2]), int(settings["units"])
        weights = new_weights(rng, 3, FEATURES, units, 2)
        shown, test = segments.part(held_back=False), segments.part(held_back=True)
        return Lesson(loss(self._parameters), weights, shown, test)

    def finish(
        self, settings: Mapping[str, float], weights: Mapping[str, Array]
    ) -> tuple[Mapping[str, Array], dict[str, Any]]:
        """Return the weights: the loss was a likelihood, so no calibration is due."""
        del settings
        return weights, {}
