"""Scores of many parameter sets on many drives, from the compiled replays."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.filters.batch import Replay, Sums, pack, run_replay
from sigmaswarm.filters.compiled.lanes import LANES
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, forecast_replay, outage_replay, tracking_replay


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of every parameter set on every drive; each array has shape (n_sets, n_drives).

    The names and units are those of `Score`; NaN where a score can't be said or the filter failed.
    """

    position_rmse: Array
    heading_rmse: Array
    outage_drift: Array
    fix_rmse: Array
    forecast_rmse: Array
    innovation_nll: Array
    mean_nis: Array
    mean_nees: Array
    failed: NDArray[np.bool_]

    def __getitem__(self, at: tuple[int, int]) -> Score:
        """The score of one set on one drive."""
        numbers = {name: float(getattr(self, name)[at]) for name in _NUMBERS}
        return Score(**numbers, failed=bool(self.failed[at]))


class Replayer:
    """Drives made ready once, to be replayed by any number of parameter sets.

    Parameters
    ----------
    drives : sequence of Drive
    outages : bool
        Run the outages too (a pass of its own over each drive).
    forecasts : bool
        Run with fixes hidden all over the drive (another pass).
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
        forecasts: bool = False,
        outage_length: float = OUTAGE_LENGTH,
        outage_seed: int = 0,
    ) -> None:
        self.drives = tuple(drives)
        self.initial = tuple(initial_state(drive) for drive in drives)
        self._passes: list[_Pass] = []
        for i, (drive, start) in enumerate(zip(self.drives, self.initial, strict=True)):
            self._passes.append(_Pass(i, tracking_replay(drive, start), _tracking_scores))
            if outages:
                replay = outage_replay(drive, start, length=outage_length, seed=outage_seed)
                self._passes.append(_Pass(i, replay, _outage_scores))
            if forecasts:
                self._passes.append(
                    _Pass(i, forecast_replay(drive, start, seed=outage_seed), _forecast_scores)
                )

    def subset(self, drives: Sequence[int]) -> "Replayer":
        """A replayer of some of the drives, by index, without making anything ready again."""
        part = copy(self)
        part.__dict__.pop("steps", None)
        part.drives = tuple(self.drives[i] for i in drives)
        part.initial = tuple(self.initial[i] for i in drives)
        by_drive: dict[int, list[_Pass]] = {}
        for p in self._passes:
            by_drive.setdefault(p.drive, []).append(p)
        part._passes = [replace(p, drive=at) for at, i in enumerate(drives) for p in by_drive[i]]
        return part

    @property
    def truth_moments(self) -> list[int]:
        """How many moments of truth each drive is scored at."""
        return [p.replay.targets.n_positions for p in self._passes if p.scores is _tracking_scores]

    @property
    def hidden_fixes(self) -> list[int]:
        """How many fixes are hidden to be forecast on each drive; empty without forecasts."""
        return [int(p.replay.timeline.hides.sum()) for p in self._passes if p.scores is _forecast_scores]

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, over all passes, shape (n_drives,)."""
        counts = np.zeros(len(self.drives), dtype=np.int64)
        for p in self._passes:
            counts[p.drive] += len(p.replay.timeline.dt)
        return counts

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Score the sets; the result has the same bits whatever the executor and its number of workers."""
        shape = (len(parameter_sets), len(self.drives))
        columns = {name: np.full(shape, np.nan) for name in _NUMBERS}
        failed = np.zeros(shape, dtype=np.bool_)
        results = (
            self._run([p.replay for p in self._passes], parameter_sets, executor) if parameter_sets else []
        )
        for p, sums in zip(self._passes, results, strict=bool(parameter_sets)):
            for name, values in p.scores(p.replay, sums).items():
                columns[name][:, p.drive] = values
            failed[:, p.drive] |= sums.failed
        return Scores(**columns, failed=failed)

    @staticmethod
    def _run(
        replays: Sequence[Replay], parameter_sets: Sequence[FilterParameters], executor: Executor | None
    ) -> list[Sums]:
        """Every replay by every set, in chunks of lanes so that all workers have something to do."""
        chunks = [pack(parameter_sets[i : i + LANES]) for i in range(0, len(parameter_sets), LANES)]
        jobs = [(replay, chunk) for replay in replays for chunk in chunks]
        done = list((executor.map if executor else map)(run_replay, *zip(*jobs, strict=True))) if jobs else []
        n = len(chunks)
        return [_joined(done[i * n : (i + 1) * n]) for i in range(len(replays))]


_NUMBERS = tuple(field.name for field in fields(Scores) if field.name != "failed")


def _joined(chunks: Sequence[Sums]) -> Sums:
    return Sums(**{name: np.concatenate([getattr(c, name) for c in chunks]) for name in vars(chunks[0])})


@dataclass(frozen=True, eq=False)
class _Pass:
    """One pass over one drive, and what its sums say."""

    drive: int
    replay: Replay
    scores: Callable[[Replay, Sums], dict[str, Array]]


def _tracking_scores(replay: Replay, sums: Sums) -> dict[str, Array]:
    n_positions, n_fixes = replay.targets.n_positions, len(replay.timeline.fixes)
    return {
        "position_rmse": np.sqrt(_mean(sums.squared_position, n_positions)),
        "heading_rmse": np.sqrt(_mean(sums.squared_heading, replay.targets.n_headings)),
        "fix_rmse": np.sqrt(_mean(sums.squared_fix, n_fixes)),
        "innovation_nll": _mean(sums.nis + sums.log_determinant, n_fixes) / 2 + math.log(2 * math.pi),
        "mean_nis": _mean(sums.nis, n_fixes),
        "mean_nees": _mean(sums.nees, n_positions),
    }


def _outage_scores(replay: Replay, sums: Sums) -> dict[str, Array]:
    return {"outage_drift": np.sqrt(_mean(sums.squared_position, replay.targets.n_positions))}


def _forecast_scores(replay: Replay, sums: Sums) -> dict[str, Array]:
    hidden = int(replay.timeline.hides.sum())
    return {"forecast_rmse": np.sqrt(_mean(sums.squared_forecast, hidden))}


def _mean(total: Array, count: int) -> Array:
    return total / count if count else np.full_like(total, np.nan)
