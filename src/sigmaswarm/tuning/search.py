"""The trials of a tuning: get points from the optimizer, compute their costs, save every generation."""

from collections.abc import Callable
from concurrent.futures import Executor
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.tuning.config import SearchConfig
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.optimizers.asktell import AskTell
from sigmaswarm.tuning.optimizers.budget import Budgeted
from sigmaswarm.tuning.problem import Problem
from sigmaswarm.tuning.racing import MANY, Leader, Raced, leader_at, race
from sigmaswarm.tuning.store import (
    ResultFolder,
    TrialHistoryRecord,
    finished_trial,
    load_checkpoint,
    save_checkpoint,
    unreadable,
)


@dataclass(frozen=True)
class Progress:
    """Progress of a tuning, passed to the callback after every generation."""

    trial: int
    generation: int
    done: int
    total: int
    best_cost: float


@dataclass(frozen=True, eq=False)
class Trial:
    """One run of the optimizer.

    Attributes
    ----------
    cost : float
        Of the best point.
    point : ndarray, shape (d,)
        The best point, in search coordinates.
    best : ndarray, shape (generations,)
        Lowest cost so far after each generation: after as many evaluations as there are particles.
    median : ndarray, shape (generations,)
        Median cost of each generation.
    steps : ndarray of int, shape (generations,)
        Filter steps spent after each generation.
    evaluations, failures : int
        Parameter sets tried, and how many of them failed or could not be scored.
    """

    cost: float
    point: Array
    best: Array
    median: Array
    steps: NDArray[np.int64]
    evaluations: int
    failures: int


def saved_trials(folder: Path, count: int) -> tuple[Trial, ...]:
    """Read the trials in the folder of a finished tuning; empty if one is missing."""
    found = [finished_trial(folder, number) for number in range(count)]
    return (
        tuple(
            Trial(cost=result["cost"], **history, **result["counts"])
            for result, history in (done for done in found if done)
        )
        if all(found)
        else ()
    )


@dataclass(frozen=True, eq=False)
class Search:
    """Settings that the trials of one tuning share.

    Attributes
    ----------
    config : SearchConfig
    problem : Problem
        The objective.
    executor : concurrent.futures.Executor or None
        Runs the work of a generation; None runs it in this thread.
    folder : ResultFolder or None
        Where every generation is saved.
    progress : callable or None
        Called after every generation.
    """

    config: SearchConfig
    problem: Problem[Any]
    executor: Executor | None
    folder: ResultFolder | None
    progress: Callable[[Progress], None] | None

    def trial(self, number: int) -> Trial:
        """Run, resume or look up one trial."""
        done = self.folder.finished(number) if self.folder else None
        if self.folder and done:
            result, history = done
            point, space = history["point"], self.problem.space
            if point.shape != space.low.shape or (point < space.low).any() or (point > space.high).any():
                trial = self.folder.path / f"trial-{number:03d}"
                raise InputError(
                    f"{trial / 'history.npz'}: its point is not one of this search; delete {trial} to redo this trial"
                )
            return Trial(cost=result["cost"], **history, **result["counts"])
        optimizer = self._optimizer(number)
        past = self._resumed(number, optimizer)
        while len((told := self._generation(number, optimizer, past)).costs):
            past.best.append(optimizer.global_cost)
            past.median.append(float(np.median(told.costs)))
            past.steps.append(told.steps + (past.steps[-1] if past.steps else 0))
            past.failures += told.failures
            past.leader = told.leader
            self._save(number, optimizer, past)
            self._report(number, past.best)
        history: dict[str, Any] = {"point": optimizer.global_best, **past.arrays()}
        counts: dict[str, Any] = {"evaluations": optimizer.spent, "failures": past.failures}
        if self.folder:
            self.folder.finish(number, {"cost": optimizer.global_cost, "counts": counts}, history)
        return Trial(cost=optimizer.global_cost, **history, **counts)

    def _optimizer(self, number: int) -> Budgeted:
        c = self.config
        return create_optimizer(
            c.optimizer,
            self.problem.space.low,
            self.problem.space.high,
            population=c.particles,
            budget=c.particles * c.generations,
            rng=np.random.default_rng(np.random.SeedSequence(c.seed, spawn_key=(number,))),
            polish=c.polish,
            **c.optimizer_options(),
        )

    def _generation(self, number: int, optimizer: Budgeted, past: "_Past") -> Raced:
        """Run one generation in one or several batches; empty when the trial is over."""
        told = Raced(np.empty(0), 0, 0, past.leader)
        if self._stalled(past.best) and not optimizer.settle():
            return told
        while len(told.costs) < self.config.particles and len(points := optimizer.ask()):
            batch = self._told(number, optimizer.spent, points, told.leader)
            optimizer.tell(batch.costs)
            told += batch
        return told

    def _told(self, number: int, spent: int, points: Array, leader: Leader | None) -> Raced:
        """Compute the costs of a batch on all drives, or by a race over them."""
        if not self.config.racing:
            costs = self.problem.costs(points, self.executor)
            return Raced(costs, len(points) * int(self.problem.steps.sum()), int(np.isinf(costs).sum()))
        chance = np.random.SeedSequence(self.config.seed, spawn_key=(number, spent))
        order = np.random.default_rng(chance).permutation(len(self.problem.steps))
        return race(self.problem, points, order, self.executor, leader)

    def _stalled(self, best: list[float]) -> bool:
        patience = self.config.patience
        return patience is not None and len(best) > patience and best[-1] >= best[-1 - patience]

    def _save(self, number: int, optimizer: Budgeted, past: "_Past") -> None:
        if not self.folder:
            return
        state = optimizer.state()
        notes = {"rng": state.pop("rng"), "failures": past.failures}
        save_checkpoint(self.folder.checkpoint(number), state | past.arrays(), notes)

    def _resumed(self, number: int, optimizer: Budgeted) -> "_Past":
        """Restore the optimizer from its checkpoint; return the history so far."""
        checkpoint = self.folder.checkpoint(number) if self.folder else None
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if checkpoint is None or saved is None:
            return _Past([], [], [], 0, None)
        arrays, notes = saved
        try:
            optimizer.restore(arrays | {"rng": notes["rng"]})
            _require_usable(optimizer)
            costs = {name: arrays[name] for name in ("best", "median", "steps")}
            TrialHistoryRecord(point=optimizer.global_best, **costs)
            best, median, steps = (array.tolist() for array in costs.values())
            return _Past(best, median, steps, int(notes["failures"]), self._leader(optimizer))
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
            raise unreadable(checkpoint) from None

    def _leader(self, optimizer: Budgeted) -> Leader | None:
        """Return the leader of a resumed race: the best point so far, with a finite cost and many drives."""
        needed = self.config.racing and len(self.problem.steps) >= MANY and np.isfinite(optimizer.global_cost)
        return leader_at(self.problem, optimizer.global_best, self.executor) if needed else None

    def _report(self, number: int, best: list[float]) -> None:
        if self.progress:
            per_trial = self.config.generations
            done = number * per_trial + len(best)
            self.progress(Progress(number, len(best), done, self.config.trials * per_trial, best[-1]))


def _require_usable(optimizer: Budgeted) -> None:
    """Raise if a restored optimizer can't continue; only a copy of it is used."""
    if isinstance(optimizer.first, AskTell):
        again = deepcopy(optimizer)
        again.tell(np.zeros(len(again.ask())))


@dataclass
class _Past:
    """History of a trial, one entry per generation."""

    best: list[float]
    median: list[float]
    steps: list[int]
    failures: int
    leader: Leader | None

    def arrays(self) -> dict[str, Any]:
        """Best and median cost, and steps spent, after each generation."""
        steps = np.array(self.steps, dtype=np.int64)
        return {"best": np.array(self.best), "median": np.array(self.median), "steps": steps}
