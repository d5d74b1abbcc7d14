"""The trials of a tuning: ask the swarm, tell it the costs, and save every generation."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.config import SearchConfig
from sigmaswarm.tuning.optimizers.pso import ParticleSwarm
from sigmaswarm.tuning.problem import Problem
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
        Lowest cost so far after each generation.
    median : ndarray, shape (generations,)
        Median cost of each generation's particles.
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
    problem : Problem
        What is minimized.
    executor : concurrent.futures.Executor
        Shares the work.
    folder : ResultFolder or None
        Where every generation is saved.
    progress : callable or None
        Told of every generation.
    """

    config: SearchConfig
    problem: Problem[Any]
    executor: Executor
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
        swarm = self._swarm(number)
        best, median, failures = self._resumed(number, swarm)
        while len(best) < self.config.generations and not self._stalled(best):
            costs = self.problem.costs(swarm.ask(), self.executor)
            swarm.tell(costs)
            best.append(swarm.global_cost)
            median.append(float(np.median(costs)))
            failures += int(np.isinf(costs).sum())
            self._save(number, swarm, best, median, failures)
            self._report(number, best)
        counts = (len(best) * self.config.particles, failures)
        trial = Trial(swarm.global_cost, swarm.global_best, np.array(best), np.array(median), *counts)
        if self.folder:
            history = {"point": trial.point, "best": trial.best, "median": trial.median}
            self.folder.finish(number, {"cost": trial.cost, "counts": list(counts)}, history)
        return trial

    def _swarm(self, number: int) -> ParticleSwarm:
        c = self.config
        rng = np.random.default_rng(np.random.SeedSequence(c.seed, spawn_key=(number,)))
        return ParticleSwarm(
            self.problem.space.low,
            self.problem.space.high,
            c.particles,
            rng,
            inertia=c.inertia,
            cognitive=c.cognitive,
            social=c.social,
            zero_velocity_at_bounds=c.zero_velocity_at_bounds,
        )

    def _stalled(self, best: list[float]) -> bool:
        patience = self.config.patience
        return patience is not None and len(best) > patience and best[-1] >= best[-1 - patience]

    def _save(
        self, number: int, swarm: ParticleSwarm, best: list[float], median: list[float], failures: int
    ) -> None:
        if not self.folder:
            return
        state = swarm.state()
        notes = {"rng": state.pop("rng"), "failures": failures}
        save_checkpoint(self.folder.checkpoint(number), state | {"best": best, "median": median}, notes)

    def _resumed(self, number: int, swarm: ParticleSwarm) -> tuple[list[float], list[float], int]:
        """Put the swarm where its checkpoint left it; the history so far."""
        checkpoint = self.folder.checkpoint(number) if self.folder else None
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if checkpoint is None or saved is None:
            return [], [], 0
        arrays, notes = saved
        try:
            swarm.restore(arrays | {"rng": notes["rng"]})
            return arrays["best"].tolist(), arrays["median"].tolist(), int(notes["failures"])
        except (KeyError, TypeError, ValueError):
            raise unreadable(checkpoint) from None

    def _report(self, number: int, best: list[float]) -> None:
        if self.progress:
            per_trial = self.config.generations
            done = number * per_trial + len(best)
            self.progress(Progress(number, len(best), done, self.config.trials * per_trial, best[-1]))
