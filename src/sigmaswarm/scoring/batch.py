"""Scores of many parameter sets on many drives, from the compiled replays."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.filters.batch import Replay, Sums, run_replay
from sigmaswarm.filters.compiled.lanes import LANES
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, outage_replay, tracking_replay


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of every parameter set on every drive; each array has shape (n_sets, n_drives).

    The names and units are those of `Score`; NaN where a score can't be said or the filter failed.
    """

    position_rmse: Array
    heading_rmse: Array
    outage_drift: Array
    fix_rmse: Array
    mean_nis: Array
    failed: NDArray[np.bool_]

    def __getitem__(self, at: tuple[int, int]) -> Score:
        """The score of one set on one drive."""
        numbers = (self.position_rmse, self.heading_rmse, self.outage_drift, self.fix_rmse, self.mean_nis)
        return Score(*(float(a[at]) for a in numbers), failed=bool(self.failed[at]))


class Replayer:
    """Drives made ready once, to be replayed by any number of parameter sets.

    Parameters
    ----------
    drives : sequence of Drive
    outages : bool
        Run the outages too (a second pass over each drive).
    outage_length : float
        s.
    outage_seed : int
        Places the windows.

    Raises
    ------
    AlignmentError
        If a drive never moves far enough to start a filter.
    """

    def __init__(
        self,
        drives: Sequence[Drive],
        *,
        outages: bool,
        outage_length: float = OUTAGE_LENGTH,
        outage_seed: int = 0,
    ) -> None:
        self.drives = tuple(drives)
        self.initial = tuple(initial_state(drive) for drive in drives)
        pairs = list(zip(self.drives, self.initial, strict=True))
        self._tracking = [tracking_replay(d, i) for d, i in pairs]
        self._outages = [
            outage_replay(d, i, length=outage_length, seed=outage_seed) for d, i in pairs
        ] * outages

    @property
    def truth_moments(self) -> list[int]:
        """How many moments of truth each drive is scored at."""
        return [replay.targets.n_positions for replay in self._tracking]

    @cached_property
    def steps_per_set(self) -> int:
        """Filter steps that one parameter set costs, over all passes."""
        return sum(len(replay.timeline.dt) for replay in self._tracking + self._outages)

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Score the sets; the result has the same bits whatever the executor and its number of workers."""
        if not parameter_sets:
            nothing = np.empty((0, len(self.drives)))
            return Scores(*[nothing] * len(_NUMBERS), failed=nothing.astype(np.bool_))
        passes = self._run(self._tracking + self._outages, parameter_sets, executor)
        tracking, outages = passes[: len(self._tracking)], passes[len(self._tracking) :]
        shape = (len(parameter_sets), len(self.drives))
        columns = {name: np.full(shape, np.nan) for name in _NUMBERS}
        failed = np.zeros(shape, dtype=np.bool_)
        for i, (replay, sums) in enumerate(zip(self._tracking, tracking, strict=True)):
            n_fixes = len(replay.timeline.fixes)
            columns["position_rmse"][:, i] = _root_mean(sums.squared_position, replay.targets.n_positions)
            columns["heading_rmse"][:, i] = _root_mean(sums.squared_heading, replay.targets.n_headings)
            columns["fix_rmse"][:, i] = _root_mean(sums.squared_fix, n_fixes)
            columns["mean_nis"][:, i] = sums.nis / n_fixes if n_fixes else np.nan
            failed[:, i] |= sums.failed
        for i, (replay, sums) in enumerate(zip(self._outages, outages, strict=True)):
            columns["outage_drift"][:, i] = _root_mean(sums.squared_position, replay.targets.n_positions)
            failed[:, i] |= sums.failed
        return Scores(**columns, failed=failed)

    @staticmethod
    def _run(
        replays: Sequence[Replay], parameter_sets: Sequence[FilterParameters], executor: Executor | None
    ) -> list[Sums]:
        """Every replay by every set, in chunks of lanes so that all workers have something to do."""
        chunks = [parameter_sets[i : i + LANES] for i in range(0, len(parameter_sets), LANES)]
        jobs = [(replay, chunk) for replay in replays for chunk in chunks]
        done = list((executor.map if executor else map)(run_replay, *zip(*jobs, strict=True))) if jobs else []
        n = len(chunks)
        return [_joined(done[i * n : (i + 1) * n]) for i in range(len(replays))]


_NUMBERS = ("position_rmse", "heading_rmse", "outage_drift", "fix_rmse", "mean_nis")


def _joined(chunks: Sequence[Sums]) -> Sums:
    return Sums(**{name: np.concatenate([getattr(c, name) for c in chunks]) for name in vars(chunks[0])})


def _root_mean(total: Array, count: int) -> Array:
    return np.sqrt(total / count) if count else np.full_like(total, np.nan)
