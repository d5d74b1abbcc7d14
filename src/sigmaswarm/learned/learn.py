"""Train a network that helps a tuned filter, search its settings, and save it in a folder."""

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.fingerprint import DriveRecord, described
from sigmaswarm.drives.overlap import SEEN_FILE, landmarks, save_landmarks
from sigmaswarm.errors import InputError
from sigmaswarm.files import staged_files, write_json, write_whole
from sigmaswarm.filters.names import NetworkName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.learned import noise_gru, outage_lstm
from sigmaswarm.learned.cells import n_weights
from sigmaswarm.learned.fitting import Fit, Lesson, exact, fit
from sigmaswarm.learned.folder import LEARNED_SEEN, Learned, LearnedRecord, NetworkRecord, TrainingRecord
from sigmaswarm.learned.noise_training import NoiseLearner
from sigmaswarm.learned.outage_training import OutageLearner
from sigmaswarm.records import ARRAYS
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.record import FILE
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions

POPULATION = 4
"""Settings of a batch of the search."""
Settings = Mapping[str, float]


@dataclass(frozen=True)
class Progress:
    """Progress of a training after an epoch: trainings and epochs, and the least loss so far."""

    trial: int
    epoch: int
    done: int
    total: int
    loss: float


class Learner(Protocol):
    """The training of one type of network."""

    epochs: int
    batch: int
    patience: int
    start: Settings
    """Settings of the first training, and of the only one without a search."""
    box: Mapping[str, tuple[float, float]]
    """Bounds of the search, as logarithms to the base of 2."""

    def lesson(self, settings: Settings, seed: int) -> Lesson:
        """Prepare what `fit` needs."""
        ...

    def finish(
        self, settings: Settings, weights: Mapping[str, Array]
    ) -> tuple[Mapping[str, Array], dict[str, Any]]:
        """Complete the best network: its weights, and further entries of its record."""
        ...


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
    """Train a network that helps a tuned filter, without truth.

    Parameters
    ----------
    kind : {"outage-lstm", "noise-gru"}
    parameters : FilterParameters
        Of the tuned filter.
    drives : sequence of Drive
        Training drives.
    out : Path
        Folder of the results; `sigmaswarm run` and `evaluate` read it as a tuning's.
    validation : sequence of Drive
        Held-out drives for early stopping and, for outage-lstm, calibration; by default the last quarter of each
        drive, or for outage-lstm, of three drives or more, the last third of them.
    tuning : Path, optional
        The tuning.toml of the parameters, to be copied.
    search : int
        Number of further settings (units, window, learning rate) to try; the best on the held-out data is kept.
    seed : int
        Same seed, same bits on the same machine.
    resume : bool
        Continue an interrupted training; the result is the same as without interruption.
    progress : callable, optional
        Called after every epoch.

    Raises
    ------
    InputError
        If JAX is missing, a filter or a drive is unsuitable, or the folder holds another training.
    """
    if kind not in LEARNERS:
        raise InputError(f"{kind!r}: no such network; choose one of {', '.join(LEARNERS)}")
    with exact():
        import jax  # raises at once where it is missing

    began = time.process_time()
    data, own_versions = [described(drive) for drive in drives], versions() | {"jax": jax.__version__}
    config = {
        "kind": kind,
        "filter": parameters.to_dict(),
        "search": search,
        "seed": seed,
        "data": data,
        "validation": [described(drive) for drive in validation],
        "versions": own_versions,
    }
    folder = ResultFolder(out, config, resume=resume)
    shown, held_back = drives, validation
    if kind == outage_lstm.NAME and not validation:  # its calibration needs long drives
        last = len(drives) - len(drives) // 3
        shown, held_back = drives[:last], drives[last:]
    learner: Learner = LEARNERS[kind](shown, held_back, parameters, seed)
    points, fits = _trainings(learner, folder, search, seed, progress)
    best = int(np.argmin([_loss(one) for one in fits]))
    settings, found = points[best], fits[best]
    weights, more = learner.finish(settings, found.weights)
    record = LearnedRecord(
        kind=kind,
        network=NetworkRecord(
            units=int(settings["units"]),
            window=settings["window"],
            learning_rate=settings["learning_rate"],
            numbers=n_weights(weights),
            **more,
        ),
        training=TrainingRecord(
            seed=seed,
            search=search,
            driven_s=float(sum(d.imu.time[-1] - d.imu.time[0] for d in drives)),
            epochs=len(found.losses) - 1,
            loss_before=float(found.losses[0, 1]),
            loss=found.best,
            held_back=", ".join(d.name for d in held_back) or "the last quarter of each drive",
        ),
        versions=own_versions,
        data=[DriveRecord.model_validate(entry) for entry in data],
    )
    learned = Learned(record, weights)
    _save(learned, parameters, drives, tuning, out)
    write_json(out / "timings.json", {"processor_s": time.process_time() - began})
    return learned


def _save(
    learned: Learned,
    parameters: FilterParameters,
    drives: Sequence[Drive],
    tuning: Path | None,
    out: Path,
) -> None:
    with staged_files(out) as new:
        learned.save(new)
        save_landmarks([landmarks(drive) for drive in drives], new / LEARNED_SEEN)
        if tuning is None:
            parameters.save(new / FILE)
        else:
            write_whole(new / FILE, tuning.read_bytes())
            if (tuning.parent / SEEN_FILE).exists():
                shutil.copyfile(tuning.parent / SEEN_FILE, new / SEEN_FILE)


class FinishedRecord(BaseModel, extra="forbid"):
    """result.json of a training."""

    cost: float | None
    settings: dict[str, float]


class FinishedHistoryRecord(BaseModel):
    """history.npz of a training: losses after each epoch (e, 2), and the weights by name."""

    model_config = ARRAYS | ConfigDict(extra="allow")
    losses: np.ndarray[Any, np.dtype[np.float64]]


def _trainings(
    learner: Learner,
    folder: ResultFolder,
    search: int,
    seed: int,
    progress: Callable[[Progress], None] | None,
) -> tuple[list[Settings], list[Fit]]:
    """Train with the first settings, and with those that an optimizer chooses."""
    points, fits, total = list[Settings](), list[Fit](), (1 + search) * learner.epochs

    def train(settings: Settings) -> float:
        number = len(points)

        def report(epoch: int, loss: float) -> None:
            if progress:
                progress(Progress(number, epoch, number * learner.epochs + epoch, total, loss))

        points.append(settings)
        fits.append(_trained(learner, settings, seed, folder, number, report))
        return _loss(fits[-1])

    train(learner.start)
    if search:
        low, high = np.array(list(learner.box.values()), dtype=np.float64).T
        rng = np.random.default_rng([seed, 3])
        optimizer = create_optimizer("cma-es", low, high, population=POPULATION, budget=search, rng=rng)
        while len(batch := optimizer.ask()):
            costs: list[float] = []
            for point in batch:
                settings = {name: float(2.0**value) for name, value in zip(learner.box, point, strict=True)}
                costs.append(train(settings | {"units": round(settings["units"])}))
            optimizer.tell(np.array(costs))
    return points, fits


def _loss(found: Fit) -> float:
    return found.best if np.isfinite(found.best) else float("inf")


def _trained(
    learner: Learner,
    settings: Settings,
    seed: int,
    folder: ResultFolder,
    number: int,
    progress: Callable[[int, float], None],
) -> Fit:
    """Run a training, or continue or read it."""
    if (done := folder.finished(number, FinishedRecord, FinishedHistoryRecord)) is not None:
        arrays = done[1]
        weights = {name.split("/")[1]: array for name, array in arrays.items() if name.startswith("weights/")}
        return Fit(weights, arrays["losses"])
    lesson = learner.lesson(settings, seed)
    found = fit(
        lesson.loss,
        lesson.weights,
        lesson.examples,
        lesson.held_back,
        learning_rate=settings["learning_rate"],
        epochs=learner.epochs,
        batch=learner.batch,
        patience=learner.patience,
        seed=seed,
        checkpoint=folder.checkpoint(number),
        progress=progress,
    )
    found = Fit({**found.weights, **lesson.fixed}, found.losses)
    history = {f"weights/{name}": array for name, array in found.weights.items()}
    result = {"cost": found.best, "settings": dict(settings)}
    folder.finish(number, result, history | {"losses": found.losses})
    return found
