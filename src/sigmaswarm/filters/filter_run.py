"""Run one filter over a drive in pieces, so that memory does not grow with the drive."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.tables import Indices, Mask
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.layout import R, state_rows
from sigmaswarm.filters.compiled.run import new_cursor
from sigmaswarm.filters.divergence import DivergenceMonitor, StateCheck, check_times, state_at_fix
from sigmaswarm.filters.kernel_array import KernelArray, KernelSums
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.packing import definite, state_estimate
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, run_steps, start_passes
from sigmaswarm.geodesy import wrap_angle

ADAPTS_R = ("adaptive-ukf", "fuzzy-ukf")  # R changes at each fix
CHUNK_SAMPLES = 10_000  # IMU samples in a piece (9 MB for planar8)


@dataclass(frozen=True, eq=False)
class EstimateChunk:
    """Estimates at consecutive IMU samples; each estimate uses all fixes up to its sample."""

    time: Array  # (r,), s
    mean: Array  # (r, n), as in `Estimate`
    covariance: Array  # (r, n, n)
    sound: Mask  # (r,), False after a failure
    lost: Mask  # (r,), True if diverged and not yet reset, for lack of an alignment; the position is then the last fix


def join_chunks(pieces: Iterable[EstimateChunk]) -> EstimateChunk:
    parts = list(pieces)
    return EstimateChunk(
        *(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(EstimateChunk))
    )


@dataclass(frozen=True, eq=False)
class Innovations:
    """Innovations of a filter: each fix minus its prediction before the update.

    Attributes
    ----------
    time : ndarray, shape (f,)
        Times of the fixes after the start of the filter, s.
    innovation : ndarray, shape (f, 2)
        nu, m east and north.
    covariance : ndarray, shape (f, 2, 2)
        Innovation covariance S, m2.
    """

    time: Array
    innovation: Array
    covariance: Array

    @property
    def nis(self) -> Array:
        """NIS nu^T S^-1 nu, (f,); chi-square with 2 degrees of freedom for a consistent filter."""
        return np.square(self.normalized).sum(axis=1)

    @property
    def normalized(self) -> Array:
        """Normalized innovations L^-1 nu with L L^T = S, (f, 2); white with variance 1 for a consistent filter."""
        root = np.linalg.cholesky(self.covariance)
        return np.asarray(np.linalg.solve(root, self.innovation[..., None])[..., 0], np.float64)


class FilterRun:
    """Run of a filter over a drive, as an iterator of pieces. Sums and innovations are available after the last piece.

    ``samples`` is the number of IMU samples in a piece; the results do not depend on this number. If ``recover`` is
    True, the filter is reset when it diverges. At the sample of a reset, the sums contain the error before the reset.

    Attributes
    ----------
    initial : InitialState
        The state at which the filter starts.
    restarts : list of float
        Times of the resets in the pieces so far, s.
    failure : str or None
        The failure in the pieces so far, with its time; None if the filter did not fail.
    """

    def __init__(
        self,
        drive_pass: FilterPass,
        parameters: FilterParameters,
        *,
        samples: int = CHUNK_SAMPLES,
        recover: bool = False,
    ) -> None:
        self._pass, self._array, self._samples = drive_pass, KernelArray((parameters,)), samples
        self.initial = drive_pass.initial
        self._rows, self._cursor = start_passes([drive_pass], self._array), new_cursor()
        self._state = state_rows(parameters.kernel)
        self._innovations = np.empty((len(drive_pass.timeline.fixes), 5))
        self._recover = recover
        if recover:
            line = drive_pass.timeline
            self._check_steps, self._check_fixes = check_times(line)
            fix_times = line.fix_time[self._check_fixes]  # end of each check's alignment
            self._ends = np.searchsorted(line.alignments.time, fix_times, side="right") - 1
        self._monitor = DivergenceMonitor()
        self.restarts = self._monitor.restarts
        self._parts = self._run()
        self._pieces = (self._piece(*part) for part in self._parts)
        self._complete = False
        self.failure: str | None = None

    def __iter__(self) -> Iterator[EstimateChunk]:
        return self._pieces

    def whole(self) -> EstimateChunk:
        return join_chunks(self)

    def at(self, times: Array) -> EstimateChunk:
        """Run to the end. Return only the estimates at ``times`` (k,), s, which are times of IMU samples."""
        chunks: list[EstimateChunk] = []
        for time, record, lost in self._parts:
            rows = np.searchsorted(time, times[(times >= time[0]) & (times <= time[-1])])
            chunks.append(self._piece(time[rows], record[rows], lost[rows]))
        return join_chunks(chunks)

    def finished(self) -> Self:
        """Run to the end without computing estimates or detecting a failure. Return the run."""
        for _ in self._parts:
            pass
        return self

    def _run(self) -> Iterator[tuple[Array, Array, Mask]]:
        line = self._pass.timeline
        ends = np.flatnonzero(line.sampled) + 1
        record = np.empty((min(self._samples, len(ends)), len(self._state) + 1, 1))
        for first in range(0, len(ends), self._samples):
            stops = ends[first : first + self._samples]
            part = record[: len(stops)]
            lost = self._run_to(stops, part)
            yield line.imu_time[first : first + len(stops)], part, lost
        self._complete = True

    def _run_to(self, stops: Indices, record: Array) -> Mask:
        """Run to the last of the steps ``stops``, (r,), each of which follows an IMU sample.

        Return `EstimateChunk.lost`, (r,).

        Stopping the filter at every check would take longer than the steps themselves. Therefore, a filter with a
        constant R runs to the end, and its recorded estimates are checked afterwards. If it diverged, it runs again up
        to the step of the divergence, is reset there, and continues.
        """
        lost = np.zeros(len(stops), dtype=np.bool_)
        if not self._recover:
            self._steps_to(int(stops[-1]), record)
            return lost
        row = 0
        while row < len(stops):
            behind = self._next_check(stops, row)
            before = self._rows.copy(), self._cursor.copy()
            self._steps_to(int(stops[behind - 1]), record[row:behind])
            checked, start = self._check(stops[row:behind] - 1, record[row:behind])
            last, row = row + checked, row + checked + 1
            if start is None and not self._monitor.lost:
                continue
            if row < behind:
                self._rows[:], self._cursor[:] = before
                self._steps_to(int(stops[last]), record[last - checked : row])
            self._reset(start or self._at_fix(int(stops[last]) - 1))
            record[last, :-1, 0] = self._rows[0, self._state, 0]
            lost[last] = self._monitor.lost
        return lost

    def _next_check(self, stops: Indices, row: int) -> int:
        if self._monitor.lost:
            return row + 1
        if self._array.like.kind not in ADAPTS_R:
            return len(stops)
        due = np.flatnonzero(np.isin(stops[row:] - 1, self._check_steps))
        return row + 1 + int(due[0]) if len(due) else len(stops)

    def _steps_to(self, stop: int, record: Array) -> None:
        run_steps(self._pass, self._array, self._rows[0], self._cursor, stop, record, self._innovations)

    def _check(self, steps: Indices, record: Array) -> tuple[int, InitialState | None]:
        """Check the filter at the recorded steps, up to the first divergence.

        Return the row of the divergence and the state for a reset (None if there is no alignment). If there is no
        divergence, return the last row and None.
        """
        first, last = np.searchsorted(self._check_steps, [steps[0], steps[-1] + 1]).tolist()
        due = self._check_steps[first:last]
        rows = np.searchsorted(steps, due)
        means, covariances = state_estimate(record[rows, :-1, 0].T, self._array.kernel)
        sound = np.flatnonzero(np.isfinite(means).all(axis=1))  # the filter has failed in other rows
        ends = self._pass.timeline.end[due[sound]].tolist()
        if not ends:
            return len(steps) - 1, None
        k, start = self._monitor.take_all(
            ends, lambda k: self._check_at(first + sound[k], means[sound[k]], covariances[sound[k]])
        )
        return len(steps) - 1 if k is None else int(rows[sound[k]]), start

    def _check_at(self, k: int, mean: Array, covariance: Array) -> StateCheck:
        line, step, fix, ends = (
            self._pass.timeline,
            self._check_steps[k],
            self._check_fixes[k],
            int(self._ends[k]),
        )
        alignments = line.alignments
        time, end = float(line.fix_time[fix]), float(line.end[step])
        since = [end - time, *line.driving[line.sample[step], :3]]  # ax, ay, gz
        return StateCheck(
            time=end,
            mean=mean,
            covariance=covariance,
            fix_time=time,
            fix=line.fixes[fix, :2],
            fix_variance=self._variance_of(fix),
            lever=line.lever,
            latency=self._array.like.latency,
            since=lambda: np.array([since]),
            heading=lambda: float(alignments.course[ends] + since[0] * since[3]),
            align=lambda: alignments.at(ends),
        )

    def _at_fix(self, step: int) -> InitialState:
        line, time = self._pass.timeline, float(self._pass.timeline.end[step])
        fix = int(np.searchsorted(line.fix_time, time, side="right")) - 1
        theta = float(self._estimate()[0][THETA])
        return state_at_fix(time, line.fixes[fix, :2], self._variance_of(fix), theta, line.lever)

    def _estimate(self) -> tuple[Array, Array]:
        """Return the mean (n,), whose heading is not wrapped, and the covariance (n, n)."""
        mean, covariance = state_estimate(self._rows[0, self._state, :1], self._array.kernel)
        return mean[0], covariance[0]

    def _variance_of(self, fix: int) -> Array:
        rx, ry, scale = self._rows[0, [R.RX, R.RY, R.ACCURACY], 0]
        return np.array([rx, ry]) + scale * self._pass.timeline.fixes[fix, 4:6]

    def _reset(self, start: InitialState) -> None:
        """Reset the filter to a start; keep the sums."""
        fresh = self._array.start([start], [self._pass.timeline.nominal_interval])[0]
        added_up = slice(R.SQ_POSITION, R.OK + 1)
        fresh[added_up] = self._rows[0, added_up]
        self._rows[0] = fresh

    def _piece(self, time: Array, record: Array, lost: Mask) -> EstimateChunk:
        mean, covariance = state_estimate(record[:, :-1, 0].T, self._array.kernel)
        sound = (record[:, -1, 0] == 1.0) & np.isfinite(mean).all(axis=1) & self._array.plausible
        sound = np.logical_and.accumulate(sound & definite(covariance) & (self.failure is None))
        mean[:, THETA] = wrap_angle(mean[:, THETA])
        mean[~sound], covariance[~sound] = np.nan, np.nan
        if self.failure is None and not sound.all():
            self.failure = failure_at(self._pass.timeline, time[np.argmin(sound)])
        return EstimateChunk(time, mean, covariance, sound, lost)

    @property
    def sums(self) -> KernelSums:
        """Sums of `run_passes` for this pass and parameter set, shape (1, 1); available after the last piece."""
        self._need_all()
        return self._array.sums(self._rows)

    @property
    def innovations(self) -> Innovations:
        """Innovations of all fixes, including hidden fixes; available after the last piece."""
        self._need_all()
        rows, time = self._innovations, self._pass.timeline.fix_time
        return Innovations(time, rows[:, :2], rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2))

    def _need_all(self) -> None:
        if not self._complete:
            raise RuntimeError("the run is not complete; iterate over all pieces first")


class InterruptibleRun(FilterRun):
    """Run of a filter that calls `_at` after some IMU samples.

    ``_marks``, (k,), contains the sorted indices of these samples.
    """

    _marks: Indices
    _done = 0

    def _at(self, sample: int, stop: int, record: Array, *, lost: bool) -> None:
        """Change the filter after an IMU sample, before step ``stop``. ``record`` (s, 1) is the row of this sample."""
        raise NotImplementedError

    def _run_to(self, stops: Indices, record: Array) -> Mask:
        first, self._done = self._done, self._done + len(stops)
        low, high = np.searchsorted(self._marks, [first, self._done])
        lost, row = np.zeros(len(stops), dtype=np.bool_), 0
        for mark in (self._marks[low:high] - first).tolist():
            lost[row : mark + 1] = super()._run_to(stops[row : mark + 1], record[row : mark + 1])
            self._at(first + mark, int(stops[mark]), record[mark], lost=bool(lost[mark]))
            row = mark + 1
        if row < len(stops):
            lost[row:] = super()._run_to(stops[row:], record[row:])
        return lost


def failure_at(line: Timeline, time: float) -> str:
    return (
        f"{line.drive.name}: the filter failed at t = {time:.3f} s (covariance not positive "
        "definite, or NaN in the data); check that measurement variances are positive, process variances are "
        "not negative, and all samples are finite"
    )
