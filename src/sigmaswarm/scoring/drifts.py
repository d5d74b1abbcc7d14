"""Drifts of methods during outages, over several random placements of the outages."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.tables import Indices
from sigmaswarm.filters.filter_run import EstimateChunk, FilterRun
from sigmaswarm.filters.fixes_alone import FixesAlone
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, join_sums, run_passes
from sigmaswarm.filters.run import Estimate, Run
from sigmaswarm.scoring.batch import scores_from_sums
from sigmaswarm.scoring.records import DriftRecord
from sigmaswarm.scoring.score import root_mean
from sigmaswarm.scoring.targets import (
    Seed,
    drift_reference,
    drift_weights,
    outage_pass,
    outage_windows,
    placements,
)

RunFactories = Mapping[str, Callable[[FilterPass], Run]]


class OutageDrifts:
    """Outages of one length on a drive, in several random placements, and the drift of each method.

    ``seeds`` contains one seed per placement, and is empty if the drive is too short for an outage. ``failed`` contains
    the methods that failed in at least one placement.
    """

    def __init__(self, ready: PreparedDrive, *, length: float, seed: int, most: int | None = None) -> None:
        self._ready, self._length = ready, length
        drive, initial = ready.drive, ready.initial
        placed = placements(drive, initial, length=length, seed=seed)[:most]
        ends = {s: outage_windows(drive, initial, length=length, seed=s)[:, 1] for s in placed}
        self.seeds = [s for s in placed if len(ends[s])]
        self._ends = [ends[s] for s in self.seeds]
        self._drifts: dict[str, list[float]] = {}
        self.failed: set[str] = set()
        self._stated: list[Array] = []

    @property
    def stated(self) -> tuple[Array, Array, Array]:
        """Ends of the outages (s), with the tuned filter's position variances (m2 per axis) and errors (m)."""
        return tuple(np.hstack([np.empty((3, 0)), *self._stated]))

    def add_estimate(self, method: str, estimate: Estimate) -> None:
        self._drifts[method] = [rms_drift(self._ready, estimate, ends) for ends in self._ends]

    def run(
        self,
        filters: Mapping[str, FilterParameters],
        also: RunFactories = MappingProxyType({}),
        *,
        monitored: bool = True,
    ) -> None:
        """Run methods over the drive with the outages, without storing the estimates.

        If ``monitored`` is True, a filter is reset after divergence. Otherwise all ``filters`` run as one batch.
        ``also`` contains functions that run further methods.
        """
        for seed in self.seeds:
            self._ready.forget()
            self._run_placed(seed, filters, also, monitored=monitored)
        self._ready.forget()

    def _run_placed(
        self, seed: Seed, filters: Mapping[str, FilterParameters], also: RunFactories, *, monitored: bool
    ) -> None:
        """Run methods with one placement. When this function returns, its memory is freed for the next placement."""
        outages = outage_pass(self._ready, length=self._length, seed=seed)
        ends = self._ends[self.seeds.index(seed)]
        if monitored:
            sums = join_sums([self._recorded(m, outages, p, ends).sums for m, p in filters.items()])
        else:
            sums = run_passes([outages], [*filters.values()])
        scores = scores_from_sums({"outages": [outages]}, {"outages": sums})
        for i, method in enumerate(filters):
            self._add(method, scores[i, 0].outage_drift, failed=scores[i, 0].failed)
        for method, make in also.items():
            run = make(outages)
            pieces = [run.at(ends)] if isinstance(run, FixesAlone) else run
            positions = [np.empty((0, 2)), *(piece.mean[_rows_at(ends, piece), :2] for piece in pieces)]
            self._add(method, _drift(self._ready, ends, np.vstack(positions)), failed=bool(run.failure))

    def _recorded(
        self, method: str, outages: FilterPass, parameters: FilterParameters, ends: Array
    ) -> FilterRun:
        """Run a filter. For the tuned filter, store variances and errors at the ends of the outages."""
        recording = FilterRun(outages, parameters, recover=True)
        if method != "tuned":
            return recording.finished()
        found = recording.at(ends)
        error = np.hypot(*_errors(self._ready, found.time, found.mean[:, :2]).T)
        self._stated.append(np.vstack([found.time, found.covariance[:, [0, 1], [0, 1]].mean(axis=1), error]))
        return recording

    def _add(self, method: str, drift: float, *, failed: bool) -> None:
        self._drifts.setdefault(method, []).append(drift)
        if failed:
            self.failed.add(method)

    def drift(self, method: str) -> float:
        """Return the RMS drift over all placements, m, or NaN if there is no outage or the method failed."""
        if not self.seeds or method in self.failed:
            return float("nan")
        counts = [len(ends) for ends in self._ends]
        return float(np.sqrt(np.average(np.square(self._drifts[method]), weights=counts)))

    @property
    def record(self) -> DriftRecord:
        drifts = {m: [v if np.isfinite(v) else None for v in values] for m, values in self._drifts.items()}
        return DriftRecord(outages=sum(map(len, self._ends)), each=drifts)


def rms_drift(ready: PreparedDrive, estimate: Estimate | EstimateChunk, ends: Array) -> float:
    """Return the RMS position error at the ends of the outages, m."""
    positions = [np.interp(ends, estimate.time, estimate.mean[:, i]) for i in (0, 1)]
    return _drift(ready, ends, np.column_stack(positions))


def _drift(ready: PreparedDrive, ends: Array, positions: Array) -> float:
    return root_mean(np.square(_errors(ready, ends, positions)).sum(axis=1), drift_weights(ready, ends))


def _errors(ready: PreparedDrive, time: Array, positions: Array) -> Array:
    reference = drift_reference(ready)
    return positions - np.column_stack(
        [np.interp(time, reference.time, c) for c in (reference.x, reference.y)]
    )


def _rows_at(ends: Array, piece: EstimateChunk) -> Indices:
    """Return the rows of a piece at the ends of outages, each of which is the time of an IMU sample."""
    return np.searchsorted(piece.time, ends[(ends >= piece.time[0]) & (ends <= piece.time[-1])])
