"""The networks of a study: each trained beside the same trial's filter, on that trial's training drives alone.

Each has a folder in learned/, as `sigmaswarm learn` makes it. They are trained one after the other, so that the
processor time of each is its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sigmaswarm.experiments.study.config import ALL, BESIDE
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.lessons import curve_minutes, lessons
from sigmaswarm.filters.names import NetworkName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.learned.fitting import exact
from sigmaswarm.learned.folder import Learned, load_learned
from sigmaswarm.learned.learn import LEARNERS, learn
from sigmaswarm.tuning.options import require_packages


@dataclass(frozen=True)
class Training:
    """One training: a network, in a trial, on some minutes of driving; None: on all that a network learns from."""

    network: NetworkName
    trial: int
    minutes: float | None = None

    @property
    def task(self) -> Task:
        """Its place among the tunings."""
        return Task("honest", self.network, ALL, self.trial)

    @property
    def folder(self) -> str:
        """Relative to the study's."""
        what = f"trial-{self.trial:03d}" if self.minutes is None else f"curve-{self.minutes:g}-minutes"
        return f"learned/{self.network}/{what}"


@dataclass(frozen=True, eq=False)
class Taught:
    """A network that was trained, and the filter beside it.

    Attributes
    ----------
    parameters : FilterParameters
    learned : Learned
    driven : float
        s that it learned from, behind the starts of filters.
    """

    parameters: FilterParameters
    learned: Learned
    driven: float


def require_rivals() -> None:
    """Say in one line what the rivals need and is not installed.

    Raises
    ------
    InputError
        If a package is missing.
    """
    with exact():
        require_packages("bo")


def trainings(design: Design) -> list[Training]:
    """All trainings of a study: of every trial, and of the learning curves.

    Raises
    ------
    InputError
        If a trial has too little to train on.
    """
    networks, trials = design.config.networks, range(design.config.trials if design.config.networks else 0)
    for trial in trials:
        lessons(design, trial, design.config.learn_minutes)
    of_trials = [Training(network, trial) for trial in trials for network in networks]
    minutes = curve_minutes(design) if networks else []
    return of_trials + [Training(network, 0, each) for each in minutes for network in networks]


def epochs_of(training: Training) -> int:
    """At most."""
    return LEARNERS[training.network].epochs


def train_all(
    design: Design,
    each: Sequence[Training],
    parameters: Mapping[Task, FilterParameters],
    folder: Path,
    progress: Callable[[int, Task], None],
) -> dict[Training, Taught]:
    """All trainings, one after the other, after all tunings; ``progress`` is told how much is done of both together."""
    done = len(list(design.tasks)) * design.config.generations
    taught: dict[Training, Taught] = {}
    for training in each:

        def told(epoch: int, before: int = done, task: Task = training.task) -> None:
            progress(before + epoch, task)

        taught[training] = train(design, training, parameters, folder, told)
        done += epochs_of(training)
        progress(done, training.task)
    return taught


def train(
    design: Design,
    training: Training,
    parameters: Mapping[Task, FilterParameters],
    folder: Path,
    progress: Callable[[int], None],
) -> Taught:
    """Train a network, go on with it, or look it up where it is done."""
    minutes = design.config.learn_minutes if training.minutes is None else training.minutes
    of = lessons(design, training.trial, minutes)
    beside = parameters[Task("honest", BESIDE, ALL, training.trial)]
    out = folder / training.folder
    done = load_learned(out) if (out / "timings.json").exists() else None  # the last file that `learn` writes
    learned = done or learn(
        training.network,
        beside,
        of.shown,
        out=out,
        validation=of.held_back,
        seed=design.config.seed + training.trial,
        resume=True,
        progress=lambda told: progress(told.epoch),
    )
    return Taught(beside, learned, of.driven)
