"""Smooth the estimates of compiled filters (Rauch, Tung and Striebel): over a drive, or with a fixed lag.

The forward pass logs its steps, and the backward pass smooths this log: see `compiled.smoothing`. Fixes have the
weights of the forward pass, and rejected fixes stay rejected.

To save memory, the forward pass over a drive stores only a checkpoint before each piece of the drive. The backward pass
runs the filter again from each checkpoint, beginning with the last, and stores the smoothed state only at the
checkpoints. A third pass smooths each piece again, from the first to the last, and returns the estimates in order of
time.
"""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.events import IMU
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.tables import Indices, Mask
from sigmaswarm.filters.compiled import live
from sigmaswarm.filters.compiled.layout import N_KEPT, state_rows
from sigmaswarm.filters.compiled.memory import LiveArrays
from sigmaswarm.filters.compiled.run import NEXT_STEP, NO_INNOVATIONS, logging_kernel
from sigmaswarm.filters.compiled.single import single_step
from sigmaswarm.filters.compiled.smoothing import smooth_back
from sigmaswarm.filters.compiled.transition import logged_rows
from sigmaswarm.filters.divergence import DivergenceMonitor
from sigmaswarm.filters.filter_run import EstimateChunk, FilterRun
from sigmaswarm.filters.models import THETA, require_driven_by_imu
from sigmaswarm.filters.packing import state_estimate
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, require_readable
from sigmaswarm.filters.run import Estimate, estimate_of, whole_pass
from sigmaswarm.filters.starts import measured_by
from sigmaswarm.geodesy import wrap_angle


def smooth(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    recover: bool = True,
    as_recorded: bool = False,
) -> Estimate:
    """Run the compiled filter over a drive, and smooth its estimates: each estimate uses earlier and later fixes.

    Sources: H. E. Rauch, F. Tung and C. T. Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA
    Journal 3(8), 1965; for unscented filters: S. Sarkka, Unscented Rauch-Tung-Striebel smoother, IEEE TAC 53(3), 2008.

    Parameters
    ----------
    drive, parameters, initial, recover, as_recorded
        See `run_filter`.

    Returns
    -------
    Estimate
        Estimates at the times of `run_filter`; ``initial`` is also smoothed. Estimates before a reset of the filter do
        not use fixes after the reset. After a failure, estimates are NaN.

    Raises
    ------
    AlignmentError
        If ``initial`` is not given and cannot be computed from the drive.
    """
    drive_pass = whole_pass(drive, initial, as_recorded=as_recorded)
    return estimate_of(SmootherRun(drive_pass, parameters, recover=recover), recover=recover)


@dataclass(frozen=True, eq=False)
class _ForwardLog:
    """Log of one piece of the forward pass for `smooth_back`. ``lost`` is that of `EstimateChunk`."""

    steps: Array
    start: Array
    ends: NDArray[np.int64]
    started: Array
    sampled: Mask
    lost: Mask


class _Forward(FilterRun):
    """A run that logs every step, keeps a checkpoint before each piece, and can run a piece again.

    All passes use the same kernel. Another kernel would round differently, and estimates would depend on the
    checkpoints.
    """

    def __init__(self, drive_pass: FilterPass, parameters: FilterParameters, **options: Any) -> None:
        require_driven_by_imu(parameters.model, "smoothing")
        super().__init__(drive_pass, parameters, **options)
        require_readable(drive_pass, self._array)
        self.checkpoints: list[tuple[Array, Array, DivergenceMonitor]] = []
        self._measured = measured_by(parameters)
        self._kernel: Any = logging_kernel(parameters.kernel)
        self._width = (
            len(logged_rows(parameters.kernel)) + 1
        )  # the last column is 1 while the filter is sound
        self._first, self._logged = 0, np.empty((0, self._width, 1))
        self._resets: list[tuple[int, Array]] = []

    def _run_to(self, stops: Indices, record: Array) -> Mask:
        self.checkpoints.append((self._rows[0, :, 0].copy(), self._cursor.copy(), deepcopy(self._monitor)))
        return self._log_to(stops, record)

    def _log_to(self, stops: Indices, record: Array) -> Mask:
        self._first, self._resets = int(self._cursor[NEXT_STEP]), []
        self._logged = np.empty((int(stops[-1]) - self._first, self._width, 1))
        return super()._run_to(stops, record)

    def again(self, number: int, samples: int) -> _ForwardLog:
        (rows, cursor, monitor), sampled = self.checkpoints[number], self._pass.timeline.sampled
        self._rows[0] = rows[:, np.newaxis]  # all columns are the same filter
        self._cursor[:] = cursor
        self._monitor = deepcopy(monitor)
        start = rows[self._state]
        first = int(cursor[NEXT_STEP])
        stops = np.flatnonzero(sampled[first:])[:samples] + 1 + first
        lost = self._log_to(stops, np.empty((samples, len(self._state) + 1, 1)))
        ends = np.array([step for step, _ in self._resets], dtype=np.int64)
        started = np.array([state for _, state in self._resets]).reshape(-1, len(self._state))
        return _ForwardLog(self._logged[:, :, 0], start, ends, started, sampled[first : stops[-1]], lost)

    def _steps_to(self, stop: int, record: Array) -> None:
        first = int(self._cursor[NEXT_STEP])
        logged = self._logged[first - self._first : stop - self._first]
        steps, sample, driving, flags, *rest = self._pass.arrays(self._measured)
        # The kernel records only steps with the flag IMU, so all steps get this flag.
        drive = (steps, sample, driving, flags | IMU, *rest)
        self._kernel(drive, self._rows[0], self._cursor, stop, logged, NO_INNOVATIONS)
        at, n = np.flatnonzero(self._pass.timeline.sampled[first:stop]), len(self._state)
        record[:, :n], record[:, n] = logged[at, :n], logged[at, -1]

    def _reset(self, start: InitialState) -> None:
        super()._reset(start)
        behind = int(self._cursor[NEXT_STEP]) - 1 - self._first
        self._resets.append((behind, self._rows[0, self._state, 0]))


class SmootherRun:
    """Smoother over a drive, as an iterator of pieces; the constructor runs the forward and the backward pass.

    Parameters and attributes are those of `FilterRun`; ``initial`` is smoothed. Results do not depend on the length of
    the pieces, which is the distance between checkpoints.
    """

    def __init__(self, drive_pass: FilterPass, parameters: FilterParameters, **options: Any) -> None:
        self._line = drive_pass.timeline
        self._kernel = parameters.kernel
        self._forward = forward = _Forward(drive_pass, parameters, **options)
        # Numbers of samples and of sound samples of each piece
        self._sizes = [(len(piece.time), int(piece.sound.sum())) for piece in forward]
        self.restarts: list[float] = []
        self.failure = forward.failure
        self._behind = [np.empty(0)] * len(self._sizes)  # the smoothed state after each piece
        self._kept: tuple[int, Array, Mask] | None = None
        self._n = parameters.n_states
        self.initial = drive_pass.initial
        if self._sizes[0][1]:
            mean, covariance = self._estimate(self._back()[np.newaxis])
            self.initial = InitialState(mean[0], covariance[0], drive_pass.initial.time)

    def __iter__(self) -> Iterator[EstimateChunk]:
        first = 0
        for number, (size, sound) in enumerate(self._sizes):
            piece = self._piece(number, first, size, sound)
            self.restarts = [time for time in self._forward.restarts if time <= piece.time[-1]]
            yield piece
            first += size

    def _back(self) -> Array:
        """Run the backward pass. Return the smoothed state at the start, (s,)."""
        behind = None
        for number in reversed(range(len(self._sizes))):
            sound = self._sizes[number][1]
            if not sound:
                continue
            log = self._forward.again(number, sound)
            if behind is None:  # after the last step, the smoothed state is the state of the filter
                was_reset = len(log.ends) and log.ends[-1] == len(log.steps) - 1
                behind = log.started[-1] if was_reset else log.steps[-1, : log.start.shape[0]]
            self._behind[number] = behind
            out, behind = self._smoothed(log, behind, sound)
            self._kept = number, out, log.lost  # the first piece is needed next
        assert behind is not None
        return behind

    def _smoothed(self, log: _ForwardLog, behind: Array, samples: int) -> tuple[Array, Array]:
        """Return the smoothed states at the samples, (samples, s), and before the first step, (s,)."""
        out, before = np.empty((samples, len(behind))), behind.copy()
        smooth_back(self._kernel, log.steps, log.start, log.ends, log.started, log.sampled, before, out)
        return out, before

    def _piece(self, number: int, first: int, size: int, sound: int) -> EstimateChunk:
        time, n = self._line.imu_time[first : first + size], self._n
        mean, covariance = np.full((size, n), np.nan), np.full((size, n, n), np.nan)
        lost = np.zeros(size, dtype=np.bool_)
        if sound:
            if self._kept is None or self._kept[0] != number:
                log = self._forward.again(number, sound)
                self._kept = number, self._smoothed(log, self._behind[number], sound)[0], log.lost
            _, states, lost[:sound] = self._kept
            mean[:sound], covariance[:sound] = self._estimate(states)
        return EstimateChunk(time, mean, covariance, np.arange(size) < sound, lost)

    def _estimate(self, states: Array) -> tuple[Array, Array]:
        """Return the means (r, n), with wrapped headings, and covariances (r, n, n) of packed states (r, s)."""
        mean, covariance = state_estimate(states.T, self._kernel)
        mean[:, THETA] = wrap_angle(mean[:, THETA])
        return mean, covariance


LAG_ROUNDING = 1e-6  # s, largest rounding error of a lag
N_LOGGED = live.N_ALL
"""Index of the number of logged steps, which is stored after the state of a live filter and before the log."""
STEP_LOG = N_LOGGED + 1


class FixedLag:
    """Fixed-lag smoother of a live filter: it processes the last samples again, logs their steps, and smooths the log.

    ``lag`` is in s; ``arrays`` belong to the live filter; ``most_steps`` is the largest number of logged steps.
    """

    def __init__(self, kernel: str, lag: float, arrays: LiveArrays, *, most_steps: int) -> None:
        self._kernel, self._lag = kernel, lag
        self._state, self._width = state_rows(kernel), len(logged_rows(kernel))
        self._filter_state = np.zeros(STEP_LOG + most_steps * self._width)
        self._step = single_step(kernel, N_LOGGED)
        nothing = np.zeros((0, len(self._state)))
        self._no_starts = np.zeros(0, dtype=np.int64), nothing
        self._out = nothing
        self._replay(arrays, 0)  # compile now, so that no sample waits for the compiler
        self._back(np.zeros((0, self._width)), np.zeros(len(self._state)), np.zeros(len(self._state)))

    def smoothed(self, arrays: LiveArrays) -> tuple[float, Array]:
        """Return the time (s) and the rows (n_rows,) of the smoothed state."""
        filter_state, counts, history = arrays.filter_state, arrays.counts, arrays.history
        now, kept = float(filter_state[live.TIME]), int(counts[live.N_HISTORY])
        order = (int(counts[live.OLDEST]) + np.arange(kept)) % len(history)
        # The state before a sample is the state after the previous sample.
        moments = history[order, live.TIME]
        first = int(np.searchsorted(moments, now - self._lag + LAG_ROUNDING, side="right")) - 1
        if not kept:
            return now, filter_state[self._state]
        first = max(first, 0)
        before = history[order[first], : live.N_FILTER_STATE]
        v = self._filter_state
        v[: len(filter_state)] = filter_state  # for the settings; the next line replaces the state
        v[: live.N_FILTER_STATE] = before
        v[N_LOGGED] = 0.0
        self._replay(arrays, first)
        step_log = v[STEP_LOG : STEP_LOG + int(v[N_LOGGED]) * self._width].reshape(-1, self._width)
        return float(moments[first]), self._back(step_log, before[self._state], v[:N_KEPT][self._state])

    def _replay(self, arrays: LiveArrays, first: int) -> None:
        own = arrays._replace(filter_state=self._filter_state, step=self._step.address)
        live.replay_call()(own, first, False)

    def _back(self, step_log: Array, start: Array, behind: Array) -> Array:
        sampled = np.zeros(len(step_log), dtype=np.bool_)
        smooth_back(self._kernel, step_log, start, *self._no_starts, sampled, behind, self._out)
        return behind
