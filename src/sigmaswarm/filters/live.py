"""`LiveFilter`: a filter that processes one sample at a time."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.events import bits_of
from sigmaswarm.drives.stale_fixes import STALE
from sigmaswarm.drives.standstill import FIX_WINDOW, new_memory
from sigmaswarm.drives.table_files import MAX_VALUE
from sigmaswarm.drives.tables import NO_HEADING
from sigmaswarm.drives.timeline import AXES
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled import live
from sigmaswarm.filters.compiled.layout import N_KEPT, R, state_rows
from sigmaswarm.filters.compiled.memory import LiveArrays, Memory
from sigmaswarm.filters.compiled.monitor import MONITOR_SPAN
from sigmaswarm.filters.compiled.single import single_step
from sigmaswarm.filters.divergence import (
    DivergenceMonitor,
    StateCheck,
    align_stream,
    state_at_fix,
    steps_since,
)
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.models import MODELS, THETA, require_driven_by_imu
from sigmaswarm.filters.packing import state_estimate
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.smoothing import FixedLag
from sigmaswarm.filters.starts import measured_by
from sigmaswarm.geodesy import wrap_angle

MAX_RESTARTS = 1000  # largest number of times in `LiveFilter.restarts`
MAX_READINGS = 2000  # odometer readings stored in addition to those of the history: ten seconds at 200 Hz
MONITORED_RATE_RATIO = (
    4  # the monitor covers its full span if the IMU is up to this many times as fast as stated
)
MAX_HISTORY = 100_000  # largest history and lag in IMU intervals: 100 s at 1 kHz, 0.2 GB
MAX_WAITING_FIXES = 1000  # approximate number of fixes that can wait during a gap of the IMU
_NO_NUMBERS = (TypeError, LookupError, OverflowError)
"""Exceptions due to invalid input, for example text, None, too few numbers, or an integer of 400 digits."""


@dataclass(frozen=True, eq=False)
class LiveState:
    """State estimate of a live filter.

    Attributes
    ----------
    time : time of the last IMU sample, s
    mean : ndarray, shape (n,); heading wrapped to (-pi, pi]
    covariance : ndarray, shape (n, n)
    failed : bool: the covariance is not positive semidefinite, or a number is not finite
    lost : bool: the filter has diverged and no alignment is available yet; the position is the last fix
    """

    time: float
    mean: Array
    covariance: Array
    failed: bool
    lost: bool = False


class LiveFilter:
    """A Kalman filter that processes one sample at a time.

    Samples are in the axes of the vehicle. If the IMU is mounted as in the training drives, SciPy's
    ``Rotation.from_euler("xyz", tuning.mounting, degrees=True)`` rotates raw samples into these axes.

    A fix waits for the next IMU sample. The filter is then propagated to the time of the fix, updated, and propagated
    to the time of the sample. If a fix is at most ``history`` seconds late, the filter returns to the time of the fix
    and processes the later samples again. The state therefore equals the result of `run_filter` for the same data in
    time order. Fixes with the same time, for example from two receivers, are processed one after the other. A fix that
    is identical to an earlier fix is a repeated message and is ignored. A stale fix is not used: see
    `drives.stale_fixes`.

    Without IMU samples, the state does not change and fixes wait; the next sample bridges the gap (`drives.gaps`). A
    sample whose time stamp is more than 10 s ahead of the filter waits for the next sample. If that sample is at most 1
    s later, both samples are used, as after a gap; otherwise the first sample is dropped and counted in ``time_jumps``.
    The same rule applies to fixes; IMU samples near the time of a fix also confirm it.

    At most once a second, the divergence monitor compares the filter with the latest fixes and resets a diverged filter
    (`divergence`). If fixes are delayed, the reset is later than in `run_filter`. Fixes from before a reset count as
    too late.

    The memory has a fixed size. The first filter of a process loads or compiles the code (`compiled.live`,
    `divergence.compile_resets`).

    Parameters
    ----------
    parameters : FilterParameters
    initial : InitialState
        Start state and time.
    nominal_interval : float
        Interval between IMU samples, s.
    lever_arm : sequence of float
        Vector from the IMU to the antenna, m forward and left: a drive's ``lever_arm``. tilted12 also reads a third
        number, m up: ``[*drive.lever_arm, drive.antenna_height]``; the default is 0.
    history : float
        Largest delay of a fix, s.
    recover : bool
        Reset the filter if it diverges.
    as_recorded : bool
        Run without preprocessing, for diagnosis: use stale fixes, and treat IMU gaps as ordinary steps.
    lag : float, optional
        Delay of the `smoothed` state, s.

    Attributes
    ----------
    restarts : list of float
        Times of the last `MAX_RESTARTS` resets, s.
    too_late : int
        Number of fixes and odometer readings that were ignored because they were more than ``history`` s late, because
        too many of them waited in an IMU gap, or because their time or speed was not finite.
    time_jumps : int
        Number of samples, fixes and odometer readings that were dropped because their time stamps were far ahead and
        not confirmed.
    frozen : int
        Number of stale fixes, which are not used.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        initial: InitialState,
        *,
        nominal_interval: float,
        lever_arm: Sequence[float] = (0.0, 0.0),
        history: float = 1.0,
        recover: bool = True,
        as_recorded: bool = False,
        lag: float | None = None,
    ) -> None:
        _check_spans(nominal_interval, history, lag)
        p = parameters
        require_driven_by_imu(p.model, "a live filter or filter bank")
        self.parameters = p
        self._calls, kernel = live.live_calls(), p.kernel
        self._state = state_rows(kernel)
        self._axes = MODELS[p.model].imu
        self._no_axes = (0.0,) * (len(AXES) - len(self._axes))
        self._plausible = bool(KernelArray((p,)).plausible[0])
        filter_state = _initial_filter_state(p, initial, nominal_interval, lever_arm)
        filter_state[live.AS_RECORDED], filter_state[live.LATE_BY] = as_recorded, history
        span = 1.25 * max(history, (lag or -1.0) + nominal_interval)  # s; an IMU may run faster than stated
        samples = max(1, int(np.ceil(span / nominal_interval)))
        # At most one fix per sample
        waiting = MAX_WAITING_FIXES + samples + int(FIX_WINDOW / nominal_interval)
        monitored = 2 + int(MONITORED_RATE_RATIO * MONITOR_SPAN / nominal_interval)
        arrays = LiveArrays(
            filter_state,
            np.zeros(live.N_COUNTS, dtype=np.int64),
            new_memory()[: 0 if p.standstill_noise is None else None],
            np.zeros((waiting, live.N_FIX)),
            np.zeros((0 if p.odometer_noise is None else MAX_READINGS + int(200 * history), 2)),
            np.zeros((samples, live.N_RECORD)),
            np.zeros((0, 0)),
            np.zeros((monitored if recover else 0, live.N_SAMPLE)),
        )
        self._memory = Memory(single_step(kernel), arrays)
        self._interval, self._lever = nominal_interval, np.array(lever_arm[:2], dtype=np.float64)
        self._monitor = DivergenceMonitor() if recover else None
        self._holds = False  # diverged: the estimate is the last fix at each sample
        most_steps = waiting + samples
        self._lag = None if lag is None else FixedLag(kernel, lag, self._memory.arrays, most_steps=most_steps)

    def predict(self, t: float, imu: Sequence[float]) -> None:
        """Process an IMU sample. It is ignored if its time is not after that of the last sample.

        A sample more than 10 s ahead waits (see `LiveFilter`). Samples before the start of the filter do not change the
        state; they are used only to detect gaps, standstills and divergence.

        Parameters
        ----------
        t : float
            Time stamp, s.
        imu : sequence of float
            The axes that the model reads, in the order of the model (m/s2, rad/s); for planar models ax, ay, gz.

        Raises
        ------
        InputError
            If the number of axes differs from that of the model, or a value is not numeric.
        """
        if len(imu) != len(self._axes):
            raise InputError(
                f"the IMU sample has {len(imu)} numbers, but {self.parameters.model} reads {', '.join(self._axes)}; "
                "pass the axes that it reads, in this order"
            )
        try:
            took = self._calls.sample(self._memory.handle, t, *imu, *self._no_axes)
        except _NO_NUMBERS as error:
            raise InputError(f"the IMU sample contains values that are not numbers: {error}") from None
        # Most samples need no check.
        if took == live.DUE or (self._holds and took and t > self._filter_state[live.START]):
            self._check_divergence(t, due=took == live.DUE)

    def update(
        self,
        t: float,
        fix: Sequence[float],
        velocity: Sequence[float] | None = None,
        std: Sequence[float] | None = None,
        heading: Sequence[float] | None = None,
    ) -> bool:
        """Process a fix.

        Parameters
        ----------
        t : float
            Time stamp, s.
        fix : sequence of float
            Position of the antenna, x and y, m.
        velocity : sequence of float, optional
            Velocity, m/s east and north, for a filter with ``velocity_noise``.
        std : sequence of float, optional
            Standard deviations that the receiver states, m east and north. A filter with ``accuracy_scale`` needs them;
            a filter with ``fix_error`` uses them if they are given.
        heading : sequence of float, optional
            Heading and its stated standard deviation, rad (0 if none is stated), for a filter with ``heading_noise``.

        Returns
        -------
        bool
            False if the fix was ignored (before the start of the filter, too late, or repeated) or waits for
            confirmation.

        Raises
        ------
        InputError
            If a value is not numeric, or the filter needs ``std`` and it is missing.
        """
        try:
            p = self.parameters
            takes = p.accuracy_scale is not None or (std is not None and p.fix_error is not None)
            more = *(_squared(std) if takes else (0.0, 0.0)), 0.0, math.inf
            if heading is not None and p.heading_noise is not None:
                more = *more[:2], *_known_heading(*heading)
            measured = fix[0], fix[1], 0.0, 0.0, 0.0
            if velocity is not None and p.velocity_noise is not None:
                measured = (fix[0], fix[1], velocity[0], velocity[1], 1.0)
            return self._calls.fix(self._memory.handle, t, *measured, *more) == live.TAKEN
        except _NO_NUMBERS as error:
            raise InputError(f"the fix contains values that are not numbers, or too few: {error}") from None

    def update_odometer(self, t: float, speed: float) -> bool:
        """Process an odometer reading: time stamp, s, and speed, m/s, positive forward.

        The reading waits for the next IMU sample. A late reading is processed like a late fix.

        Returns
        -------
        bool
            False if the reading was ignored: the filter uses no odometer, or the reading is too late, is more than 10 s
            ahead, is not finite, or has the time of an earlier reading.
        """
        try:
            return self._calls.speed(self._memory.handle, t, speed) == live.TAKEN
        except _NO_NUMBERS as error:
            raise InputError(f"the odometer reading is not a number: {error}") from None

    def _check_divergence(self, now: float, *, due: bool) -> None:
        fix, monitor = self._last_fix(now), self._monitor
        if fix is None or monitor is None:
            return
        start = self._reset_state(monitor, now, fix, self._estimate, due=due)
        if start is not None:
            self._reset(start)
        self._holds = monitor.lost

    def _reset_state(
        self,
        monitor: DivergenceMonitor,
        now: float,
        fix: Array,
        estimate: Callable[[], tuple[Array, Array]],
        *,
        due: bool,
        gyro_bias: float = 0.0,
    ) -> InitialState | None:
        """Return the state for a reset, or None if no reset is due.

        ``gyro_bias`` is the known bias of the gyro, rad/s.
        """
        start = monitor.take(self._check(now, fix, *estimate(), gyro_bias)) if due else None
        if monitor.lost:
            theta = float(estimate()[0][THETA])
            return state_at_fix(
                now, fix[live.FIX_X : live.FIX_Y + 1], self._variance_of(fix), theta, self._lever
            )
        return start

    def _last_fix(self, now: float) -> Array | None:
        fixes = self._counted_fixes
        until = int(np.searchsorted(fixes[:, live.FIX_TIME], now, side="right"))
        return fixes[until - 1] if until else None

    def _variance_of(self, fix: Array) -> Array:
        stated = fix[live.FIX_VAR_X : live.FIX_VAR_Y + 1]
        return self._filter_state[[R.RX, R.RY]] + self._filter_state[R.ACCURACY] * stated

    def _check(
        self, now: float, fix: Array, mean: Array, covariance: Array, gyro_bias: float = 0.0
    ) -> StateCheck:
        time = float(fix[live.FIX_TIME])
        return StateCheck(
            time=now,
            mean=mean,
            covariance=covariance,
            fix_time=time,
            fix=fix[live.FIX_X : live.FIX_Y + 1],
            fix_variance=self._variance_of(fix),
            lever=self._lever,
            latency=self.parameters.latency,
            since=lambda: steps_since(self._samples, time),
            heading=lambda: self._calls.heading(self._memory.handle, gyro_bias),
            align=cache(lambda: self._aligned(gyro_bias)),
        )

    @property
    def _samples(self) -> Array:
        """Samples of the last `MONITOR_SPAN` seconds and one earlier sample: time, ax, ay, gz (and gx, gy if used)."""
        arrays, columns = self._memory.arrays, [0, *_ALIGNING[: 5 if "gx" in self._axes else 3]]
        newest, n = int(arrays.counts[live.NEWEST]), int(arrays.counts[live.N_LATELY])
        samples = arrays.lately[np.arange(newest - n + 1, newest + 1) % len(arrays.lately)][:, columns]
        return samples[max(0, int(np.searchsorted(samples[:, 0], samples[-1, 0] - MONITOR_SPAN)) - 1) :]

    def _aligned(self, gyro_bias: float) -> InitialState | None:
        return align_stream(self._samples, self._counted_fixes[:, : live.FIX_Y + 1], self._lever, gyro_bias)

    @property
    def _counted_fixes(self) -> Array:
        arrays = self._memory.arrays
        fixes = arrays.fixes[: arrays.counts[live.N_FIXES]]
        finite = np.isfinite(fixes[:, [live.FIX_X, live.FIX_Y]]).all(axis=1)
        return fixes[(fixes[:, live.KIND] < STALE) & finite]

    def _reset(self, start: InitialState) -> None:
        """Reset the filter and clear the history, so that earlier fixes are too late."""
        rows = KernelArray((self.parameters,)).start([start], [self._interval])
        self._filter_state[:N_KEPT] = rows[0, :, 0]
        counts = self._memory.arrays.counts
        counts[live.N_HISTORY] = counts[live.OLDEST] = 0

    @property
    def _filter_state(self) -> Array:
        return self._memory.arrays.filter_state

    def _estimate(self) -> tuple[Array, Array]:
        """Return the mean (n,), whose heading is not wrapped, and the covariance (n, n)."""
        mean, covariance = state_estimate(self._filter_state[self._state, np.newaxis], self.parameters.kernel)
        return mean[0], covariance[0]

    @property
    def restarts(self) -> list[float]:
        """Times of the last resets, s (see `LiveFilter`)."""
        return [] if self._monitor is None else self._monitor.restarts[-MAX_RESTARTS:]

    @property
    def too_late(self) -> int:
        """Number of fixes and odometer readings that came too late (see `LiveFilter`)."""
        return int(self._memory.arrays.counts[live.TOO_LATE])

    @property
    def time_jumps(self) -> int:
        """Number of dropped data whose time stamps were far ahead (see `LiveFilter`)."""
        return int(self._memory.arrays.counts[live.TIME_JUMPS])

    @property
    def frozen(self) -> int:
        """Number of stale fixes, which are not used."""
        return int(self._memory.arrays.counts[live.N_STALE])

    @property
    def state(self) -> LiveState:
        """State estimate after the last IMU sample and all earlier fixes."""
        time, definite = float(self._filter_state[live.TIME]), self._calls.definite(self._memory.handle)
        return self._state_at(time, self._filter_state[self._state], definite)

    @property
    def smoothed(self) -> LiveState:
        """Smoothed state at the last IMU sample that is at least ``lag`` s old; computed at each access.

        This state equals the result of `smooth` at that time with the data so far. Its ``time`` is never before the
        start or the last reset.

        Raises
        ------
        InputError
            If no ``lag`` was given.
        """
        if self._lag is None:
            raise InputError(
                "a live filter without lag has no smoothed state; create it with a lag, for example lag=2.0"
            )
        return self._state_at(*self._lag.smoothed(self._memory.arrays), True)

    def _state_at(self, time: float, packed: Array, definite: bool) -> LiveState:
        with np.errstate(all="ignore"):  # overflow is reported as failed
            mean, covariance = (
                part[0] for part in state_estimate(packed[:, np.newaxis], self.parameters.kernel)
            )
        lost = self._monitor is not None and self._monitor.lost
        sound = definite and self._filter_state[live.OK] == 1.0 and self._plausible
        return live_state(time, mean, covariance, lost, sound)


def live_state(time: float, mean: Array, covariance: Array, lost: bool, sound: bool) -> LiveState:
    """Return a state with a wrapped heading; ``mean`` changes in place."""
    sound = sound and bool(np.isfinite(mean).all() and np.isfinite(covariance).all())
    if np.pi < abs(mean[THETA]) < np.inf or mean[THETA] == -np.pi:
        mean[THETA] = wrap_angle(float(mean[THETA]))
    return LiveState(time, mean, covariance, not sound, lost)


_ALIGNING = (1, 2, 3, 5, 6)
"""Indices of ax, ay, gz, gx, gy in a stored sample: `AXES` after the time."""


def _check_spans(interval: float, history: float, lag: float | None) -> None:
    if lag is not None and not 0 < lag < np.inf:
        raise InputError(f"lag = {lag}: pass a positive number of seconds, or omit lag")
    if not (interval > 0 and history >= 0 and max(history, lag or 0) <= MAX_HISTORY * interval < np.inf):
        raise InputError(
            f"nominal_interval = {interval} s, history = {history} s, lag = {lag} s: pass a positive "
            f"interval, and a history and lag of at most {MAX_HISTORY} intervals"
        )


def _known_heading(theta: float, std: float) -> tuple[float, float]:
    """Return the heading (rad) and its stated variance (rad2; infinite without a heading), as in `Timeline.fixes`."""
    known = math.isfinite(theta) and 0 <= std < NO_HEADING
    return (theta, std**2) if known else (0.0, math.inf)


def _squared(std: Sequence[float] | None) -> tuple[float, float]:
    if std is None or not (len(std) == 2 and 0 <= std[0] <= MAX_VALUE and 0 <= std[1] <= MAX_VALUE):
        raise InputError(
            f"std = {std}: the filter uses the standard deviations that the receiver states for each fix; "
            f"pass two standard deviations in m, at most {MAX_VALUE:g}, or use a filter that was tuned without "
            "accuracy and fix-error"
        )
    return float(std[0]) ** 2, float(std[1]) ** 2


def _initial_filter_state(
    p: FilterParameters, initial: InitialState, nominal_interval: float, lever_arm: Sequence[float]
) -> Array:
    v = np.zeros(live.N_ALL)
    v[:N_KEPT] = KernelArray((p,)).start([initial], [nominal_interval])[0, :, 0]
    v[live.TIME] = v[live.START] = initial.time
    v[live.DONE] = -1.0, -1.0, -1.0, initial.time
    v[live.NOMINAL] = nominal_interval
    v[live.LEVER][: len(lever_arm)] = lever_arm
    v[live.USED] = bits_of(measured_by(p))
    v[live.LAST_SAMPLE] = v[live.SEEN_FIX] = -np.inf
    v[live.LAST_CHECK] = -1.0
    given = MODELS[p.model].imu
    nothing = len(given)  # zeros follow the model's axes
    v[live.ORDER] = [given.index(axis) if axis in given else nothing for axis in AXES]
    v[live.STOP_TIME] = -np.inf
    v[live.DIMENSION] = len(FILTERS[p.kernel].states)
    return v
