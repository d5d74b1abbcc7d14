"""The trials of a tuning: ask the optimizer, tell it the costs, and save every generation."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.config import SearchConfig
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.optimizers.budget import Budgeted
from sigmaswarm.tuning.problem import Landscape
from sigmaswarm.tuning.store import ResultFolder, load_checkpoint, save_checkpoint, unreadable


@dataclass(frozen=True)
class Progress:
    """How far a tuning is, told after every generation."""

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
    evaluations, failures : int
        Parameter sets tried, and how many of them failed or could not be scored.
    """

    cost: float
    point: Array
    best: Array
    median: Array
    evaluations: int
    failures: int


@dataclass(frozen=True, eq=False)
class Search:
    """What the trials of one tuning share.

    Attributes
    ----------
    config : SearchConfig
    problem : Landscape
        What is minimized.
    executor : concurrent.futures.Executor or None
        Shares the work of a generation; None: nobody does.
    folder : ResultFolder or None
        Where every generation is saved.
    progress : callable or None
        Told of every generation.
    """

    config: SearchConfig
    problem: Landscape
    executor: Executor | None
    folder: ResultFolder | None
    progress: Callable[[Progress], None] | None

    def trial(self, number: int) -> Trial:
        """Run, resume or look up one trial."""
        done = self.folder.finished(number) if self.folder else None
        if done:
            result, history = done
            return Trial(
                result["cost"], history["point"], history["best"], history["median"], *result["counts"]
            )
        optimizer = self._optimizer(number)
        best, median, failures = self._resumed(number, optimizer)
        while len(costs := self._generation(optimizer, best)):
            best.append(optimizer.global_cost)
            median.append(float(np.median(costs)))
            failures += int(np.isinf(costs).sum())
            self._save(number, optimizer, best, median, failures)
            self._report(number, best)
        counts = (optimizer.spent, failures)
        trial = Trial(optimizer.global_cost, optimizer.global_best, np.array(best), np.array(median), *counts)
        if self.folder:
            history = {"point": trial.point, "best": trial.best, "median": trial.median}
            self.folder.finish(number, {"cost": trial.cost, "counts": list(counts)}, history)
        return trial

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

    def _generation(self, optimizer: Budgeted, best: list[float]) -> Array:
        """Ask for as many points as there are particles, in one batch or several; their costs. None once stalled."""
        costs = np.empty(0)
        if self._stalled(best):
            return costs
        while len(costs) < self.config.particles and len(points := optimizer.ask()):
            told = self.problem.costs(points, self.executor)
            optimizer.tell(told)
            costs = np.concatenate([costs, told])
        return costs

    def _stalled(self, best: list[float]) -> bool:
        patience = self.config.patience
        return patience is not None and len(best) > patience and best[-1] >= best[-1 - patience]

    def _save(
        self, number: int, optimizer: Budgeted, best: list[float], median: list[float], failures: int
    ) -> None:
        if not self.folder:
            return
        state = optimizer.state()
        notes = {"rng": state.pop("rng"), "failures": failures}
        save_checkpoint(self.folder.checkpoint(number), state | {"best": best, "median": median}, notes)

    def _resumed(self, number: int, optimizer: Budgeted) -> tuple[list[float], list[float], int]:
        """Put the optimizer where its checkpoint left it; the history so far."""
        checkpoint = self.folder.checkpoint(number) if self.folder else None
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if checkpoint is None or saved is None:
            return [], [], 0
        arrays, notes = saved
        try:
            optimizer.restore(arrays | {"rng": notes["rng"]})
            return arrays["best"].tolist(), arrays["median"].tolist(), int(notes["failures"])
        except (KeyError, TypeError, ValueError):
            raise unreadable(checkpoint) from None

    def _report(self, number: int, best: list[float]) -> None:
        if self.progress:
            per_trial = self.config.generations
            done = number * per_trial + len(best)
            self.progress(Progress(number, len(best), done, self.config.trials * per_trial, best[-1]))
