"""Train a network that assists a tuned filter, and search for good settings."""

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import DriveRecord, drive_record
from sigmaswarm.drives.overlap import TRAINING_DATA_FILE, landmarks, save_landmarks
from sigmaswarm.errors import InputError
from sigmaswarm.files import staged_files, write_atomically, write_json
from sigmaswarm.filters.names import NetworkName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.learned import noise_gru, outage_lstm
from sigmaswarm.learned.fitting import (
    Schedule,
    Settings,
    TrainingResult,
    double_precision,
    fit,
    n_weights,
    part_of,
)
from sigmaswarm.learned.folder import (
    LEARNED_SEEN,
    LearnedNetwork,
    LearnedRecord,
    NetworkRecord,
    TrainingRecord,
)
from sigmaswarm.learned.noise_training import NoiseLearner
from sigmaswarm.learned.outage_training import OutageLearner
from sigmaswarm.record_files import ARRAYS
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.record import FILE
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions

POPULATION = 4  # combinations of settings in a batch of the search


@dataclass(frozen=True)
class TrainingProgress:
    """Progress after an epoch: number ``done`` of at most ``total`` epochs, and lowest validation ``loss``."""

    trial: int
    epoch: int
    done: int
    total: int
    loss: float


Learner = OutageLearner | NoiseLearner
LEARNERS: Mapping[str, type[Learner]] = {outage_lstm.NAME: OutageLearner, noise_gru.NAME: NoiseLearner}
"""Learner of each type of network.

``start`` contains the settings of the first training, and ``box`` the logarithms (base 2) of the search's bounds.
``training_problem`` prepares the input of `fit`. ``finish`` returns the weights of the best network, and further
entries of its record.
"""


@dataclass(frozen=True, eq=False)
class LearnConfig:
    """Type of network, filter, data and options of a training run; saved as config.json.

    Attributes
    ----------
    kind : {"outage-lstm", "noise-gru"}
    parameters : FilterParameters
        The tuned filter.
    drives : sequence of Drive
        Training drives.
    validation : sequence of Drive
        Drives for early stopping, and for the calibration of outage-lstm. The default is the last quarter of each drive
        or, for outage-lstm with three or more drives, the last third of the drives.
    search : int
        Number of further combinations of settings (hidden units, window, learning rate) to try. The combination with
        the lowest loss on the validation data is used.
    seed : int
        The same seed gives identical results on the same machine.
    """

    kind: NetworkName
    parameters: FilterParameters
    drives: Sequence[Drive]
    validation: Sequence[Drive] = ()
    search: int = 0
    seed: int = 0

    def record(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "filter": self.parameters.to_dict(),
            "search": self.search,
            "seed": self.seed,
            "data": [drive_record(drive) for drive in self.drives],
            "validation": [drive_record(drive) for drive in self.validation],
            "versions": versions() | {"jax": version("jax")},
        }

    def split(self) -> tuple[Sequence[Drive], Sequence[Drive]]:
        """Return the training and the validation drives.

        If there are no validation drives, the ends of the training drives are the validation data.
        """
        if self.kind == noise_gru.NAME or self.validation:
            return self.drives, self.validation
        last = len(self.drives) - len(self.drives) // 3  # the calibration needs long drives
        return self.drives[:last], self.drives[last:]


def learn(
    config: LearnConfig,
    out: Path,
    *,
    tuning: Path | None = None,
    resume: bool = False,
    progress: Callable[[TrainingProgress], None] | None = None,
) -> LearnedNetwork:
    """Train a network that assists a tuned filter, without truth.

    Parameters
    ----------
    config : LearnConfig
    out : Path
        Folder of the results, which `sigmaswarm run` and `evaluate` read like a folder of `tune`.
    tuning : Path, optional
        The tuning.toml of the parameters; it is copied to ``out``.
    resume : bool
        Continue an interrupted training. The result is the same as without interruption.
    progress : callable, optional
        Called after every epoch.

    Raises
    ------
    InputError
        If JAX is missing, if the filter or a drive is not supported, or if the folder contains another training run.
    """
    if config.kind not in LEARNERS:
        raise InputError(f"there is no network {config.kind!r}; choose one of {', '.join(LEARNERS)}")
    with double_precision():  # raises at once if JAX is missing
        began, record = time.process_time(), config.record()
    folder = ResultFolder(out, record, resume=resume)
    drives, held_back = config.split()
    learner = LEARNERS[config.kind](drives, held_back, config.parameters, config.seed)
    settings, result = _best_training(learner, folder, config, progress)
    weights, entries = learner.finish(settings, result.weights)
    network = NetworkRecord(
        units=int(settings["units"]),
        window=settings["window"],
        learning_rate=settings["learning_rate"],
        numbers=n_weights(weights),
        **entries,
    )
    training = TrainingRecord(
        seed=config.seed,
        search=config.search,
        driven_s=float(sum(drive.duration for drive in config.drives)),
        epochs=len(result.losses) - 1,
        loss_before=float(result.losses[0, 1]),
        loss=result.best,
        held_back=", ".join(d.name for d in held_back) or "the last quarter of each drive",
    )
    data = [DriveRecord.model_validate(entry) for entry in record["data"]]
    description = LearnedRecord(
        kind=config.kind, network=network, training=training, versions=record["versions"], data=data
    )
    learned = LearnedNetwork(description, weights)
    _save(learned, config, tuning, out)
    write_json(out / "timings.json", {"processor_s": time.process_time() - began})
    return learned


def _save(learned: LearnedNetwork, config: LearnConfig, tuning: Path | None, out: Path) -> None:
    with staged_files(out) as new:
        learned.save(new)
        save_landmarks([landmarks(drive) for drive in config.drives], new / LEARNED_SEEN)
        if tuning is None:
            config.parameters.save(new / FILE)
        else:
            write_atomically(new / FILE, tuning.read_bytes())
            if (tuning.parent / TRAINING_DATA_FILE).exists():
                shutil.copyfile(tuning.parent / TRAINING_DATA_FILE, new / TRAINING_DATA_FILE)


class FinishedRecord(BaseModel, extra="forbid"):
    cost: float | None
    settings: dict[str, float]


class FinishedHistoryRecord(BaseModel):
    """history.npz of a training run: ``losses`` of `TrainingResult`, and the weights."""

    model_config = ARRAYS | ConfigDict(extra="allow")
    losses: np.ndarray[Any, np.dtype[np.float64]]


def _best_training(
    learner: Learner,
    folder: ResultFolder,
    config: LearnConfig,
    progress: Callable[[TrainingProgress], None] | None,
) -> tuple[Settings, TrainingResult]:
    found, total = list[tuple[float, Settings, TrainingResult]](), (1 + config.search) * learner.epochs

    def train(settings: Settings) -> float:
        number = len(found)

        def report(epoch: int, loss: float) -> None:
            if progress:
                progress(TrainingProgress(number, epoch, number * learner.epochs + epoch, total, loss))

        trained = _trained(learner, settings, config.seed, folder, number, report)
        cost = trained.best if np.isfinite(trained.best) else float("inf")
        found.append((cost, settings, trained))
        return cost

    train(learner.start)
    if config.search:
        low, high = np.array(list(learner.box.values()), dtype=np.float64).T
        rng, budget = np.random.default_rng([config.seed, 3]), config.search
        optimizer = create_optimizer("cma-es", low, high, population=POPULATION, budget=budget, rng=rng)
        while len(batch := optimizer.ask()):
            costs: list[float] = []
            for point in batch:
                settings = {name: float(2.0**value) for name, value in zip(learner.box, point, strict=True)}
                costs.append(train(settings | {"units": round(settings["units"])}))
            optimizer.tell(np.array(costs))
    _, settings, best = min(found, key=lambda training: training[0])
    return settings, best


def _trained(
    learner: Learner,
    settings: Settings,
    seed: int,
    folder: ResultFolder,
    number: int,
    progress: Callable[[int, float], None],
) -> TrainingResult:
    if (done := folder.finished(number, FinishedRecord, FinishedHistoryRecord)) is not None:
        return TrainingResult(part_of(done[1], "weights"), done[1]["losses"])
    problem = learner.training_problem(settings, seed)
    schedule = Schedule(settings["learning_rate"], learner.epochs, learner.batch, learner.patience, seed)
    fitted = fit(problem, schedule, checkpoint=folder.checkpoint(number), progress=progress)
    fitted = TrainingResult({**fitted.weights, **problem.fixed}, fitted.losses)
    history = {f"weights/{name}": array for name, array in fitted.weights.items()}
    result = {"cost": fitted.best, "settings": dict(settings)}
    folder.finish(number, result, history | {"losses": fitted.losses})
    return fitted
