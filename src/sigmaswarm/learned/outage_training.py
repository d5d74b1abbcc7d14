"""Training `outage-lstm`: what it is shown, what it should have said, and how sure of itself it may be.

What it should have said is how far the car came, as the smoothed track of the same filter with all fixes tells: no
truth is looked at. What is held back ends the training in time, and loses its fixes in outages, placed again and
again, to find how sure the network may be.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.outages import hidden_fixes, random_windows
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.replay import Replay, Targets
from sigmaswarm.filters.run import replay_of
from sigmaswarm.filters.smoothing import Smoothing
from sigmaswarm.filters.student import FORECAST_DOF, FORECAST_SCALE
from sigmaswarm.learned.fitting import Lesson
from sigmaswarm.learned.outage_lstm import OutageLstm, OutageRun, calibrated, said_of, untrained
from sigmaswarm.learned.outages import Windows, all_windows, outage_windows
from sigmaswarm.learned.relative import body_displacement
from sigmaswarm.scoring.score import negative_log_t
from sigmaswarm.scoring.targets import OUTAGE_FIRST_AFTER

LENGTHS = (10.0, 40.0)
"""s: of the outages that calibrate."""
PLACEMENTS = 4
"""Of outages in each drive."""
EVERY = 0.25
"""s between examples."""
BORDER = 5.0
"""s between what is learned from and what is held back."""
HELD_BACK = 0.25
"""Of each drive, its end, where no drives are given to hold back."""
INFLATIONS, UNSURE = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0), (1.0, 10.0, 100.0)
"""What is tried: see `OutageLstm`."""
LAGS = (2, 4, 8, 12, 20, 40, 80, 120)
"""Of `EVERY`, over which errors are compared with each other."""
FIXED = ("center", "spread", "usual", "scale", "kept", "lasts")


@dataclass(frozen=True, eq=False)
class Track:
    """A drive to learn from.

    Attributes
    ----------
    ready : PreparedDrive
    mean : ndarray, shape (n, 5)
        The smoothed track with all fixes: x, y, vx, vy, theta at the IMU samples.
    held_back_from : float
        s, from when on nothing is learned from it.
    """

    ready: PreparedDrive
    mean: Array
    held_back_from: float

    @property
    def line(self) -> Timeline:
        """Its time line, with all fixes."""
        return self.ready.timeline()


def tracks_of(
    drives: Sequence[Drive], parameters: FilterParameters, *, held_back: bool | None
) -> list[Track]:
    """Drives to learn from; ``held_back``: all of them, none, or (None) the end of each."""
    tracks: list[Track] = []
    for drive in drives:
        ready = PreparedDrive(drive)
        mean = np.concatenate([p.mean[:, :5] for p in Smoothing(replay_of(ready), parameters, recover=True)])
        start, end = ready.initial.time, float(drive.imu.time[-1])
        usual = end - HELD_BACK * (end - start)
        tracks.append(Track(ready, mean, usual if held_back is None else -np.inf if held_back else np.inf))
    return tracks


@dataclass(frozen=True, eq=False)
class Case:
    """A drive with outages, of which what lies behind ``held_back_from`` (s) calibrates a network.

    Its hidden fixes' forecasts are recorded.
    """

    replay: Replay
    held_back_from: float


def cases_of(tracks: Sequence[Track], seed: int) -> list[Case]:
    """Outages where something is held back, placed again and again; none where they do not fit."""
    cases: list[Case] = []
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
            cases.append(Case(Replay(line, initial, Targets.none(line)), track.held_back_from))
    return cases


@dataclass(frozen=True, eq=False)
class Examples:
    """What a network is shown, (k, STEPS, f), how far the car came, (k, 2) m, and which are held back, (k,)."""

    features: Array
    moved: Array
    held_back: NDArray[np.bool_]

    def part(self, *, held_back: bool) -> tuple[Array, Array]:
        """Those that are held back, or the others."""
        chosen = self.held_back == held_back
        return self.features[chosen], self.moved[chosen]


def examples_of(tracks: Sequence[Track], axes: Sequence[str], window: float) -> Examples:
    """Of all moments of drives; what looks back over the border of what is held back is left out."""
    features: list[Array] = []
    moved: list[Array] = []
    held: list[NDArray[np.bool_]] = []
    for track in tracks:
        begins, ends, seen = all_windows(track.line, axes=axes, window=window, every=EVERY)
        end = track.line.imu_time[ends]
        came = body_displacement(track.mean[begins], track.mean[ends])
        late, clear = end > track.held_back_from, end - BORDER > track.held_back_from
        sound = (late == clear) & np.isfinite(came).all(axis=1) & np.isfinite(seen).all(axis=(1, 2))
        features.append(seen[sound])
        moved.append(came[sound])
        held.append(late[sound])
    return Examples(np.concatenate(features), np.concatenate(moved), np.concatenate(held))


def _loss(fixed: dict[str, Array]) -> Callable[[Any, tuple[Any, ...]], Any]:
    """-ln N(moved; said, std^2) in units of the scale, mean over examples and both directions."""
    import jax.numpy as jnp

    def of(weights: Any, batch: tuple[Any, ...]) -> Any:
        features, moved = batch
        said = said_of(jnp, {**weights, **fixed}, features)
        wrong = ((moved - fixed["usual"]) / fixed["scale"] - said[:, :2]) * jnp.exp(-said[:, 2:])
        return jnp.mean(0.5 * wrong**2 + said[:, 2:])

    return of


def lesson(
    examples: Examples, axes: tuple[str, ...], *, window: float, units: int, seed: int
) -> tuple[OutageLstm, Lesson]:
    """Prepare a new network and its training."""
    shown = examples.part(held_back=False)
    network = untrained(np.random.default_rng([seed, 1]), axes, window, units, *shown)
    fixed = {name: network.weights[name] for name in FIXED}
    moving = {name: w for name, w in network.weights.items() if name not in FIXED}
    return network, Lesson(_loss(fixed), moving, shown, examples.part(held_back=True), fixed)


class OutageLearner:
    """Trains `outage_lstm`."""

    epochs, batch, patience = 120, 128, 15
    start: Mapping[str, float] = {"units": 16, "window": 8.0, "learning_rate": 2.0**-7}
    box: Mapping[str, tuple[float, float]] = {"units": (2, 6), "window": (1, 5), "learning_rate": (-10, -5)}

    def __init__(
        self, drives: Sequence[Drive], validation: Sequence[Drive], parameters: FilterParameters, seed: int
    ) -> None:
        self._parameters, self._seed = parameters, seed
        six = all(axis is not None for d in (*drives, *validation) for axis in (d.imu.az, d.imu.gx, d.imu.gy))
        self._axes = ("ax", "ay", "gz", "az", "gx", "gy") if six else ("ax", "ay", "gz")
        self._tracks = tracks_of(drives, parameters, held_back=False if validation else None)
        self._tracks += tracks_of(validation, parameters, held_back=True)
        self._examples: dict[float, Examples] = {}

    def lesson(self, settings: Mapping[str, float], seed: int) -> Lesson:
        """Prepare a training."""
        window = settings["window"]
        if window not in self._examples:
            self._examples = {window: examples_of(self._tracks, self._axes, window)}
        examples = self._examples[window]
        return lesson(examples, self._axes, window=window, units=int(settings["units"]), seed=seed)[1]

    def finish(
        self, settings: Mapping[str, float], weights: Mapping[str, Array]
    ) -> tuple[Mapping[str, Array], dict[str, Any]]:
        """Calibrate the network."""
        network = with_lasting(OutageLstm(self._axes, settings["window"], weights), self._tracks)
        cases = cases_of(self._tracks, self._seed)
        if not cases:
            raise InputError(
                "the held-back driving is too short for outages of 10 s; give longer drives, or --validation"
            )
        found = calibrate(network, cases, self._parameters)
        inflation = found.inflation if np.isfinite(found.inflation) else None
        return found.weights, {"axes": list(self._axes), "inflation": inflation, "unsure": found.unsure}


def with_lasting(network: OutageLstm, tracks: Sequence[Track]) -> OutageLstm:
    """The network with how long its errors last, on what is held back: a fit of kept exp(-t / lasts)."""
    parts: list[Array] = []
    for track in tracks:
        begins, ends, seen = all_windows(track.line, axes=network.axes, window=network.window, every=EVERY)
        late = track.line.imu_time[ends] > track.held_back_from
        came = body_displacement(track.mean[begins[late]], track.mean[ends[late]])
        if late.any():
            parts.append(came - network.told(seen[late])[0])
    t = EVERY * np.array(LAGS)
    found = {"kept": np.zeros(2), "lasts": np.ones(2)}
    for i in range(2):
        each = [part[np.isfinite(part[:, i]), i] for part in parts]
        power = sum(float(np.mean(e**2)) * len(e) for e in each) / max(sum(map(len, each)), 1)
        pairs = [[(e[lag:], e[:-lag]) for e in each if len(e) > 2 * lag] for lag in LAGS]
        known = [k for k, pair in enumerate(pairs) if pair and power > 0.0]
        if not known:
            continue
        rho = np.array([np.mean(np.concatenate([a * b for a, b in pairs[k]])) / power for k in known])
        _, kept, lasts = min(
            (float(np.sum((rho - kept * np.exp(-t[known] / lasts)) ** 2)), kept, lasts)
            for kept, lasts in product(np.linspace(0.0, 1.0, 41), np.geomspace(1.0, 200.0, 41))
        )
        found["kept"][i], found["lasts"][i] = kept, lasts
    return replace(network, weights={**network.weights, **found})


def calibrate(network: OutageLstm, cases: Sequence[Case], parameters: FilterParameters) -> OutageLstm:
    """The network and the filter as sure of themselves in outages as makes hidden fixes likeliest.

    Where that is not better than the filter alone by a standard error over the outages (of which those of all
    placements but one are taken for repetitions), nothing is to be absorbed.
    """
    windows = [
        outage_windows(case.replay.timeline, axes=network.axes, window=network.window) for case in cases
    ]

    def losses(*sure: float) -> Array:
        return forecast_losses(calibrated(network, *sure), cases, windows, parameters)

    alone, best, gain = losses(np.inf, 1.0), (np.inf, 1.0), 0.0
    for each in product(INFLATIONS, UNSURE):
        better = alone - losses(*each)
        apart = len(better) / PLACEMENTS
        error = float(np.std(better)) / np.sqrt(apart - 1.0) if apart > 1.0 else np.inf
        if np.isfinite(better).all() and better.mean() > max(gain, error):
            best, gain = each, float(better.mean())
    return calibrated(network, *best)


def forecast_losses(
    network: OutageLstm, cases: Sequence[Case], windows: Sequence[Windows], parameters: FilterParameters
) -> Array:
    """Mean -ln likelihood of the hidden fixes of each outage, nats, under Student's t: see `Score.forecast_t`."""
    told: list[float] = []
    for case, known in zip(cases, windows, strict=True):
        line = case.replay.timeline
        run = OutageRun(case.replay, parameters, network, windows=known).finished()
        fixes = line.hides | line.absorbs
        hidden = line.hides[fixes] & (line.fix_time > case.held_back_from)
        outage = np.cumsum(line.absorbs)[fixes]
        found = run.innovations
        each = negative_log_t(found.innovation, found.covariance, FORECAST_DOF, FORECAST_SCALE)
        each = np.where(np.isfinite(each), each, np.inf)
        told += [float(each[hidden & (outage == number)].mean()) for number in np.unique(outage[hidden])]
    return np.array(told)
