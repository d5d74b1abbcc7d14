"""Search for better offsets of a bank's filters by differential evolution; each candidate replays the last minute.

Source: R. Storn and K. Price, Differential evolution, Journal of Global Optimization 11, 1997 (rand/1/bin). Each search
begins with the population of the previous search. A search runs in a thread, while the filters of the bank continue.
"""

import os
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.events import FIX, ODOMETER
from sigmaswarm.drives.tables import Mask
from sigmaswarm.drives.timeline import FIRST_AXIS, Q_SCALE
from sigmaswarm.filters.bank.offsets import OffsetPrior
from sigmaswarm.filters.compiled import swarm
from sigmaswarm.filters.compiled.layout import CONSTANT_ROWS, SUM_ROWS, WIDEST, R
from sigmaswarm.filters.compiled.run import (
    NO_INNOVATIONS,
    NO_RECORD,
    NO_TARGETS,
    SINCE,
    new_cursor,
    run_lanes,
)
from sigmaswarm.filters.constants import INNOVATION_DOF
from sigmaswarm.filters.kernel_array import KernelArray

GENERATIONS = 8
WEIGHT, CROSSOVER = 0.7, 0.9  # F and CR of differential evolution
CONVERGENCE_TIME = 2.0  # s at the start of a replay, in which filters with new offsets converge; not scored
MIN_SCORED_FIXES = 8  # smallest number of scored fixes for a result
MAX_OFFSET = 8.0  # largest offset, in standard deviations of its prior


@dataclass(frozen=True)
class FilterEvidence:
    """Evidence of a filter, and the time ``at`` of its last fix, s."""

    evidence: float
    at: float

    def then(self, time: Array, losses: Array) -> "FilterEvidence":
        """Return the evidence after fixes at ``time``, s: older evidence decays, and each fix subtracts its loss."""
        if not len(time):
            return self
        decay = np.exp((np.append(self.at, time) - time[-1]) / swarm.EVIDENCE_LASTS)
        return FilterEvidence(float(decay[0] * self.evidence - decay[1:] @ losses), float(time[-1]))


@dataclass(frozen=True, eq=False)
class LoggedSteps:
    """Logged steps of a filter bank (k, N_LOG_ROW), and the other inputs of `run_lanes`."""

    kernel: str
    rows: Array
    lever: Array

    def run(self, lanes: Array) -> Array:
        """Run filters (N_KEPT, m) over all steps, in place. Return each filter's loss over the scored fixes, (m,).

        The loss is the negative log-likelihood under Student's t, as in the objective ``innovation-t``.
        """
        cursor = self._cursor
        if len(self.rows):
            scored = np.searchsorted(self.rows[:, swarm.T_TIME], self._begins + CONVERGENCE_TIME)
            self._run(lanes, cursor, int(scored))
        before = _loss(lanes)
        self._run(lanes, cursor, len(self.rows))
        return _loss(lanes) - before

    def followed(self, lane: Array, known: FilterEvidence) -> tuple[Array, FilterEvidence]:
        """Return the kernel rows (N_KEPT,) and the evidence of a filter after all logged steps."""
        lanes = np.repeat(lane[:, np.newaxis], WIDEST, axis=1)
        fixes = np.flatnonzero(self.rows[:, swarm.T_FLAGS].astype(np.uint16) & FIX)
        innovations = np.empty((len(fixes), 5))
        self._run(lanes, self._cursor, len(self.rows), innovations)
        return lanes[:, 0], known.then(self.rows[fixes, swarm.T_TIME], _evidence_losses(*innovations.T))

    @property
    def _cursor(self) -> Array:
        cursor = new_cursor()
        if len(self.rows):
            cursor[SINCE] = self.rows[0, swarm.T_SINCE] - self.rows[0, swarm.T_STEP][Q_SCALE]
        return cursor

    def _run(self, lanes: Array, cursor: Array, stop: int, innovations: Array = NO_INNOVATIONS) -> None:
        """Run the filters from step ``cursor`` up to the step before ``stop``.

        ``lanes`` and ``cursor`` change in place.
        """
        k = len(self.rows)
        flags, steps = self.rows[:, swarm.T_FLAGS].astype(np.uint16), self.rows[:, swarm.T_STEP]
        drive = (
            np.ascontiguousarray(steps[:, :FIRST_AXIS]),
            np.arange(k, dtype=np.int32),
            np.ascontiguousarray(steps[:, FIRST_AXIS:]),
            flags,
            np.ascontiguousarray(self.rows[flags & FIX > 0, swarm.T_FIX]),
            np.ascontiguousarray(self.rows[flags & ODOMETER > 0, swarm.T_WHEELS]),
            self.lever,
            NO_TARGETS,
            np.zeros(k, dtype=np.int32),
        )
        run_lanes(self.kernel, drive, lanes, cursor, stop, NO_RECORD, innovations)

    @property
    def _begins(self) -> float:
        return float(self.rows[0, swarm.T_TIME] - self.rows[0, swarm.T_STEP][0])

    @property
    def n_scored(self) -> int:
        if not len(self.rows):
            return 0
        is_fix = (self.rows[:, swarm.T_FLAGS].astype(np.int64) & FIX) > 0
        return int((is_fix & (self.rows[:, swarm.T_TIME] >= self._begins + CONVERGENCE_TIME)).sum())


@np.errstate(all="ignore")  # a filter may fail
def _loss(lanes: Array) -> Array:
    determinants = lanes[R.LOG_DET] + np.log(lanes[R.DET])
    return 0.5 * determinants + 0.5 * (INNOVATION_DOF + 2.0) * (lanes[R.LOG_TAIL] + np.log(lanes[R.TAIL]))


@np.errstate(all="ignore")
def _evidence_losses(x: Array, y: Array, xx: Array, xy: Array, yy: Array) -> Array:
    """Return the loss of each fix for `FilterEvidence`, (f,), from nu (m) and S (m2) (see `compiled.swarm`)."""
    det = xx * yy - xy * xy
    nis = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det
    losses = 0.5 * np.log(det) + 0.5 * np.minimum(nis, swarm.LARGEST_NIS)
    return np.where((det > 0.0) & np.isfinite(det) & (nis >= 0.0), losses, np.inf)


FUZZY_FACTORS = R.TIMES_R, R.TIMES_Q
"""Rows of a fuzzy filter's factors of R and Q; these factors are reset to 1 when the constants change."""


def with_zero_sums(lanes: Array) -> Array:
    """Return copies of filters (N_KEPT, m) with the same state, with sums of 0 and fuzzy factors of 1."""
    fresh = lanes.copy()
    fresh[SUM_ROWS] = 0.0
    lasting = [R.REJECTED, R.RECENT, R.OUTLIERS, R.SPAN, R.QUICK, R.SLOW, R.HEADING, R.OK]
    fresh[lasting] = lanes[lasting]
    fresh[[R.DET, R.TAIL, *FUZZY_FACTORS]] = 1.0
    return fresh


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search: the best filter, and the population with which the next search begins."""

    offsets: Array  # (d,)
    lane: Array  # (N_KEPT,), kernel rows at the end of the replay: see `compiled.layout`
    known: FilterEvidence
    population: Array  # (LANES, d)


def search(
    prior: OffsetPrior,
    steps: LoggedSteps,
    start: Array,
    known: FilterEvidence,
    leader: Array,
    population: Array,
    nominal_interval: float,
    seed: Sequence[int],
) -> SearchResult | None:
    """Search for the best offsets over some steps. Return None if too few fixes are scored or all filters fail.

    ``start`` (N_KEPT,) and ``known`` are the filter and its evidence before the steps. ``leader`` (d,) contains the
    offsets of the filter with the largest weight, which replace the last member of ``population`` (LANES, d).
    """
    rng = np.random.default_rng(seed)
    if steps.n_scored < MIN_SCORED_FIXES:
        return None
    own = KernelArray((prior.tuning,)).constants(nominal_interval)[:, :1]

    def begun(offsets: Array) -> Array:
        lanes = np.repeat(with_zero_sums(start[:, np.newaxis]), len(offsets), axis=1)
        lanes[CONSTANT_ROWS] = prior.constants(own, offsets)
        return lanes

    def costs(offsets: Array) -> Array:
        lanes = begun(offsets)
        losses = steps.run(lanes)
        losses[(lanes[R.OK] != 1.0) | ~np.isfinite(losses)] = np.inf
        return swarm.EVIDENCE_COUNTS * losses + prior.penalty(offsets)

    offsets = population.copy()
    offsets[-1] = leader
    cost = costs(offsets)
    for _ in range(GENERATIONS):
        trial = _trials(offsets, prior, rng)
        trial_cost = costs(trial)
        better: Mask = trial_cost < cost
        offsets[better], cost[better] = trial[better], trial_cost[better]
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        return None
    lane, known = steps.followed(begun(offsets[best : best + 1])[:, 0], known)
    return SearchResult(offsets[best], lane, known, offsets)


def _trials(offsets: Array, prior: OffsetPrior, rng: np.random.Generator) -> Array:
    """Return a trial point for each member: its crossover with a + F (b - c), where a, b, c are three other members."""
    n, d = offsets.shape
    others = np.array([rng.permutation(np.delete(np.arange(n), i))[:3] for i in range(n)])
    a, b, c = (offsets[others[:, k]] for k in range(3))
    moved = a + WEIGHT * (b - c)
    crossed = rng.random((n, d)) < CROSSOVER
    crossed[np.arange(n), rng.integers(d, size=n)] = True
    trial = np.where(crossed, moved, offsets)
    return np.clip(trial, -MAX_OFFSET * prior.std, MAX_OFFSET * prior.std) * prior.lasting


@cache
def _searcher() -> ThreadPoolExecutor:
    """Return the executor, with one thread, for the searches of all banks in a process."""
    return ThreadPoolExecutor(1, thread_name_prefix="swarm")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_searcher.cache_clear)  # the thread does not exist in a forked process


@dataclass(frozen=True, eq=False)
class PendingSearch:
    """A search over logged steps. ``logged`` is the number of the first step after these steps.

    ``leader`` is the index of the filter with the largest weight. The search starts from an earlier state of this
    filter or, if it is a copy, of its original. In a forked process, a copy of this object searches in the calling
    thread. An unpickled copy starts the search again.
    """

    logged: int
    leader: int
    arguments: tuple[Any, ...]
    process: int
    found: Future[SearchResult | None]

    @classmethod
    def begun(cls, logged: int, leader: int, *arguments: Any) -> "PendingSearch":
        return cls(logged, leader, arguments, os.getpid(), _searcher().submit(search, *arguments))

    def result(self) -> SearchResult | None:
        return self.found.result() if self.process == os.getpid() else search(*self.arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return PendingSearch.begun, (self.logged, self.leader, *self.arguments)
