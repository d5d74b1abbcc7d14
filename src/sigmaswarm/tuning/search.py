"""The trials of a tuning run: generations, races of candidates, and checkpoints."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Mask
from sigmaswarm.errors import InputError, TuningStopped
from sigmaswarm.tuning.config import SWARM, SearchConfig
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.optimizers.asktell import AskTell
from sigmaswarm.tuning.optimizers.budget import Budgeted
from sigmaswarm.tuning.problem import Problem
from sigmaswarm.tuning.store import (
    ResultFolder,
    TrialHistoryRecord,
    checkpoint_error,
    finished_trial,
    load_checkpoint,
    save_checkpoint,
)

FIRST_DIVISOR = 12  # a race on MIN_RACED_DRIVES or more drives starts with 1 / FIRST_DIVISOR of them
MIN_RACED_DRIVES = 96
"""Smallest number of drives for a race against the leader. With fewer drives, 1/12 of them is too small a sample for a
test."""
Order = Sequence[int] | NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Leader:
    """Total cost of the best candidate so far, and its cost on each drive, shape (m,)."""

    cost: float
    costs_by_drive: Array


@dataclass(frozen=True, eq=False)
class RaceResult:
    """Costs of a batch, shape (n,), number of filter steps, and number of failures.

    Costs are exact for candidates that were evaluated on all drives.
    """

    costs: Array
    steps: int
    failures: int
    leader: Leader | None = None

    def __add__(self, other: "RaceResult") -> "RaceResult":
        costs = np.concatenate([self.costs, other.costs])
        return RaceResult(costs, self.steps + other.steps, self.failures + other.failures, other.leader)


def rungs(n_candidates: int, n_drives: int) -> list[tuple[int, int]]:
    """Return the numbers of candidates and drives per rung. Each rung halves the candidates and doubles the drives."""
    rungs = [(n_candidates, n_drives // FIRST_DIVISOR if n_drives >= MIN_RACED_DRIVES else min(1, n_drives))]
    while (drives := rungs[-1][1]) < n_drives:
        rungs.append(((rungs[-1][0] + 1) // 2, min(2 * drives, n_drives)))
    return rungs


def leader_at(problem: Problem[Any], point: Array, executor: Executor | None) -> Leader:
    """Evaluate the best point, shape (d,), again, since checkpoints lack its cost on each drive."""
    each = problem.costs_by_drive(point[np.newaxis], range(len(problem.steps)), executor)
    return Leader(float(problem.combined(each)[0]), each[0])


def race(
    problem: Problem[Any],
    points: Array,
    order: Order,
    executor: Executor | None,
    leader: Leader | None = None,
) -> RaceResult:
    """Evaluate points, shape (n, d), on the drives in the given order, and drop the worse half at each rung.

    This is successive halving (K. Jamieson and A. Talwalkar, AISTATS 2016) with drives as the resource. In F-race (M.
    Birattari et al., GECCO 2002), a statistical test decides how many candidates are dropped. One filter takes as long
    as eight filters that run in one vector, so the last candidate of a race is expensive. With many drives, a candidate
    must therefore also be better than the leader, the best candidate so far. The leader's costs are a control variate
    for the costs of dropped candidates. A race that starts with 1/32 instead of 1/12 of the drives is faster, but its
    costs mislead the search.

    With `MIN_RACED_DRIVES` or more drives, points that are not better than ``leader`` by one standard error are also
    dropped. Without a leader, or with only one point, no point is dropped.
    """
    order = np.asarray(order)
    many, n, m = len(order) >= MIN_RACED_DRIVES, len(points), len(order)
    rival = leader if many and n > 1 else None
    each, costs = np.empty((n, 0)), np.full(n, np.inf)
    alive, dropped, steps = np.arange(n), list[NDArray[np.int64]](), 0
    for candidates, drives in [(n, m)] if many and not rival else rungs(n, m):
        compared, fresh = order[: each.shape[1]], order[each.shape[1] : drives]
        ranked = alive[np.argsort(costs[alive], kind="stable")]
        kept = ranked[:candidates]
        if rival and len(compared):
            kept = kept[_ahead(each[kept], costs[kept], rival, compared)]
        alive = np.sort(kept)
        dropped.append(ranked[~np.isin(ranked, kept)])
        if not len(alive):
            break
        column = np.full((n, len(fresh)), np.nan)
        column[alive] = problem.costs_by_drive(points[alive], fresh.tolist(), executor)
        each = np.hstack([each, column])
        steps += len(alive) * int(problem.steps[fresh].sum())
        costs[alive] = problem.combined(_in_order(each[alive], order[:drives]))
        if rival and drives < m:  # the drives so far may be harder or easier than average
            costs[alive] += (
                rival.cost - problem.combined(rival.costs_by_drive[np.newaxis, np.sort(order[:drives])])[0]
            )
    failures = int(np.isinf(costs).sum())
    costs = _behind(costs, alive, dropped, rival.cost if rival else np.inf)
    if not many:
        return RaceResult(costs, steps, failures)
    if len(alive):
        best = int(alive[np.argmin(costs[alive])])
        if costs[best] < (leader.cost if leader else np.inf):  # at equal costs the leader stays
            leader = Leader(float(costs[best]), _in_order(each, order)[best])
    return RaceResult(costs, steps, failures, leader)


def _ahead(each: Array, costs: Array, rival: Leader, drives: NDArray[np.int64]) -> Mask:
    """Select candidates that are better than the leader by more than one standard error of the difference."""
    with np.errstate(invalid="ignore"):  # a failed candidate has infinite costs
        std = (each - rival.costs_by_drive[drives]).std(axis=1, ddof=1)
    return costs + std / np.sqrt(len(drives)) < rival.cost


def _in_order(each: Array, order: NDArray[np.int64]) -> Array:
    """Sort columns by drive into a C-contiguous array, since the rounding of sums depends on order and layout."""
    return np.ascontiguousarray(each[:, np.argsort(order[: each.shape[1]], kind="stable")])


def _behind(
    costs: Array, finished: NDArray[np.int64], dropped: list[NDArray[np.int64]], otherwise: float
) -> Array:
    """Raise the costs of dropped candidates above the finite costs of finished candidates, or to ``otherwise``."""
    shifted, floor = costs.copy(), _highest(costs[finished], otherwise)
    for group in reversed(dropped):
        best = float(costs[group].min(initial=np.inf))
        raised = costs[group] + max(floor - best, 0.0) if np.isfinite(best) else costs[group]
        shifted[group] = np.nextafter(np.maximum(raised, floor), np.inf)
        floor = _highest(shifted[group], otherwise=floor)
    return shifted


def _highest(costs: Array, otherwise: float) -> float:
    finite = costs[np.isfinite(costs)]
    return float(finite.max()) if len(finite) else otherwise


HISTORY: dict[str, type] = {"best": np.float64, "median": np.float64, "steps": np.int64}
"""Names and types of a trial's arrays that have one entry per generation."""


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
    """Read the trials of a finished tuning. Return an empty tuple if a trial is missing."""
    finished = [finished_trial(folder, number) for number in range(count)]
    trials = tuple(_trial(*done) for done in finished if done)
    return trials if len(trials) == count else ()


def _trial(result: dict[str, Any], history: dict[str, Any]) -> Trial:
    return Trial(cost=result["cost"], **history, **result["counts"])


@dataclass(frozen=True, eq=False)
class TrialRunner:
    """Settings that the trials of one tuning share.

    The first generation is drawn around ``center``, shape (d,), or uniformly within the bounds if this is None. Custom
    optimizers that are not subclasses of `AskTell` ignore ``center``.
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
            **({name: getattr(c, name) for name in SWARM} if c.optimizer == "pso" else {}),
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
        """Run one generation. The costs are empty after the end of the trial."""
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
        """Restore the optimizer. Return the history, the number of failures and the leader."""
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
