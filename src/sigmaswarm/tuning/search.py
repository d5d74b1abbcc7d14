"""The trials of a tuning run: generations and checkpoints."""

from collections.abc import Callable
from concurrent.futures import Executor
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError, TuningStopped
from sigmaswarm.tuning.config import SearchConfig
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.optimizers.asktell import AskTell
from sigmaswarm.tuning.optimizers.budget import Budgeted
from sigmaswarm.tuning.problem import Problem
from sigmaswarm.tuning.racing import MIN_RACED_DRIVES, Leader, RaceResult, leader_at, race
from sigmaswarm.tuning.store import (
    ResultFolder,
    TrialHistoryRecord,
    checkpoint_error,
    finished_trial,
    load_checkpoint,
    save_checkpoint,
)

HISTORY: dict[str, type] = {"best": np.float64, "median": np.float64, "steps": np.int64}
"""Arrays of a trial with one entry per generation."""


@dataclass(frozen=True)
class Progress:
    """Progress of a tuning run, passed to the callback after every generation.

    ``done`` and ``total`` count the generations of all trials. ``best_cost`` is the lowest cost of this trial so far,
    and ``parameters`` are the corresponding parameters (None if no cost was finite).
    """

    trial: int
    generation: int
    done: int
    total: int
    best_cost: float
    parameters: Any = None


@dataclass(frozen=True, eq=False)
class Trial:
    """One run of the optimizer.

    Attributes
    ----------
    cost : float
        Lowest cost.
    point : ndarray, shape (d,)
        The best point, in search coordinates.
    best : ndarray, shape (generations,)
        Lowest cost so far.
    median : ndarray, shape (generations,)
        Median cost of each generation.
    steps : ndarray of int, shape (generations,)
        Total number of filter steps after each generation.
    evaluations, failures : int
        Number of evaluated parameter sets, and number of these that failed.
    """

    cost: float
    point: Array
    best: Array
    median: Array
    steps: NDArray[np.int64]
    evaluations: int
    failures: int


def saved_trials(folder: Path, count: int) -> tuple[Trial, ...]:
    """Read the trials of a finished tuning; return an empty tuple if a trial is missing."""
    finished = [finished_trial(folder, number) for number in range(count)]
    trials = tuple(_trial(*done) for done in finished if done)
    return trials if len(trials) == count else ()


def _trial(result: dict[str, Any], history: dict[str, Any]) -> Trial:
    return Trial(cost=result["cost"], **history, **result["counts"])


@dataclass(frozen=True, eq=False)
class TrialRunner:
    """Settings that the trials of one tuning share.

    The first generation is drawn around ``center``, shape (d,); if None, uniformly within the bounds. Custom optimizers
    that are not subclasses of `AskTell` ignore ``center``.
    """

    problem: Problem[Any]
    executor: Executor | None
    folder: ResultFolder | None = None
    progress: Callable[[Progress], object] | None = None
    center: Array | None = None

    @property
    def config(self) -> SearchConfig:
        return self.problem.config

    def trial(self, number: int) -> Trial:
        """Return a trial: read it from the folder, resume it, or run it."""
        if self.folder and (done := self.folder.finished(number)):
            return self._checked(_trial(*done), self.folder.path / f"trial-{number:03d}")
        c, space = self.config, self.problem.space
        optimizer = create_optimizer(
            c.optimizer,
            space.low,
            space.high,
            population=c.particles,
            budget=c.particles * c.generations,
            rng=np.random.default_rng(np.random.SeedSequence(c.seed, spawn_key=(number,))),
            polish=c.polish,
            **c.optimizer_options(),
        )
        if self.center is not None:
            optimizer.begin_near(self.center)
        history, failures, leader = self._resumed(number, optimizer)
        while len((race := self._generation(number, optimizer, history["best"], leader)).costs):
            failures, leader = failures + race.failures, race.leader
            steps = race.steps + int(history["steps"].max(initial=0))
            latest = {"best": optimizer.global_cost, "median": np.median(race.costs), "steps": steps}
            history = {name: np.append(history[name], latest[name]) for name in HISTORY}
            if self.folder:
                state = optimizer.state()
                notes = {"rng": state.pop("rng"), "failures": failures}
                save_checkpoint(self.folder.checkpoint(number), state | history, notes)
            if self.progress:
                generation = len(history["best"])
                done, total = number * c.generations + generation, c.trials * c.generations
                cost = optimizer.global_cost
                best = self.problem.parameters(optimizer.global_best) if np.isfinite(cost) else None
                if self.progress(Progress(number, generation, done, total, cost, best)) is False:
                    raise TuningStopped(
                        f"stopped after {done} of {total} generations; resume=True continues a run with a folder"
                    )
        history = {"point": optimizer.global_best, **history}
        result = {
            "cost": optimizer.global_cost,
            "counts": {"evaluations": optimizer.spent, "failures": failures},
        }
        if self.folder:
            self.folder.finish(number, result, history)
        return _trial(result, history)

    def _checked(self, trial: Trial, folder: Path) -> Trial:
        low, high = self.problem.space.low, self.problem.space.high
        if trial.point.shape == low.shape and np.all((low <= trial.point) & (trial.point <= high)):
            return trial
        raise InputError(
            f"{folder / 'history.npz'}: the best point is not in the search space of this tuning; delete {folder} to "
            "redo this trial"
        )

    def _generation(self, number: int, optimizer: Budgeted, best: Array, leader: Leader | None) -> RaceResult:
        """Run one generation; the costs are empty after the end of the trial."""
        race = RaceResult(np.empty(0), 0, 0, leader)
        patience = self.config.patience
        stalled = patience is not None and len(best) > patience and best[-1] >= best[-1 - patience]
        if stalled and not optimizer.end_global_search():
            return race
        while len(race.costs) < self.config.particles and len(points := optimizer.ask()):
            batch = self._batch(number, optimizer.spent, points, race.leader)
            optimizer.tell(batch.costs)
            race += batch
        return race

    def _batch(self, number: int, spent: int, points: Array, leader: Leader | None) -> RaceResult:
        steps = self.problem.steps
        if not self.config.racing:
            costs = self.problem.costs(points, self.executor)
            return RaceResult(costs, len(points) * int(steps.sum()), int(np.isinf(costs).sum()))
        chance = np.random.SeedSequence(self.config.seed, spawn_key=(number, spent))
        order = np.random.default_rng(chance).permutation(len(steps))
        return race(self.problem, points, order, self.executor, leader)

    def _resumed(self, number: int, optimizer: Budgeted) -> tuple[dict[str, Array], int, Leader | None]:
        """Restore the optimizer; return the history, the number of failures and the leader."""
        history: dict[str, Array] = {name: np.empty(0, kind) for name, kind in HISTORY.items()}
        checkpoint = self.folder.checkpoint(number) if self.folder else None
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if checkpoint is None or saved is None:
            return history, 0, None
        arrays, notes = saved
        try:
            optimizer.restore(arrays | {"rng": notes["rng"]})
            if isinstance(optimizer.first, AskTell):  # a step of a copy fails if the state is inconsistent
                copy = deepcopy(optimizer)
                copy.tell(np.zeros(len(copy.ask())))
            history = {name: arrays[name] for name in HISTORY}
            TrialHistoryRecord(point=optimizer.global_best, **history)
            failures = int(notes["failures"])
            races = self.config.racing and len(self.problem.steps) >= MIN_RACED_DRIVES
            if not races or not np.isfinite(optimizer.global_cost):
                return history, failures, None
            return history, failures, leader_at(self.problem, optimizer.global_best, self.executor)
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
            raise checkpoint_error(checkpoint) from None
