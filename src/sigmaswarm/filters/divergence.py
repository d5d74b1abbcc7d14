"""Detection and reset of diverged filters.

Position, speed and heading are estimated from the fixes of the last few seconds, without a filter (`drives.alignment`).
A filter has diverged if its heading differs from this alignment, or its position differs from the fixes, by far more
than the covariances allow, for `DIVERGED_AFTER` seconds. It is then reset to the alignment.

The thresholds were chosen on nine recordings. Filters that had not diverged differed from the alignments by more than
20 deg in heading for at most 8 s. They differed from the fixes by more than 20 m and 5 standard deviations for at most
6 s. For diverged filters, both differences lasted for at least 18 s.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import call_once
from sigmaswarm.drives.alignment import Alignments, InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.events import slot_of
from sigmaswarm.drives.tables import Gps, Imu, Indices
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.live import LEAP
from sigmaswarm.filters.compiled.monitor import CHECK_INTERVAL, LATEST_CHECK
from sigmaswarm.filters.models import GYRO_BIAS, MODELS, THETA, planar5
from sigmaswarm.filters.starts import starts_of
from sigmaswarm.geodesy import wrap_angle

DIVERGED_AFTER = 10.0  # s, contradiction before a reset; bad fixes and recovering filters cause shorter ones
MIN_CHECKS = 5  # smallest number of consecutive checks with a contradiction before a reset
MANY_SIGMAS = 5.0  # a contradiction exceeds this number of standard deviations of the difference
HEADING_OFF = np.radians(20.0)  # rad; contradicting headings of filter and alignment differ by more
POSITION_OFF = 20.0  # m; a contradicting fix differs from its prediction by more
SUSPECT_HEADING = np.radians(10.0)  # rad, difference from the rough heading that triggers an alignment
SPEED_STD = 10.0  # m/s per axis, standard deviation of the velocity after a reset to the last fix
CHECKS, SINCE, LAST = range(3)
"""Columns of the record of a contradiction between filter and fixes: number of checks, first and last time (s)."""


def check_times(line: Timeline) -> tuple[Indices, Indices]:
    """Find, in each `CHECK_INTERVAL`, the first IMU sample that follows a new fix within `LATEST_CHECK`.

    Return, for each of l checks, the step that ends at this sample, and the last fix before this sample; both are
    indices, (l,). Samples after a gap of more than `LEAP` are left out, since a live filter uses such a sample only
    after the next one.
    """
    sampled, updating = np.flatnonzero(line.sampled), np.flatnonzero(line.updates)
    before = np.searchsorted(updating, sampled, side="right")  # fixes up to each sample
    fresh = np.flatnonzero(np.diff(before, prepend=0) > 0)
    step, last = sampled[fresh], updating[before[fresh] - 1]
    silence = np.diff(line.end[sampled], prepend=line.start)[fresh]
    soon = (line.end[step] - line.end[last] <= LATEST_CHECK) & (silence <= LEAP)
    step, last = step[soon], last[soon]
    slot = slot_of(line.end[step], line.start, CHECK_INTERVAL)
    first = np.unique(slot, return_index=True)[1]
    fix = np.searchsorted(line.fix_time, line.end[last[first]], side="right") - 1
    return step[first], fix


@dataclass(frozen=True, eq=False)
class StateCheck:
    """Data of one check: a filter's state after an IMU sample, and the last fixes."""

    time: float  # s
    mean: Array  # (n,)
    covariance: Array  # (n, n)
    fix_time: float  # time of the last fix, s
    fix: Array  # (2,), m
    fix_variance: Array  # (2,), m2
    lever: Array  # (2,), m forward and left from the IMU to the antenna
    latency: float  # age of a fix at its time stamp, s
    since: Callable[[], Array]  # steps from the fix to the check, (k, 4): dt (s), ax, ay (m/s2), gz (rad/s)
    heading: Callable[[], float]  # rough heading at the check, computed without a filter (rad), or NaN
    align: Callable[[], InitialState | None]  # alignment that ends at the fix, or None; slow

    @property
    def position_contradicts(self) -> bool:
        """True if the last fix is far from the filter's prediction."""
        back = self.latency + self.time - self.fix_time
        fix, variance, lever = self.fix, self.fix_variance, self.lever
        return bool(position_contradicts(self.mean, self.covariance, fix, variance, lever, back))

    @property
    def heading_contradicts(self) -> bool | None:
        """True if the filter's heading is far from that of the alignment; None without a rough heading or alignment."""
        theta, heading = float(self.mean[THETA]), self.heading()
        if not math.isfinite(heading):
            return None
        if abs(math.remainder(heading - theta, math.tau)) < SUSPECT_HEADING:
            return False
        aligned = self.start
        if aligned is None:
            return None
        off = abs(wrap_angle(float(aligned.mean[THETA]) + self._turned_by_bias(aligned) - theta))
        std = np.sqrt(self.covariance[THETA, THETA] + aligned.covariance[THETA, THETA])
        return bool(off > max(HEADING_OFF, MANY_SIGMAS * std))

    def _turned_by_bias(self, aligned: InitialState) -> float:
        """Return the change in heading at the check (rad) if the filter's gyro bias replaces that of the alignment."""
        gyro = aligned.gyro
        if gyro is None or len(self.mean) <= GYRO_BIAS:
            return 0.0
        change = float(self.mean[GYRO_BIAS]) - gyro.taken
        return change * (float(gyro.turns[THETA]) - (self.time - self.fix_time))

    @property
    def start(self) -> InitialState | None:
        """State for a reset at the check: the alignment, propagated by the steps since the fix."""
        aligned = self.align()
        if aligned is None:
            return None
        mean, gyro = aligned.mean, aligned.gyro
        biases = np.array([0.0, 0.0, gyro.taken if gyro else 0.0])
        for dt, *imu in self.since():
            mean = planar5(mean, dt, np.array(imu) - biases)
        sound = np.isfinite(mean).all() and np.isfinite(aligned.covariance).all()
        return replace(aligned, mean=mean, time=self.time) if sound else None


class DivergenceMonitor:
    """Monitor that checks one filter periodically and decides on its reset.

    Attributes
    ----------
    restarts : list of float
        Times of the resets, s.
    lost : bool
        True while the filter has diverged and no alignment is available for a reset; the estimate is then
        `state_at_fix`.
    """

    def __init__(self) -> None:
        compile_resets()
        self.restarts: list[float] = []
        self.lost = False
        self._position, self._heading = _Contradiction(), _Contradiction()

    def take(self, check: StateCheck) -> InitialState | None:
        """Evaluate a check. Return the state for a reset, or None if the filter continues or becomes ``lost``."""
        if not np.isfinite(check.mean).all():  # the run reports this failure
            return None
        return self.take_all([check.time], lambda _: check)[1]

    def take_all(
        self, times: Sequence[float], check_at: Callable[[int], StateCheck]
    ) -> tuple[int | None, InitialState | None]:
        """Evaluate checks at several times (s). Return the index of the first divergence and the state for a reset.

        ``check_at`` returns the check at the k-th time. If the filter is ``lost``, only the first check is evaluated.
        """
        with np.errstate(all="ignore"):  # non-finite values are not a contradiction
            first = 0 if self.lost else self._first_diverged(times, check_at)
            if first is None:
                return None, None
            start = check_at(first).start
        self.lost = start is None
        if start is not None:
            self.restarts.append(float(start.time))
            self._position, self._heading = _Contradiction(), _Contradiction()
        return first, start

    def _first_diverged(self, times: Sequence[float], check_at: Callable[[int], StateCheck]) -> int | None:
        far = self._position.first_lasting(times, lambda k: check_at(k).position_contradicts)
        times = times if far is None else times[: far + 1]
        turned = self._heading.first_lasting(times, lambda k: check_at(k).heading_contradicts)
        return far if turned is None else turned


def record_check(contradiction: Array, time: float, contradicts: bool) -> None:
    """Record a check at a time, s; a check without a contradiction clears the record."""
    if contradicts:
        if contradiction[CHECKS] == 0:
            contradiction[SINCE] = time
        contradiction[LAST] = time
        contradiction[CHECKS] += 1
    else:
        contradiction[CHECKS] = 0


def persists(contradiction: Array) -> bool:
    """Return True if a contradiction has lasted long enough for a reset."""
    lasted = contradiction[LAST] - contradiction[SINCE]
    return contradiction[CHECKS] >= MIN_CHECKS and lasted >= DIVERGED_AFTER


def position_contradicts(
    mean: Array, covariance: Array, fix: Array, variance: Array, lever: Array, back: float
) -> bool:
    """Return True if a fix is far from its prediction, the antenna's position ``back`` seconds ago."""
    c, s = math.cos(mean[THETA]), math.sin(mean[THETA])
    x = fix[0] - mean[0] + back * mean[2] - (c * lever[0] - s * lever[1])
    y = fix[1] - mean[1] + back * mean[3] - (s * lever[0] + c * lever[1])
    # Innovation covariance S; if S is 0, the position is far by the first condition alone.
    xx, xy, yy = covariance[0, 0] + variance[0], covariance[0, 1], covariance[1, 1] + variance[1]
    most = MANY_SIGMAS * MANY_SIGMAS * (xx * yy - xy * xy)
    return x * x + y * y > POSITION_OFF * POSITION_OFF and yy * x * x - 2.0 * xy * x * y + xx * y * y >= most


def describe_restarts(drive: str, times: Sequence[float]) -> str:
    at = ", ".join(f"{t:.1f}" for t in times[:5]) + (" ..." if len(times) > 5 else "")
    often = f"{len(times)} times" if len(times) > 1 else "once"
    return f"diverged on {drive} and was reset {often}, at t = {at} s"


class _Contradiction:
    """Duration for which the measurements have contradicted the estimate without interruption."""

    def __init__(self) -> None:
        self._record = np.zeros(3)

    def first_lasting(self, times: Sequence[float], contradicts: Callable[[int], bool | None]) -> int | None:
        """Return the index of the first check at which the contradiction has lasted `DIVERGED_AFTER`, or None.

        ``contradicts(k)`` is slow. Therefore, the search runs backwards in time, from the first check that could
        complete this duration to the last check without a contradiction.
        """
        begin = 0
        while begin < len(times):
            end, results = begin + self._soonest(times[begin:]), list[tuple[int, bool | None]]()
            for k in range(end, begin - 1, -1):
                results.append((k, contradicts(k)))
                if results[-1][1] is False:
                    break
            for k, result in reversed(results):
                if result is not None:  # None does not end a contradiction
                    record_check(self._record, times[k], result)
                if persists(self._record):
                    return k
            begin = end + 1
        return None

    def _soonest(self, times: Sequence[float]) -> int:
        """Return the index of the first check that could complete `DIVERGED_AFTER`, or the index of the last check."""
        checks = self._record[CHECKS]
        since = self._record[SINCE] if checks else times[0]
        lasting = (t - since >= DIVERGED_AFTER and checks + k + 1 >= MIN_CHECKS for k, t in enumerate(times))
        return next((k for k, lasts in enumerate(lasting) if lasts), len(times) - 1)


def steps_since(samples: Array, time: float) -> Array:
    """Return the steps from a time to the last sample, (k, 4), as in `StateCheck.since`; samples are (m, 4 or more)."""
    steps = samples[samples[:, 0] >= time, :4]
    steps[:, 0] = np.diff(steps[:, 0], prepend=time)
    return steps


_MAX_MAGNITUDE = 1e12  # m, m/s2 or rad/s; samples and fixes with larger numbers are not used


def align_stream(samples: Array, fixes: Array, lever: Array, gyro_bias: float) -> InitialState | None:
    """Compute an alignment from the last few seconds of a live filter's data.

    ``samples`` (k, 4 or 6) contains time, ax, ay, gz and, if known, gx, gy. ``fixes`` (m, 3) contains time (s), x, y
    (m). ``gyro_bias`` is the known bias of gz, rad/s.
    """
    columns = samples[(np.abs(samples[:, 1:]) < _MAX_MAGNITUDE).all(axis=1)].T
    fixes = fixes[(np.abs(fixes[:, 1:]) < _MAX_MAGNITUDE).all(axis=1)]
    columns[3] -= gyro_bias
    imu = Imu(**dict(zip(("time", "ax", "ay", "gz", "gx", "gy"), columns, strict=False)))
    if not len(imu):
        return None
    drive = Drive("live", imu, Gps(*fixes.T), metadata={"gps_lever_arm_m": tuple(lever.tolist())})
    try:
        alignments = Alignments(drive)
        alignment = alignments.at(len(alignments.time) - 1) if len(alignments.time) else None
    except ArithmeticError:  # for extreme samples or times
        return None
    if alignment is None or alignment.gyro is None or not gyro_bias:
        return alignment
    tilt = alignment.tilt and alignment.tilt.with_bias(gyro_bias)
    return replace(alignment, gyro=alignment.gyro.with_bias(gyro_bias), tilt=tilt)


@call_once
def compile_resets() -> None:
    """Compile or load the functions of a reset in advance. Otherwise, the first reset would wait for seconds."""
    samples, fixes = np.zeros((100, 6)), np.zeros((100, 3))
    samples[:, 0] = fixes[:, 0] = 0.1 * np.arange(100)
    fixes[:, 1] = 10.0 * fixes[:, 0]  # 10 m/s to the east
    start = align_stream(samples, fixes, np.zeros(2), 0.0)
    if start is not None:
        starts_of([start], MODELS["tilted12"], np.ones((1, 3)))


def state_at_fix(time: float, fix: Array, variance: Array, theta: float, lever: Array) -> InitialState:
    """Return the state at a fix (m) with its variance (m2), both (2,); the speed and the heading are uncertain."""
    c, s = np.cos(theta), np.sin(theta)
    turned = np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]])
    mean = np.array([*(fix - turned), 0.0, 0.0, theta])
    return InitialState(mean, np.diag([*variance, SPEED_STD**2, SPEED_STD**2, np.pi**2 / 3]), time)
