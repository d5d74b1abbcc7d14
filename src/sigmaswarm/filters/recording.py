"""One filter over one replay, handed out piece by piece: what it takes to hold does not grow with the drive."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.layout import R, state_rows
from sigmaswarm.filters.compiled.run import new_place
from sigmaswarm.filters.kernel_array import KernelArray, Sums
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.packing import believed, definite
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recovery import Recovery, Seen, at_fix, looks_of
from sigmaswarm.filters.replay import Replay, run_steps, start_replays
from sigmaswarm.geodesy import wrap_angle

ADAPTS_R = ("adaptive-ukf", "fuzzy-ukf")
"""Kinds whose R is another one at each look."""
SAMPLES = 10_000
"""IMU samples in a piece; planar8 takes 9 MB for so many."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Estimates at some consecutive IMU samples, after all fixes up to then.

    Attributes
    ----------
    time : ndarray, shape (r,)
        s
    mean, covariance : ndarray, shapes (r, n), (r, n, n)
        As in `Estimate`: heading wrapped to (-pi, pi]; NaN from a failure on.
    sound : ndarray of bool, shape (r,)
        False from a failure on.
    lost : ndarray of bool, shape (r,)
        True where the filter is lost, and the estimate is the last fix: see `recovery`.
    """

    time: Array
    mean: Array
    covariance: Array
    sound: NDArray[np.bool_]
    lost: NDArray[np.bool_]


def joined(pieces: Iterable[Piece]) -> Piece:
    """All pieces as one."""
    parts = list(pieces)
    return Piece(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Piece)))


@dataclass(frozen=True, eq=False)
class Innovations:
    """What each fix said that a filter did not expect, before the fix was absorbed.

    Attributes
    ----------
    time : ndarray, shape (f,)
        s, of the fixes after the start.
    innovation : ndarray, shape (f, 2)
        nu, m east and north.
    covariance : ndarray, shape (f, 2, 2)
        S, m2.
    """

    time: Array
    innovation: Array
    covariance: Array

    @property
    def nis(self) -> Array:
        """nu^T S^-1 nu, shape (f,): chi-square with 2 degrees of freedom where the filter is consistent."""
        return np.square(self.normalized).sum(axis=1)

    @property
    def normalized(self) -> Array:
        """L^-1 nu with L L^T = S, shape (f, 2): white, of variance one, where the filter is consistent."""
        root = np.linalg.cholesky(self.covariance)
        return np.asarray(np.linalg.solve(root, self.innovation[..., None])[..., 0], np.float64)


class Recording:
    """A filter's run over a replay, as an iterator of pieces; sums and innovations after the last one.

    The pieces, joined, and the sums have the same bits whatever the length of a piece.

    Parameters
    ----------
    replay : Replay
    parameters : FilterParameters
    samples : int
        IMU samples in a piece; the last one may be shorter.
    recover : bool
        Start anew where the filter is lost: see `recovery`. It does so after a sample; what is added up there, or while
        the estimate is but a fix, is that of the filter before.

    Attributes
    ----------
    restarts : list of float
        s: when it did, in the pieces so far.
    failure : str or None
        What went wrong in the pieces so far, and when.
    """

    def __init__(
        self,
        replay: Replay,
        parameters: FilterParameters,
        *,
        samples: int = SAMPLES,
        recover: bool = False,
    ) -> None:
        self._replay, self._array, self._samples = replay, KernelArray((parameters,)), samples
        self._rows, self._place = start_replays([replay], self._array), new_place()
        self._state = state_rows(parameters.model)
        self._innovations = np.empty((len(replay.timeline.fixes), 5))
        self._looks = looks_of(replay.timeline) if recover else None
        if self._looks is not None:
            line = replay.timeline
            moments = line.fix_time[self._looks.fix]
            # of their alignments
            self._ends = np.searchsorted(line.alignments.time, moments, side="right") - 1
        self._recovery = Recovery()
        self.restarts = self._recovery.restarts
        self._parts = self._run()
        self._pieces = (self._piece(*part) for part in self._parts)
        self._complete = False
        self.failure: str | None = None

    def __iter__(self) -> Iterator[Piece]:
        return self._pieces

    def whole(self) -> Piece:
        """All pieces as one."""
        return joined(self)

    def finished(self) -> Self:
        """The same, after the last piece; for who needs no estimates: none are made, and so no `failure` is found."""
        for _ in self._parts:
            pass
        return self

    def _run(self) -> Iterator[tuple[Array, Array, NDArray[np.bool_]]]:
        """What `_piece` makes a piece of."""
        line = self._replay.timeline
        ends = np.flatnonzero(line.sampled) + 1
        record = np.empty((min(self._samples, len(ends)), len(self._state) + 1, 1))
        for first in range(0, len(ends), self._samples):
            stops = ends[first : first + self._samples]
            part = record[: len(stops)]
            lost = self._run_to(stops, part)
            yield line.imu_time[first : first + len(stops)], part, lost
        self._complete = True

    def _run_to(self, stops: NDArray[np.intp], record: Array) -> NDArray[np.bool_]:
        """Run to the last of the stops, (r,), each behind a step that ends at an IMU sample; (r,) where it is lost.

        The filter runs on as if it kept its way, and is looked at afterwards, by what is recorded; where it was to
        start anew it goes back. To stop for each look takes longer than the steps do.
        """
        lost = np.zeros(len(stops), dtype=np.bool_)
        if self._looks is None:
            self._steps_to(int(stops[-1]), record)
            return lost
        row = 0
        while row < len(stops):
            behind = self._ahead(stops, row)
            before = self._rows.copy(), self._place.copy()
            self._steps_to(int(stops[behind - 1]), record[row:behind])
            looked, start = self._look(stops[row:behind] - 1, record[row:behind])
            last, row = row + looked, row + looked + 1
            if start is None and not self._recovery.lost:
                continue
            if row < behind:
                self._rows[:], self._place[:] = before
                self._steps_to(int(stops[last]), record[last - looked : row])
            self._start_anew(start or self._at_fix(int(stops[last]) - 1))
            record[last, :-1, 0] = self._rows[0, self._state, 0]
            lost[last] = self._recovery.lost
        return lost

    def _ahead(self, stops: NDArray[np.intp], row: int) -> int:
        """Behind which stop to look next, from a row on."""
        assert self._looks is not None
        if self._recovery.lost:
            return row + 1
        if self._array.like.kind not in ADAPTS_R:
            return len(stops)
        due = np.flatnonzero(np.isin(stops[row:] - 1, self._looks.step))
        return row + 1 + int(due[0]) if len(due) else len(stops)

    def _steps_to(self, stop: int, record: Array) -> None:
        run_steps(self._replay, self._array, self._rows[0], self._place, stop, record, self._innovations)

    def _look(self, steps: NDArray[np.intp], record: Array) -> tuple[int, InitialState | None]:
        """Look at the filter after some steps, by what is recorded of them, until one at which it is lost.

        The row of that one, or the last one, and where the filter is to start anew there, if it can.
        """
        looks = self._looks
        assert looks is not None
        first, last = np.searchsorted(looks.step, [steps[0], steps[-1] + 1]).tolist()
        rows = np.searchsorted(steps, looks.step[first:last])
        means, covariances = believed(record[rows, :-1, 0].T, self._array.model)
        sound = np.flatnonzero(np.isfinite(means).all(axis=1))  # where it is not it failed, and says so
        times = self._replay.timeline.end[looks.step[first:last][sound]].tolist()
        if not times:
            return len(steps) - 1, None
        k, start = self._recovery.look_back(
            times, lambda k: self._seen(first + sound[k], means[sound[k]], covariances[sound[k]])
        )
        return len(steps) - 1 if k is None else int(rows[sound[k]]), start

    def _seen(self, k: int, mean: Array, covariance: Array) -> Seen:
        """What the k-th look sees of what the filter believes."""
        line, looks = self._replay.timeline, self._looks
        assert looks is not None
        alignments, step, fix, ends = line.alignments, looks.step[k], looks.fix[k], int(self._ends[k])
        time, end = float(line.fix_time[fix]), float(line.end[step])
        since = [end - time, *line.driving[line.sample[step], :3]]  # ax, ay, gz
        return Seen(
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
        """What is known after a step at which it is lost: the last fix."""
        line, time = self._replay.timeline, float(self._replay.timeline.end[step])
        fix = int(np.searchsorted(line.fix_time, time, side="right")) - 1
        theta = float(self._believed()[0][THETA])
        return at_fix(time, line.fixes[fix, :2], self._variance_of(fix), theta, line.lever)

    def _believed(self) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n), the heading as it is."""
        mean, covariance = believed(self._rows[0, self._state, :1], self._array.model)
        return mean[0], covariance[0]

    def _variance_of(self, fix: int) -> Array:
        """Diagonal of R of a fix, (2,) m2."""
        rx, ry, scale = self._rows[0, [R.RX, R.RY, R.ACCURACY], 0]
        return np.array([rx, ry]) + scale * self._replay.timeline.fixes[fix, 4:6]

    def _start_anew(self, start: InitialState) -> None:
        """The filter as at a start; what it has added up stays."""
        fresh = self._array.start([start], [self._replay.timeline.nominal_interval])[0]
        added_up = slice(R.SQ_POSITION, R.OK + 1)
        fresh[added_up] = self._rows[0, added_up]
        self._rows[0] = fresh

    def _piece(self, time: Array, record: Array, lost: NDArray[np.bool_]) -> Piece:
        mean, covariance = believed(record[:, :-1, 0].T, self._array.model)
        sound = (record[:, -1, 0] == 1.0) & np.isfinite(mean).all(axis=1) & self._array.plausible
        sound = np.logical_and.accumulate(sound & definite(covariance) & (self.failure is None))
        mean[:, THETA] = wrap_angle(mean[:, THETA])
        mean[~sound], covariance[~sound] = np.nan, np.nan
        if self.failure is None and not sound.all():
            self.failure = failure_at(self._replay.timeline, time[np.argmin(sound)])
        return Piece(time, mean, covariance, sound, lost)

    @property
    def sums(self) -> Sums:
        """What `run_replays` gives for this replay and this set, shape (1, 1); after the last piece."""
        self._need_all()
        return self._array.sums(self._rows)

    @property
    def innovations(self) -> Innovations:
        """Of all fixes, hidden ones included; after the last piece."""
        self._need_all()
        rows, time = self._innovations, self._replay.timeline.fix_time
        return Innovations(time, rows[:, :2], rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2))

    def _need_all(self) -> None:
        if not self._complete:
            raise RuntimeError("take all pieces of the recording first")


def failure_at(line: Timeline, time: float) -> str:
    """The sentence that says when a filter failed (s), and why it may have."""
    return (
        f"{line.drive.name}: the filter failed at t = {time:.3f} s (covariance not positive "
        "definite, or NaN in the data); are all variances positive and all samples finite?"
    )
