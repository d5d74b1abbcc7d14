"""LiveFilter: one sample at a time, for real-time use, with the results of `run_filter` on the same data."""

from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.standstill import FIX_WINDOW, WINDOW, fixes_stand, is_calm, new_floor
from sigmaswarm.drives.timeline import CORNERING
from sigmaswarm.filters import batch
from sigmaswarm.filters.compiled import lanes, run
from sigmaswarm.filters.compiled.live import live_step
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.geodesy import wrap_angle

MOST_WAITING = 1000
"""Fixes that may wait for an IMU sample; more of them mean that the IMU is silent."""


@dataclass(frozen=True, eq=False)
class LiveState:
    """What the filter believes now.

    Attributes
    ----------
    time : s, of the last IMU sample
    mean : ndarray, shape (n,); heading wrapped to (-pi, pi]
    covariance : ndarray, shape (n, n)
    failed : bool: the covariance lost its definiteness, or something became NaN
    """

    time: float
    mean: Array
    covariance: Array
    failed: bool


@dataclass(slots=True)
class _Sample:
    """An IMU sample, and the filter as it was before it: a late fix goes back to there."""

    time: float
    ax: float
    ay: float
    gz: float
    calm: bool
    before: Array
    before_time: float
    before_since: float
    before_slots: tuple[int, int]
    fixes: list[tuple[float, ...]]


class LiveFilter:
    """A filter that is fed one sample at a time.

    A fix waits for the IMU sample that follows it, which drives the filter to the fix's time and on. A fix that comes
    late, at most ``history`` seconds, takes the filter back to its time and forward again; so the state is the one
    that `run_filter` gives for the same data in order.

    Parameters
    ----------
    parameters : FilterParameters
    initial : InitialState
        Where and when it starts.
    nominal_interval : float
        s between IMU samples.
    lever_arm : sequence of float
        m forward and left from the IMU to the antenna.
    history : float
        s that are kept for late fixes.

    Attributes
    ----------
    too_late : int
        Fixes that were left out: they came later than ``history``, or no IMU sample came for too long.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        initial: InitialState,
        *,
        nominal_interval: float,
        lever_arm: Sequence[float] = (0.0, 0.0),
        history: float = 1.0,
    ) -> None:
        p = parameters
        self.parameters = p
        self.too_late = 0
        self._n = p.n_states
        self._start = initial.time
        self._nominal = nominal_interval
        self._lever = (float(lever_arm[0]), float(lever_arm[1]))
        self._v = np.zeros(lanes.N_ROWS)
        self._v[: lanes.N_STATE] = batch.pack_states(*batch.start_of(initial, [p]))[:, 0]
        self._v[lanes.CONSTANTS] = batch.pack_constants([p], nominal_interval)[:, 0]
        self._v[lanes.DET] = self._v[lanes.OK] = 1.0
        self._v[lanes.RECENT] = -1.0
        self._time = initial.time
        self._last_sample = -np.inf
        self._since = 0.0
        self._slots = (-1, -1)
        self._waiting: list[tuple[float, ...]] = []
        self._fixes: list[tuple[float, float, float]] = []  # for the standstill
        self._looked_at: tuple[int, int] | None = None
        self._stand = False
        length = max(1, int(np.ceil(history / nominal_interval)))
        self._history: deque[_Sample] = deque(maxlen=length)
        self._window = np.empty((4 * max(8, int(WINDOW / nominal_interval) + 2), 4))
        self._filled = 0
        self._floor = new_floor()

    def predict(self, t: float, imu: Sequence[float]) -> None:
        """Take an IMU sample: ax, ay (m/s2), yaw rate (rad/s). One that is not after the last one is left out.

        Samples before the start only teach the filter what calm is, for the standstill.
        """
        if not t > self._last_sample:
            return
        self._last_sample = t
        ax, ay, gz = imu
        calm = self.parameters.standstill_noise is not None and self._is_calm(t, ax, ay, gz)
        if t <= self._start:
            return
        due = [fix for fix in self._waiting if fix[0] <= t]
        if due:
            self._waiting = [fix for fix in self._waiting if fix[0] > t]
        sample = _Sample(t, ax, ay, gz, calm, self._v.copy(), self._time, self._since, self._slots, due)
        self._history.append(sample)
        self._take(sample)

    def update(self, t: float, fix: Sequence[float], velocity: Sequence[float] | None = None) -> bool:
        """Take a fix: x, y (m), and perhaps its velocity, m/s east and north; False if it came too late."""
        z = (
            t,
            float(fix[0]),
            float(fix[1]),
            *(() if velocity is None else (float(velocity[0]), float(velocity[1]))),
        )
        if t <= self._start:  # absorbed already
            self._remember(z)
            return False
        if t > self._time:
            if len(self._waiting) == MOST_WAITING:
                self.too_late += 1
                return False
            insort(self._waiting, z)
            self._remember(z)
            return True
        samples = [s for s in self._history if s.time >= t]
        if not samples or samples[0].before_time >= t:
            self.too_late += 1
            return False
        self._remember(z)
        first = samples[0]
        self._v[:], self._time = first.before, first.before_time
        self._since, self._slots = first.before_since, first.before_slots
        first.fixes = sorted([*first.fixes, z])
        for sample in samples:
            sample.before[:], sample.before_time = self._v, self._time
            sample.before_since, sample.before_slots = self._since, self._slots
            self._take(sample)
        return True

    @property
    def state(self) -> LiveState:
        """What the filter believes after the last IMU sample and all fixes up to then."""
        mean, covariance = batch.unpack_states(self._v[: lanes.N_STATE, np.newaxis], self._n)
        mean[0, 4] = wrap_angle(float(mean[0, 4]))
        failed = self._v[lanes.OK] != 1.0 or not np.isfinite(self._v[: lanes.N_STATE]).all()
        failed |= not batch.plausible(self.parameters)
        return LiveState(self._time, mean[0], covariance[0], bool(failed))

    def _take(self, sample: _Sample) -> None:
        """Step through the fixes that wait to the sample's time."""
        for fix in sample.fixes:
            if fix[0] < sample.time:
                self._step(sample, fix[0], fix, run.FIX)
        at_end = next((fix for fix in sample.fixes if fix[0] == sample.time), None)
        happens = self._constraints(sample) | (run.FIX if at_end else 0)
        self._step(sample, sample.time, at_end, happens)

    def _step(self, sample: _Sample, to: float, fix: tuple[float, ...] | None, happens: int) -> None:
        dt = to - self._time
        scale = dt / self._nominal
        self._since += scale
        zx, zy, zu, zv = 0.0, 0.0, 0.0, 0.0
        if fix is not None:
            zx, zy = fix[1], fix[2]
            if len(fix) == 5 and self.parameters.velocity_noise is not None:
                zu, zv = fix[3], fix[4]
                happens |= run.VELOCITY
        imu = (sample.ax, sample.ay, sample.gz)
        z = (zx, zy, zu, zv)
        step: Any = live_step  # Numba's type says nothing of its arguments
        step(self._v, self._n, dt, *imu, scale, happens, *z, *self._lever, self._since)
        if fix is not None:
            self._since = 0.0
        self._time = to

    def _constraints(self, sample: _Sample) -> int:
        """Which constraints are due at a sample."""
        happens = 0
        lateral, standstill = self._slots
        if self.parameters.lateral_noise is not None and abs(sample.ay) <= CORNERING:
            slot = batch.slot(sample.time, self._start, batch.LATERAL_INTERVAL)
            happens |= run.LATERAL if slot != lateral else 0
            lateral = slot
        if sample.calm and self._fixes_stand(sample.time):
            slot = batch.slot(sample.time, self._start, batch.STANDSTILL_INTERVAL)
            happens |= run.STANDSTILL if slot != standstill else 0
            standstill = slot
        self._slots = (lateral, standstill)
        return happens

    def _is_calm(self, t: float, ax: float, ay: float, gz: float) -> bool:
        if self._filled == len(self._window):  # keep the newer half
            half = self._filled // 2
            self._window[:half] = self._window[half:]
            self._filled = half
        row = self._window[self._filled]
        row[0], row[1], row[2], row[3] = t, ax, ay, gz
        self._filled += 1
        return bool(is_calm(self._window, self._filled - 1, self._floor))

    def _remember(self, fix: tuple[float, ...]) -> None:
        if self.parameters.standstill_noise is None:
            return
        insort(self._fixes, (fix[0], fix[1], fix[2]))
        oldest = self._time - FIX_WINDOW - len(self._history) * self._nominal
        del self._fixes[: bisect_left(self._fixes, (oldest,))]
        self._looked_at = None

    def _fixes_stand(self, now: float) -> bool:
        """What the fixes of the last seconds say; asked again only when there are others than the last time."""
        recent = bisect_left(self._fixes, (now - FIX_WINDOW,)), bisect_right(self._fixes, (now, np.inf))
        if recent != self._looked_at:
            fixes = np.array(self._fixes[slice(*recent)]).reshape(-1, 3)
            self._looked_at, self._stand = recent, fixes_stand(fixes, now)
        return self._stand
