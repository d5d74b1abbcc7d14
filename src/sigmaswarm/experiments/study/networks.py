"""Networks of a study. Each network is trained on the training drives of a trial, for the filter of this trial.

Each network has a folder in learned/, in the format of `sigmaswarm learn`. Networks are trained one after the other, so
that the processor time of each training run can be measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.config import ALL, NETWORK_FILTER, NETWORKS
from sigmaswarm.experiments.study.design import Design, Filters, Task
from sigmaswarm.filters.names import NetworkName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.learned.folder import LearnedNetwork, load_learned
from sigmaswarm.learned.learn import LEARNERS, LearnConfig, learn
from sigmaswarm.learned.noise_gru import NoiseRun
from sigmaswarm.learned.outage_lstm import OutageRun

MIN_DRIVING_TIME = 21.0
"""Shortest time of a usable drive after the filter's start, s.

This time is sufficient for a segment of 20 s, and for an outage from 10 to 20 s after the filter's start.
"""
MIN_TIME_OF_ONLY_DRIVE = 80.0
"""Shortest time of a single training drive after the filter's start, s."""
MIN_DRIVES_TO_SPLIT = 3
"""Smallest number of drives at which the last third is held back for early stopping and calibration."""


@dataclass(frozen=True, eq=False)
class TrainingDrives:
    """Training and validation drives of a network. ``driven`` is the total time after the filters' starts, s."""

    training: tuple[Drive, ...]
    held_back: tuple[Drive, ...]
    driven: float


@dataclass(frozen=True)
class Training:
    """Training run of a network in a trial on ``minutes`` of driving, by default the study's ``learn_minutes``."""

    network: NetworkName
    trial: int
    minutes: float | None = None

    @property
    def task(self) -> Task:
        return Task("honest", self.network, ALL, self.trial)

    @property
    def folder(self) -> str:
        what = f"trial-{self.trial:03d}" if self.minutes is None else f"curve-{self.minutes:g}-minutes"
        return f"learned/{self.network}/{what}"

    @property
    def epochs(self) -> int:
        return LEARNERS[self.network].epochs


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A trained network, its filter, and the driving time of its training data."""

    parameters: FilterParameters
    learned: LearnedNetwork
    driven: float  # s

    @property
    def run(self) -> Callable[..., OutageRun | NoiseRun]:
        return partial(self.learned.run, parameters=self.parameters)


Networks = Mapping[Task, TrainedNetwork]


def training_drives(design: Design, trial: int, minutes: float) -> TrainingDrives:
    """Draw ``minutes`` of driving from a trial's training drives: whole drives, and the beginning of one more.

    For a larger number of minutes, drives are added to those of a smaller number. If the drives are too few for
    training, more drives are drawn, and their total time exceeds ``minutes``.
    """
    remaining, whole, begun, longest, driven = 60.0 * minutes, list[Drive](), list[Drive](), 0.0, 0.0
    order = design.rng(trial, "lessons").permutation(design.split(trial)[0]).tolist()
    for ready in (design.prepared[i] for i in order):
        drive, start = ready.drive, ready.initial.time
        if (length := float(drive.imu.time[-1]) - start) < MIN_DRIVING_TIME:
            continue
        enough = len(whole) >= MIN_DRIVES_TO_SPLIT or longest >= MIN_TIME_OF_ONLY_DRIVE
        if remaining <= 0 or (remaining < MIN_DRIVING_TIME and enough):
            if enough:
                break
            remaining = 0.0  # one more complete drive
        took = min(length, remaining) if remaining >= MIN_DRIVING_TIME else length
        if took == length:
            whole.append(drive)
        else:
            begun.append(clip(drive, end=start + took))
        longest, driven, remaining = max(longest, took), driven + took, remaining - took
    chosen = begun + whole  # complete drives are last, since the last third is held back
    if len(chosen) < MIN_DRIVES_TO_SPLIT and longest < MIN_TIME_OF_ONLY_DRIVE:
        raise InputError(
            f"trial {trial} has too little data to train networks, which need {MIN_DRIVES_TO_SPLIT} drives of "
            f"{MIN_DRIVING_TIME:g} s after the start of the filter, or one drive of {MIN_TIME_OF_ONLY_DRIVE:g} s; "
            'add drives or, if the drives are simulated, add "urban" to maneuvers'
        )
    count = len(chosen) - len(chosen) // MIN_DRIVES_TO_SPLIT
    return TrainingDrives(tuple(chosen[:count]), tuple(chosen[count:]), driven)


def trainings(design: Design) -> list[Training]:
    """List the training runs of every trial, and those for the learning curves of the first trial."""
    if not design.config.rivals:
        return []
    trials = range(design.config.trials)
    driven = [training_drives(design, trial, design.config.learn_minutes).driven for trial in trials]
    of_trials = [Training(network, trial) for trial in trials for network in NETWORKS]
    doubled = (2.0 * 2.0 ** np.arange(12)).tolist()  # minutes
    curve = [minutes for minutes in doubled if minutes < 0.9 * (driven[0] / 60.0)]
    return of_trials + [Training(network, 0, minutes) for minutes in curve for network in NETWORKS]


def train_all(
    design: Design, parameters: Filters, folder: Path, progress: Callable[[int, Task], None]
) -> dict[Training, TrainedNetwork]:
    """Perform, continue or read all training runs, one after the other.

    ``progress`` is called with the number of finished generations and epochs, and with the task.
    """
    done = len(list(design.tasks)) * design.config.generations
    trained: dict[Training, TrainedNetwork] = {}
    for training in trainings(design):
        drives = training_drives(design, training.trial, training.minutes or design.config.learn_minutes)
        out = folder / training.folder
        supported = parameters[Task("honest", NETWORK_FILTER, ALL, training.trial)]
        finished = (out / "timings.json").exists()  # the last file that `learn` writes
        learned = load_learned(out) if finished else None
        seed = design.config.seed + training.trial
        learned = learned or learn(
            LearnConfig(training.network, supported, drives.training, drives.held_back, seed=seed),
            out,
            resume=True,
            progress=lambda now, before=done, task=training.task: progress(before + now.epoch, task),
        )
        trained[training] = TrainedNetwork(supported, learned, drives.driven)
        done += training.epochs
        progress(done, training.task)
    return trained
