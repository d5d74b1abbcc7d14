"""One filter over one replay, handed out piece by piece: what it takes to hold does not grow with the drive."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.layout import N_STATE
from sigmaswarm.filters.compiled.run import new_place
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.packing import Chunk, definite, unpack_states, unpack_sums
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.replay import Replay, Sums, run_steps, start_replays
from sigmaswarm.geodesy import wrap_angle

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
    """

    time: Array
    mean: Array
    covariance: Array
    sound: NDArray[np.bool_]


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

    Attributes
    ----------
    failure : str or None
        What went wrong in the pieces so far, and when.
    """

    def __init__(self, replay: Replay, parameters: FilterParameters, *, samples: int = SAMPLES) -> None:
        self._replay, self._chunk, self._samples = replay, Chunk((parameters,)), samples
        self._rows, self._place = start_replays([replay], self._chunk), new_place()
        self._innovations = np.empty((len(replay.timeline.fixes), 5))
        self._pieces = self._run()
        self._complete = False
        self.failure: str | None = None

    def __iter__(self) -> Iterator[Piece]:
        return self._pieces

    def whole(self) -> Piece:
        """All pieces as one."""
        pieces = list(self)
        return Piece(*(np.concatenate([getattr(p, f.name) for p in pieces]) for f in fields(Piece)))

    def _run(self) -> Iterator[Piece]:
        line = self._replay.timeline
        ends = np.flatnonzero(line.sampled) + 1
        record = np.empty((min(self._samples, len(ends)), N_STATE + 1, 1))
        for first in range(0, len(ends), self._samples):
            stops = ends[first : first + self._samples]
            part = record[: len(stops)]
            stop = int(stops[-1])
            run_steps(self._replay, self._chunk, self._rows[0], self._place, stop, part, self._innovations)
            yield self._piece(line.imu_time[first : first + len(stops)], part)
        self._complete = True

    def _piece(self, time: Array, record: Array) -> Piece:
        mean, covariance = unpack_states(record[:, :N_STATE, 0].T, self._chunk.sets[0].n_states)
        sound = (record[:, N_STATE, 0] == 1.0) & np.isfinite(mean).all(axis=1) & self._chunk.plausible
        sound = np.logical_and.accumulate(sound & definite(covariance) & (self.failure is None))
        mean[:, THETA] = wrap_angle(mean[:, THETA])
        mean[~sound], covariance[~sound] = np.nan, np.nan
        if self.failure is None and not sound.all():
            self.failure = failure_at(self._replay.timeline, time[np.argmin(sound)])
        return Piece(time, mean, covariance, sound)

    @property
    def sums(self) -> Sums:
        """What `run_replays` gives for this replay and this set, shape (1, 1); after the last piece."""
        self._need_all()
        columns, failed = unpack_sums(self._rows, self._chunk)
        return Sums(*columns, failed=failed)

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
