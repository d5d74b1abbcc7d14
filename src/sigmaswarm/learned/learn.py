"""`learn`: train a network beside a tuned filter, search its settings, and keep it in a folder."""

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.fingerprint import DriveRecord, described
from sigmaswarm.drives.overlap import SEEN_FILE, landmarks, save_landmarks
from sigmaswarm.errors import InputError
from sigmaswarm.files import write_json, write_whole
from sigmaswarm.filters.names import NetworkName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.learned import noise_gru, noise_training, outage_lstm, outage_training
from sigmaswarm.learned.cells import n_weights
from sigmaswarm.learned.fitting import Fit, exact
from sigmaswarm.learned.folder import (
    LEARNED_SEEN,
    Learned,
    LearnedRecord,
    NetworkRecord,
    TrainingRecord,
)
from sigmaswarm.learned.outage_lstm import OutageLstm
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.record import FILE
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions

POPULATION = 4
"""Settings that the search tries at a time."""


@dataclass(frozen=True)
class Progress:
    """How far a training is, told after every epoch: trainings and epochs, and the least loss so far."""

    trial: int
    epoch: int
    done: int
    total: int
    loss: float


@dataclass(frozen=True, eq=False)
class Trained:
    """One training: the weights to be kept, and what it found."""

    weights: Mapping[str, Array]
    fit: Fit


@dataclass(frozen=True, eq=False)
class Finished:
    """The weights to be kept, and what else the network's record says."""

    weights: Mapping[str, Array]
    more: Mapping[str, Any]


class Learner(Protocol):
    """What one kind of network learns from, and how."""

    epochs: int
    start: Mapping[str, float]
    """Settings that are tried first; all of them where nothing is searched."""
    box: Mapping[str, tuple[float, float]]
    """In which they are searched, as logarithms to the base of 2."""

    def train(
        self,
        settings: Mapping[str, float],
        seed: int,
        checkpoint: Path | None,
        progress: Callable[[int, float], None],
    ) -> Trained: ...
    def finish(self, settings: Mapping[str, float], weights: Mapping[str, Array]) -> "Finished":
        """What is left to be done with the best of them."""
        ...


class OutageLearner:
    """Trains `outage_lstm`."""

    epochs = outage_training.EPOCHS
    start: Mapping[str, float] = {"units": 16, "window": 8.0, "learning_rate": 2.0**-7}
    box: Mapping[str, tuple[float, float]] = {"units": (2, 6), "window": (1, 5), "learning_rate": (-10, -5)}

    def __init__(
        self, drives: Sequence[Drive], validation: Sequence[Drive], parameters: FilterParameters, seed: int
    ) -> None:
        self._parameters = parameters
        six = all(axis is not None for d in (*drives, *validation) for axis in (d.imu.az, d.imu.gx, d.imu.gy))
        self._axes = ("ax", "ay", "gz", "az", "gx", "gy") if six else ("ax", "ay", "gz")
        self._tracks = outage_training.tracks_of(
            drives, parameters, held_back=False if validation else None
        ) + outage_training.tracks_of(validation, parameters, held_back=True)
        self._seed = seed
        self._examples: dict[float, outage_training.Examples] = {}

    def _shown(self, window: float) -> outage_training.Examples:
        if window not in self._examples:
            self._examples = {window: outage_training.examples_of(self._tracks, self._axes, window)}
        return self._examples[window]

    def train(
        self,
        settings: Mapping[str, float],
        seed: int,
        checkpoint: Path | None,
        progress: Callable[[int, float], None],
    ) -> Trained:
        """One training."""
        network, found = outage_training.trained(
            self._shown(settings["window"]),
            self._axes,
            window=settings["window"],
            units=int(settings["units"]),
            learning_rate=settings["learning_rate"],
            seed=seed,
            checkpoint=checkpoint,
            progress=progress,
        )
        return Trained(network.weights, found)

    def finish(self, settings: Mapping[str, float], weights: Mapping[str, Array]) -> "Finished":
        """Calibrate."""
        network = OutageLstm(self._axes, settings["window"], weights)
        network = outage_training.with_lasting(network, self._tracks)
        cases = outage_training.cases_of(self._tracks, self._seed)
        if not cases:
            raise InputError(
                "what is held back is too short for outages of 10 s; give longer drives, or --validation"
            )
        found = outage_training.calibrate(network, cases, self._parameters)
        inflation = found.inflation if np.isfinite(found.inflation) else None
        more = {"axes": list(self._axes), "inflation": inflation, "unsure": found.unsure}
        return Finished(found.weights, more)


class NoiseLearner:
    """Trains `noise_gru`."""

    epochs = noise_training.EPOCHS
    start: Mapping[str, float] = {"units": 8, "window": 20.0, "learning_rate": 2.0**-7}
    box: Mapping[str, tuple[float, float]] = {"units": (1, 5), "window": (3, 5), "learning_rate": (-10, -4)}

    def __init__(
        self, drives: Sequence[Drive], validation: Sequence[Drive], parameters: FilterParameters, seed: int
    ) -> None:
        del seed  # nothing is placed by chance
        noise_training.require_supported(parameters)
        self._drives, self._validation, self._parameters = drives, validation, parameters

    def train(
        self,
        settings: Mapping[str, float],
        seed: int,
        checkpoint: Path | None,
        progress: Callable[[int, float], None],
    ) -> Trained:
        """One training."""
        window, held_back = settings["window"], False if self._validation else None
        parts = [noise_training.segments_of(self._drives, self._parameters, window, held_back=held_back)]
        if self._validation:
            parts.append(
                noise_training.segments_of(self._validation, self._parameters, window, held_back=True)
            )
        network, found = noise_training.trained(
            noise_training.joined(parts),
            self._parameters,
            units=int(settings["units"]),
            learning_rate=settings["learning_rate"],
            seed=seed,
            checkpoint=checkpoint,
            progress=progress,
        )
        return Trained(network.weights, found)

    def finish(self, settings: Mapping[str, float], weights: Mapping[str, Array]) -> "Finished":
        """Nothing: its likelihood was what it learned."""
        del settings
        return Finished(weights, {})


LEARNERS: Mapping[str, type[OutageLearner] | type[NoiseLearner]] = {
    outage_lstm.NAME: OutageLearner,
    noise_gru.NAME: NoiseLearner,
}


def learn(
    kind: NetworkName,
    parameters: FilterParameters,
    drives: Sequence[Drive],
    *,
    out: Path,
    validation: Sequence[Drive] = (),
    tuning: Path | None = None,
    search: int = 0,
    seed: int = 0,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> Learned:
    """Train a network beside a tuned filter; no truth is looked at.

    Parameters
    ----------
    kind : {"outage-lstm", "noise-gru"}
    parameters : FilterParameters
        The tuned ones.
    drives : sequence of Drive
        To learn from.
    out : Path
        The folder that is made: `sigmaswarm run` and `evaluate` take it as they take a tuning's.
    validation : sequence of Drive
        Held back, to end the training in time and, of outage-lstm, to calibrate; by default the last quarter of
        each drive; of outage-lstm, if there are three drives or more, the last third of them.
    tuning : Path, optional
        The tuning.toml of the parameters, which is copied.
    search : int
        Settings (units, window, learning rate) to try beside the usual ones; the best on what is held back is kept.
    seed : int
        Same seed, same bits on the same machine.
    resume : bool
        Go on with a training that was interrupted; the result is the same as without the interruption.
    progress : callable, optional
        Told of every epoch.

    Raises
    ------
    InputError
        If JAX is missing, a filter or a drive does not suit, or the folder holds another training.
    """
    if kind not in LEARNERS:
        raise InputError(f"{kind!r}: no such network; choose one of {', '.join(LEARNERS)}")
    with exact():
        pass  # a missing JAX is told before any work
    began = time.process_time()
    data = [described(drive) for drive in drives]
    config = {
        "kind": kind,
        "filter": parameters.to_dict(),
        "search": search,
        "seed": seed,
        "data": data,
        "validation": [described(drive) for drive in validation],
        "versions": versions() | _jax_version(),
    }
    folder = ResultFolder(out, config, resume=resume)
    parted = kind == outage_lstm.NAME and not validation  # what calibrates it has to be long
    shown, held_back = _parted(drives) if parted else (drives, validation)
    learner: Learner = LEARNERS[kind](shown, held_back, parameters, seed)
    trials = _Trials(learner, folder, seed, 1 + search, progress)
    losses = [trials.loss(0, learner.start)]
    points = [learner.start, *_searched(learner, search, seed, losses, trials)]
    best = int(np.argmin(losses))
    found = trials.of(best)
    ready = learner.finish(points[best], found.weights)
    record = LearnedRecord(
        kind=kind,
        network=NetworkRecord(
            units=int(points[best]["units"]),
            window=points[best]["window"],
            learning_rate=points[best]["learning_rate"],
            numbers=n_weights(ready.weights),
            **ready.more,
        ),
        training=TrainingRecord(
            seed=seed,
            search=search,
            driven_s=float(sum(d.imu.time[-1] - d.imu.time[0] for d in drives)),
            epochs=len(found.fit.losses) - 1,
            loss_before=float(found.fit.losses[0, 1]),
            loss=found.fit.best,
            held_back=", ".join(d.name for d in held_back) or "the last quarter of each drive",
        ),
        versions=versions() | _jax_version(),
        data=[DriveRecord.model_validate(entry) for entry in data],
    )
    learned = Learned(record, ready.weights)
    learned.save(out)
    save_landmarks([landmarks(drive) for drive in drives], out / LEARNED_SEEN)
    if tuning is None:
        parameters.save(out / FILE)
    else:
        write_whole(out / FILE, tuning.read_bytes())
        if (tuning.parent / SEEN_FILE).exists():
            shutil.copyfile(tuning.parent / SEEN_FILE, out / SEEN_FILE)
    write_json(out / "timings.json", {"processor_s": time.process_time() - began})
    return learned


def _parted(drives: Sequence[Drive]) -> tuple[Sequence[Drive], Sequence[Drive]]:
    """Drives to learn from, and to hold back: the last third; none of one or two, whose ends are then."""
    count = len(drives) // 3
    return drives[: len(drives) - count], drives[len(drives) - count :]


def _jax_version() -> dict[str, str]:
    import jax

    return {"jax": jax.__version__}


class _Trials:
    """Trainings of a folder, each done once, however often the command was interrupted."""

    def __init__(
        self,
        learner: Learner,
        folder: ResultFolder,
        seed: int,
        total: int,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        self._learner, self._folder, self._seed, self._total, self._progress = (
            learner,
            folder,
            seed,
            total,
            progress,
        )

    def loss(self, number: int, settings: Mapping[str, float]) -> float:
        """Of a training with some settings, which is done unless the folder has it."""
        if self._folder.finished(number) is None:

            def told(epoch: int, loss: float) -> None:
                if self._progress:
                    per = self._learner.epochs
                    self._progress(Progress(number, epoch, number * per + epoch, self._total * per, loss))

            done = self._learner.train(settings, self._seed, self._folder.checkpoint(number), told)
            history = {f"weights/{name}": array for name, array in done.weights.items()}
            result = {"cost": done.fit.best, "settings": dict(settings)}
            self._folder.finish(number, result, history | {"losses": done.fit.losses})
        best = self.of(number).fit.best
        return best if np.isfinite(best) else float("inf")

    def of(self, number: int) -> Trained:
        """A training that is done."""
        done = self._folder.finished(number)
        assert done is not None
        arrays = done[1]
        weights = {name.split("/")[1]: array for name, array in arrays.items() if name.startswith("weights/")}
        return Trained(weights, Fit(weights, arrays["losses"]))


def _searched(
    learner: Learner, budget: int, seed: int, losses: list[float], trials: _Trials
) -> list[Mapping[str, float]]:
    """Settings that an optimizer of ours asks for, trained; ``losses`` grows by theirs."""
    if not budget:
        return []
    low, high = np.array(list(learner.box.values()), dtype=np.float64).T
    optimizer = create_optimizer(
        "cma-es", low, high, population=POPULATION, budget=budget, rng=np.random.default_rng([seed, 3])
    )
    tried: list[Mapping[str, float]] = []
    while len(points := optimizer.ask()):
        costs: list[float] = []
        for point in points:
            settings = {name: float(2.0**value) for name, value in zip(learner.box, point, strict=True)}
            settings["units"] = round(settings["units"])
            tried.append(settings)
            costs.append(trials.loss(len(losses), settings))
            losses.append(costs[-1])
        optimizer.tell(np.array(costs))
    return tried
