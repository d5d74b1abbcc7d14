"""Scores of many parameter sets on many drives, from the compiled replays."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import groupby
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.filters.packing import pack
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.replay import Replay, Sums, joined, run_replays
from sigmaswarm.filters.student import INNOVATION_DOF
from sigmaswarm.fleets.held import Held, Here
from sigmaswarm.scoring.jobs import cores, jobs_for
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
    innovation_t: Array
    forecast_t: Array
    mean_nis: Array
    mean_nees: Array
    failed: NDArray[np.bool_]

    def __getitem__(self, at: tuple[int, int]) -> Score:
        """The score of one set on one drive."""
        numbers = {name: float(getattr(self, name)[at]) for name in _NUMBERS}
        return Score(**numbers, failed=bool(self.failed[at]))

    def stacked(self) -> Array:
        """All scores as one array, shape (n_scores, n_sets, n_drives), to travel."""
        return np.array([getattr(self, field.name) for field in fields(self)], dtype=np.float64)

    @classmethod
    def unstacked(cls, stacked: Array) -> "Scores":
        """What `stacked` made."""
        *numbers, failed = (np.asfortranarray(one) for one in stacked)
        return cls(*numbers, failed=failed.astype(np.bool_))


@dataclass(frozen=True)
class Passes:
    """How often a drive is run, and what it is taken for: see `Replayer` and `PreparedDrive`."""

    outages: bool = False
    forecasts: bool = False
    outage_seed: int = 0
    as_recorded: bool = False


class Replays(Protocol):
    """Drives made ready, wherever they are held, to be replayed by any number of parameter sets."""

    @property
    def held(self) -> Held:
        """The drives."""
        ...

    @property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, over all passes, shape (n_drives,)."""
        ...

    def subset(self, drives: Sequence[int]) -> "Replays":
        """Those of some of the drives, by index."""
        ...

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Scores of all sets on all drives; the result has the same bits wherever the drives are held."""
        ...

    def measured(
        self,
        take: Callable[[Scores], Array],
        parameter_sets: Sequence[FilterParameters],
        executor: Executor | None = None,
    ) -> Array:
        """What a function of a module takes of the scores, number by number, shape (n_sets, n_drives)."""
        ...


class Replayer:
    """Drives made ready once, to be replayed by any number of parameter sets.

    Parameters
    ----------
    drives : sequence of Drive or PreparedDrive
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
        drives: Sequence[Drive | PreparedDrive],
        *,
        outages: bool,
        forecasts: bool = False,
        outage_length: float = OUTAGE_LENGTH,
        outage_seed: int = 0,
    ) -> None:
        ready = [prepared(drive) for drive in drives]
        self.drives = tuple(one.drive for one in ready)
        self.initial = tuple(one.initial for one in ready)
        self._passes = {"tracking": tuple(map(tracking_replay, ready))}
        if outages:
            length, seed = outage_length, outage_seed
            self._passes["outages"] = tuple(outage_replay(one, length=length, seed=seed) for one in ready)
        if forecasts:
            self._passes["forecasts"] = tuple(forecast_replay(one, seed=outage_seed) for one in ready)

    @classmethod
    def together(cls, parts: Sequence["Replayer"]) -> "Replayer":
        """The drives of several, which have the same passes, without making anything ready again."""
        whole = copy(parts[0])
        whole.__dict__.pop("_steps", None)
        whole.drives = tuple(drive for part in parts for drive in part.drives)
        whole.initial = tuple(initial for part in parts for initial in part.initial)
        names = parts[0]._passes
        whole._passes = {name: tuple(r for part in parts for r in part._passes[name]) for name in names}
        return whole

    @property
    def held(self) -> Here:
        """The drives."""
        return Here(self.drives)

    def subset(self, drives: Sequence[int]) -> "Replayer":
        """A replayer of some of the drives, by index, without making anything ready again."""
        part = copy(self)
        part.__dict__.pop("_steps", None)
        part.drives = tuple(self.drives[i] for i in drives)
        part.initial = tuple(self.initial[i] for i in drives)
        part._passes = {name: tuple(replays[i] for i in drives) for name, replays in self._passes.items()}
        return part

    @property
    def truth_moments(self) -> list[int]:
        """How many moments of truth each drive is scored at."""
        return [replay.targets.n_positions for replay in self._passes["tracking"]]

    @property
    def hidden_fixes(self) -> list[int]:
        """How many fixes are hidden to be forecast on each drive; empty without forecasts."""
        return [replay.n_hidden for replay in self._passes.get("forecasts", ())]

    @property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, over all passes, shape (n_drives,)."""
        return self._steps

    @cached_property
    def _steps(self) -> NDArray[np.int64]:
        each = [[len(replay.timeline.dt) for replay in replays] for replays in self._passes.values()]
        return np.sum(np.array(each, dtype=np.int64), axis=0)

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Score the sets; the result has the same bits whatever the executor and its number of workers."""
        if not parameter_sets or not self.drives:
            empty = np.full((len(parameter_sets), len(self.drives)), np.nan)
            return Scores(*[empty] * len(_NUMBERS), failed=np.zeros(empty.shape, dtype=np.bool_))
        return scores_of(self._passes, self._run(parameter_sets, executor))

    def measured(
        self,
        take: Callable[[Scores], Array],
        parameter_sets: Sequence[FilterParameters],
        executor: Executor | None = None,
    ) -> Array:
        """What a function takes of the scores, shape (n_sets, n_drives)."""
        return np.asfortranarray(take(self.scores(parameter_sets, executor)))

    def _run(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None) -> dict[str, Sums]:
        """Every pass by every set, in pieces so that all workers have something to do."""
        workers = min(getattr(executor, "_max_workers", None) or cores(), cores()) if executor else 1
        steps = {name: [len(r.timeline.dt) for r in replays] for name, replays in self._passes.items()}
        jobs = jobs_for(steps, len(parameter_sets), parameter_sets[0].model, workers)
        packs = {job.sets: pack(parameter_sets[job.sets.start : job.sets.stop]) for job in jobs}
        # The longest first, so that no worker is left with one at the end.
        order = sorted(range(len(jobs)), key=lambda k: jobs[k].seconds, reverse=True)
        longest_first = [jobs[k] for k in order]
        replays = [self._passes[job.name][job.replays.start : job.replays.stop] for job in longest_first]
        packed = [packs[job.sets] for job in longest_first]
        sums = dict(
            zip(order, (executor.map if executor else map)(run_replays, replays, packed), strict=True)
        )
        done = {name: list[Sums]() for name in self._passes}
        for (name, _), part in groupby(range(len(jobs)), key=lambda k: (jobs[k].name, jobs[k].replays)):
            done[name].append(joined([sums[k] for k in part], axis=1))
        return {name: joined(each, axis=0) for name, each in done.items()}


def scores_of(passes: Mapping[str, Sequence[Replay]], sums: Mapping[str, Sums]) -> Scores:
    """Scores from what each pass (``tracking``, ``outages``, ``forecasts``) added up; NaN of a pass that is missing."""
    shape = next(iter(sums.values())).failed.T.shape
    columns = {name: np.full(shape, np.nan) for name in _NUMBERS}
    failed = np.zeros(shape, dtype=np.bool_)
    for name, added in sums.items():
        for score, values in _SCORES[name](passes[name], added).items():
            columns[score] = values.T
        failed |= added.failed.T
    return Scores(**columns, failed=failed)


_NUMBERS = tuple(field.name for field in fields(Scores) if field.name != "failed")


def _tracking_scores(replays: Sequence[Replay], sums: Sums) -> dict[str, Array]:
    n_positions = _counts(replay.targets.n_positions for replay in replays)
    positions = _counts(replay.targets.position_weight for replay in replays)
    headings = _counts(replay.targets.heading_weight for replay in replays)
    n_fixes = _counts(len(replay.timeline.fixes) for replay in replays)
    return {
        "position_rmse": np.sqrt(sums.squared_position / positions),
        "heading_rmse": np.sqrt(sums.squared_heading / headings),
        "fix_rmse": np.sqrt(sums.squared_fix / n_fixes),
        "innovation_nll": (sums.nis + sums.log_determinant) / n_fixes / 2 + math.log(2 * math.pi),
        "innovation_t": (sums.log_determinant + (INNOVATION_DOF + 2) * sums.log_tail) / n_fixes / 2
        + math.log(2 * math.pi),
        "mean_nis": sums.nis / n_fixes,
        "mean_nees": sums.nees / n_positions,
    }


def _outage_scores(replays: Sequence[Replay], sums: Sums) -> dict[str, Array]:
    ends = _counts(replay.targets.position_weight for replay in replays)
    return {"outage_drift": np.sqrt(sums.squared_position / ends)}


def _forecast_scores(replays: Sequence[Replay], sums: Sums) -> dict[str, Array]:
    hidden = _counts(replay.n_hidden for replay in replays)
    return {
        "forecast_rmse": np.sqrt(sums.squared_forecast / hidden),
        "forecast_t": sums.forecast_t / hidden + math.log(2 * math.pi),
    }


_SCORES = {"tracking": _tracking_scores, "outages": _outage_scores, "forecasts": _forecast_scores}
"""What the sums of each pass say, each of shape (n_drives, n_sets)."""


def _counts(each: Iterable[float]) -> Array:
    """Of each replay, shape (m, 1); NaN for none, so that a mean over nothing is not known."""
    counts = np.array(list(each), dtype=np.float64)[:, np.newaxis]
    return np.where(counts > 0, counts, np.nan)
