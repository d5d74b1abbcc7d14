"""Train `outage-lstm`: examples, loss, and calibration of the variances.

The network learns the displacements between estimates that are smoothed with all fixes. To calibrate the variances,
fixes are hidden in outages of the validation data.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.outages import hidden_fixes, random_windows
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.constants import FORECAST_DOF, FORECAST_SCALE
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.filters.smoothing import SmootherRun
from sigmaswarm.learned.displacements import body_displacement
from sigmaswarm.learned.fitting import VALIDATION_SHARE, Examples, Loss, Settings, TrainingProblem
from sigmaswarm.learned.outage_lstm import (
    OutageLstm,
    OutageRun,
    Windows,
    features_at,
    new_network,
    outage_windows,
    outputs_of,
    pairs_of,
)
from sigmaswarm.scoring.score import negative_log_t
from sigmaswarm.scoring.targets import OUTAGE_FIRST_AFTER

LENGTHS = (10.0, 40.0)  # s, shortest and longest calibration outage
PLACEMENTS = 4  # number of random sets of outages in each drive
EXAMPLE_INTERVAL = 0.25  # s, between examples
VALIDATION_GAP = 5.0  # s between the training and the validation data of a drive, without examples
INFLATIONS = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # values of `OutageLstm.inflation` that the calibration tries
UNSURE = (1.0, 10.0, 100.0)  # values of `OutageLstm.unsure` that the calibration tries
LAGS = (2, 4, 8, 12, 20, 40, 80, 120)  # lags of the autocorrelation of errors, in units of `EXAMPLE_INTERVAL`
FIXED_WEIGHTS = ("center", "spread", "usual", "scale", "kept", "lasts")


@dataclass(frozen=True, eq=False)
class Track:
    """A drive with its smoothed track: x, y, vx, vy, theta at the IMU samples, shape (n, 5).

    ``held_back_from`` is the start of the validation data, s.
    """

    ready: PreparedDrive
    mean: Array
    held_back_from: float


def tracks_of(
    drives: Sequence[Drive], parameters: FilterParameters, validation: Sequence[Drive] = ()
) -> list[Track]:
    """Smooth drives for training. Without ``validation`` drives, the end of each drive is validation data."""
    tracks: list[Track] = []
    for drive in (*drives, *validation):
        ready = PreparedDrive(drive)
        mean = np.concatenate(
            [p.mean[:, :5] for p in SmootherRun(whole_pass(ready), parameters, recover=True)]
        )
        start, end = ready.initial.time, float(drive.imu.time[-1])
        since = end - VALIDATION_SHARE * (end - start)
        if validation:
            since = np.inf if len(tracks) < len(drives) else -np.inf
        tracks.append(Track(ready, mean, since))
    return tracks


def cases_of(tracks: Sequence[Track], seed: int) -> list[tuple[FilterPass, float]]:
    """Place sets of outages on the validation data. Return passes, each with the start (s) of its validation data."""
    cases: list[tuple[FilterPass, float]] = []
    for number, track in enumerate(tracks):
        drive, initial = track.ready.drive, track.ready.initial
        end = float(drive.imu.time[-1])
        start = max(track.held_back_from - OUTAGE_FIRST_AFTER, initial.time)
        longest = min(LENGTHS[1], end - start - OUTAGE_FIRST_AFTER)
        if longest < LENGTHS[0]:
            continue
        for placement in range(PLACEMENTS):
            rng = np.random.default_rng([seed, number, placement])
            windows = random_windows(
                start, end, rng, length=(LENGTHS[0], longest), first_after=OUTAGE_FIRST_AFTER
            )
            line = track.ready.timeline(hidden_fixes(drive.gps.time, windows))
            cases.append((FilterPass(line, initial, Targets.none(line)), track.held_back_from))
    return cases


def _windows_of(track: Track, axes: Sequence[str], window: float) -> tuple[Array, Array, Array]:
    """Return windows of a whole drive: end times (k,), s, features, and displacements (k, 2), m."""
    line = track.ready.timeline()
    begins, ends = pairs_of(line.imu_time, line.start, np.inf, EXAMPLE_INTERVAL)
    features = features_at(line, ends, axes=axes, window=window)
    return line.imu_time[ends], features, body_displacement(track.mean[begins], track.mean[ends])


def examples_of(tracks: Sequence[Track], axes: Sequence[str], window: float) -> Examples:
    """Make examples: inputs (k, WINDOW_STEPS, f) and displacements (k, 2), m.

    None of them is in the `VALIDATION_GAP`.
    """
    parts: list[tuple[Array, Array, NDArray[np.bool_]]] = []
    for track in tracks:
        end, features, moved = _windows_of(track, axes, window)
        late, clear = end > track.held_back_from, end - VALIDATION_GAP > track.held_back_from
        sound = (late == clear) & np.isfinite(moved).all(axis=1) & np.isfinite(features).all(axis=(1, 2))
        parts.append((features[sound], moved[sound], late[sound]))
    features, moved, held_back = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Examples((features, moved), held_back)


def _loss(fixed: dict[str, Array]) -> Loss:
    """Return the loss: -ln N(moved; output, std^2) in units of ``scale``, without constant terms."""
    import jax.numpy as jnp

    def of(weights: Any, batch: tuple[Any, ...]) -> Any:
        features, moved = batch
        raw = outputs_of(jnp, {**weights, **fixed}, features)
        error = ((moved - fixed["usual"]) / fixed["scale"] - raw[:, :2]) * jnp.exp(-raw[:, 2:])
        return jnp.mean(0.5 * error**2 + raw[:, 2:])

    return of


def training_problem(
    examples: Examples, axes: tuple[str, ...], *, window: float, units: int, seed: int
) -> tuple[OutageLstm, TrainingProblem]:
    shown = examples.part(held_back=False)
    network = new_network(np.random.default_rng([seed, 1]), axes, window, units, *shown)
    fixed = {name: network.weights[name] for name in FIXED_WEIGHTS}
    moving = {name: w for name, w in network.weights.items() if name not in FIXED_WEIGHTS}
    return network, TrainingProblem(_loss(fixed), moving, shown, examples.part(held_back=True), fixed)


class OutageLearner:
    epochs, batch, patience = 120, 128, 15
    start: Mapping[str, float] = {"units": 16, "window": 8.0, "learning_rate": 2.0**-7}
    box: Mapping[str, tuple[float, float]] = {"units": (2, 6), "window": (1, 5), "learning_rate": (-10, -5)}

    def __init__(
        self, drives: Sequence[Drive], validation: Sequence[Drive], parameters: FilterParameters, seed: int
    ) -> None:
        self._parameters, self._seed = parameters, seed
        six = all(axis is not None for d in (*drives, *validation) for axis in (d.imu.az, d.imu.gx, d.imu.gy))
        self._axes = ("ax", "ay", "gz", "az", "gx", "gy") if six else ("ax", "ay", "gz")
        self._tracks = tracks_of(drives, parameters, validation)
        self._examples: dict[float, Examples] = {}

    def training_problem(self, settings: Settings, seed: int) -> TrainingProblem:
        window = settings["window"]
        if window not in self._examples:
            self._examples = {window: examples_of(self._tracks, self._axes, window)}
        examples = self._examples[window]
        units = int(settings["units"])
        _, problem = training_problem(examples, self._axes, window=window, units=units, seed=seed)
        return problem

    def finish(
        self, settings: Settings, weights: Mapping[str, Array]
    ) -> tuple[Mapping[str, Array], dict[str, Any]]:
        network = with_error_decay(OutageLstm(self._axes, settings["window"], weights), self._tracks)
        cases = cases_of(self._tracks, self._seed)
        if not cases:
            raise InputError(
                "the validation data are too short for outages of 10 s; use longer drives, or specify --validation"
            )
        calibration = calibrate(network, cases, self._parameters)
        inflation = calibration.inflation if np.isfinite(calibration.inflation) else None
        entries = {"axes": list(self._axes), "inflation": inflation, "unsure": calibration.unsure}
        return calibration.weights, entries


def with_error_decay(network: OutageLstm, tracks: Sequence[Track]) -> OutageLstm:
    """Fit ``kept`` exp(-t / ``lasts``) to the autocorrelation of errors on the validation data."""
    parts: list[Array] = []
    for track in tracks:
        end, features, moved = _windows_of(track, network.axes, network.window)
        if (late := end > track.held_back_from).any():
            parts.append(moved[late] - network.displacements(features[late])[0])
    t = EXAMPLE_INTERVAL * np.array(LAGS)
    decay = {"kept": np.zeros(2), "lasts": np.ones(2)}
    for i in range(2):
        errors = [part[np.isfinite(part[:, i]), i] for part in parts]
        power = sum(float(np.mean(e**2)) * len(e) for e in errors) / max(sum(map(len, errors)), 1)
        pairs = [[(e[lag:], e[:-lag]) for e in errors if len(e) > 2 * lag] for lag in LAGS]
        known = [k for k, pair in enumerate(pairs) if pair and power > 0.0]
        if not known:
            continue
        rho = np.array([np.mean(np.concatenate([a * b for a, b in pairs[k]])) / power for k in known])
        _, kept, lasts = min(
            (float(np.sum((rho - kept * np.exp(-t[known] / lasts)) ** 2)), kept, lasts)
            for kept, lasts in product(np.linspace(0.0, 1.0, 41), np.geomspace(1.0, 200.0, 41))
        )
        decay["kept"][i], decay["lasts"][i] = kept, lasts
    return replace(network, weights={**network.weights, **decay})


def calibrate(
    network: OutageLstm, cases: Sequence[tuple[FilterPass, float]], parameters: FilterParameters
) -> OutageLstm:
    """Choose the factors of `OutageLstm` that maximize the likelihood of hidden fixes.

    The inflation is infinite if no factors increase the mean log-likelihood above that of the filter alone by more than
    a standard error. The standard error counts only the outages of one set as independent.
    """
    windows = [
        outage_windows(drive_pass.timeline, axes=network.axes, window=network.window)
        for drive_pass, _ in cases
    ]

    def losses(inflation: float, unsure: float) -> Array:
        scaled = replace(network, inflation=inflation, unsure=unsure)
        return forecast_losses(scaled, cases, windows, parameters)

    best, gain = (np.inf, 1.0), 0.0
    alone = losses(*best)
    for factors in product(INFLATIONS, UNSURE):
        gains = alone - losses(*factors)
        independent = len(gains) / PLACEMENTS
        error = float(np.std(gains)) / np.sqrt(independent - 1.0) if independent > 1.0 else np.inf
        if np.isfinite(gains).all() and gains.mean() > max(gain, error):
            best, gain = factors, float(gains.mean())
    return replace(network, inflation=best[0], unsure=best[1])


def forecast_losses(
    network: OutageLstm,
    cases: Sequence[tuple[FilterPass, float]],
    windows: Sequence[Windows],
    parameters: FilterParameters,
) -> Array:
    """Return the mean negative log-likelihood of each outage's hidden fixes, nats (see `Score.forecast_t`)."""
    losses: list[float] = []
    for (drive_pass, held_back_from), known in zip(cases, windows, strict=True):
        line = drive_pass.timeline
        innovations = OutageRun(drive_pass, parameters, network, windows=known).finished().innovations
        fixes = line.hides | line.updates
        hidden = line.hides[fixes] & (line.fix_time > held_back_from)
        outage = np.cumsum(line.updates)[fixes]
        loss = negative_log_t(innovations.innovation, innovations.covariance, FORECAST_DOF, FORECAST_SCALE)
        loss = np.where(np.isfinite(loss), loss, np.inf)
        losses += [float(loss[hidden & (outage == number)].mean()) for number in np.unique(outage[hidden])]
    return np.array(losses)
