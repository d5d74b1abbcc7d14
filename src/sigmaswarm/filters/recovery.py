"""Lost and found: how a filter notices that it has lost its way, and where it starts anew.

The fixes of the last seconds tell position, speed and heading by themselves (`drives.alignment`). A filter that
contradicts them for long, and by far more than it allows for, is lost: it starts anew from such an alignment. One rule
serves a run and a live filter.

The numbers are from nine recordings, each run by filters tuned on it and on others. Where a filter is sound its heading
is 20 deg off the alignments for 8 s at most (fixes drift sideways in a city), and its position is 20 m and 5 sigma off
the fixes for 6 s; where it is lost, for 18 s and more.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import MAX_DURATION, Alignments, InitialState
from sigmaswarm.drives.drive import Array, Drive, Gps, Imu
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.live import LEAP
from sigmaswarm.filters.models import THETA, planar5
from sigmaswarm.geodesy import wrap_angle

LOOK_INTERVAL = 1.0
"""s between two looks at a filter."""
LATEST_LOOK = 0.25
"""s from a fix to the IMU sample at which the filter is looked at; after more, in a gap, nothing can be compared."""
LOST_AFTER = 10.0
"""s of contradiction, unbroken; longer than a city drives fixes aside, and a robust filter needs to recover."""
FEWEST_LOOKS = 5
"""Looks in that time at least."""
MANY_SIGMAS = 5.0
"""Standard deviations, as filter and fixes state them, by which the two contradict each other."""
HEADING_OFF = np.radians(20.0)
"""rad between the filter's heading and that of an alignment: less is no loss, whatever the filter says of itself."""
POSITION_OFF = 20.0
"""m between the filter's forecast and a fix; the same."""
SUSPECT = np.radians(10.0)
"""rad between the filter's heading and a rough course, from which on it is worth while to align."""
SPEED_STD = 10.0
"""m/s per axis: what is known of the velocity while there is nothing but fixes."""
_KEPT = MAX_DURATION + 1.0
"""s of samples and fixes that a live filter keeps for it."""
_MOST_FIXES = 1000
"""That many of them; more come only while the IMU is silent."""


@dataclass(frozen=True, eq=False)
class Looks:
    """When a filter is looked at.

    Attributes
    ----------
    step : ndarray of int, shape (l,)
        The steps of the time line after which it is: each ends at an IMU sample.
    fix : ndarray of int, shape (l,)
        The last fix absorbed before, by its number on the time line.
    """

    step: NDArray[np.intp]
    fix: NDArray[np.intp]


def looks_of(line: Timeline) -> Looks:
    """At the first IMU sample after new fixes in each `LOOK_INTERVAL`.

    Not at one that ends a long silence: a live filter takes it only with the next one.
    """
    sampled, absorbing = np.flatnonzero(line.sampled), np.flatnonzero(line.absorbs)
    before = np.searchsorted(absorbing, sampled, side="right")  # fixes absorbed up to each sample
    fresh = np.flatnonzero(np.diff(before, prepend=0) > 0)
    step, last = sampled[fresh], absorbing[before[fresh] - 1]
    silence = np.diff(line.end[sampled], prepend=line.start)[fresh]
    soon = (line.end[step] - line.end[last] <= LATEST_LOOK) & (silence <= LEAP)
    step, last = step[soon], last[soon]
    first = np.unique(slot_of(line.end[step], line.start), return_index=True)[1]
    fix = np.searchsorted(line.fix_time, line.end[last[first]], side="right") - 1
    return Looks(step[first], fix)


def slot_of(time: Array | float, start: float) -> Array:
    """The interval between looks that a time lies in, counted from the start."""
    return np.floor((time - start) / LOOK_INTERVAL + 1e-6)


@dataclass(frozen=True, eq=False)
class Seen:
    """What is looked at: a filter's belief after an IMU sample, and what the fixes say.

    Attributes
    ----------
    time : s
    mean, covariance : (n,), (n, n)
    fix_time, fix : s; (2,) m: the last fix
    fix_variance : (2,) m2
    lever : (2,) m forward and left from the IMU to the antenna
    latency : s
    since : (k, 4) s, m/s2, m/s2, rad/s: the steps from the fix to the moment, each with its ax, ay, gz
    course : function that gives the heading at the fix, rad, roughly; NaN where there is no alignment
    align : function that gives the alignment that ends at the fix, or None; costly
    """

    time: float
    mean: Array
    covariance: Array
    fix_time: float
    fix: Array
    fix_variance: Array
    lever: Array
    latency: float
    since: Array
    course: Callable[[], float]
    align: Callable[[], InitialState | None]

    @property
    def position_contradicts(self) -> bool:
        """Whether the fix lies far off the filter's forecast."""
        x, y, vx, vy, theta = self.mean[:5]
        back = self.latency + self.time - self.fix_time
        off = self.fix - np.array([x - back * vx, y - back * vy]) - _turned(self.lever, theta)
        if off @ off <= POSITION_OFF**2:
            return False
        covariance = self.covariance[:2, :2] + np.diag(self.fix_variance)
        return bool(off @ np.linalg.solve(covariance, off) > MANY_SIGMAS**2)

    @property
    def heading_contradicts(self) -> bool | None:
        """Whether the heading is far off that of the alignment; None where there is none."""
        theta, course = self.mean[THETA], self.course()
        if np.isnan(course):
            return None
        turned = float(self.since[:, 0] @ self.since[:, 3])
        if abs(wrap_angle(float(course + turned - theta))) < SUSPECT:
            return False
        aligned = self.start
        if aligned is None:
            return None
        off = abs(wrap_angle(float(aligned.mean[THETA] - theta)))
        std = np.sqrt(self.covariance[THETA, THETA] + aligned.covariance[THETA, THETA])
        return bool(off > max(HEADING_OFF, MANY_SIGMAS * std))

    @property
    def start(self) -> InitialState | None:
        """Where a filter could start anew at this moment: the alignment, moved on by the steps since the fix."""
        aligned = self.align()
        if aligned is None:
            return None
        mean = aligned.mean
        for dt, *imu in self.since:
            mean = planar5(mean, dt, np.array(imu))
        sound = np.isfinite(mean).all() and np.isfinite(aligned.covariance).all()
        return InitialState(mean, aligned.covariance, self.time) if sound else None


class Recovery:
    """Watches one filter, look by look.

    Attributes
    ----------
    restarts : list of float
        s: when it started anew.
    lost : bool
        It is lost, and there is no alignment to start from: the estimate is the last fix, see `at_fix`.
    """

    def __init__(self) -> None:
        self.restarts: list[float] = []
        self.lost = False
        self._position, self._heading = _Contradiction(), _Contradiction()

    def look(self, seen: Seen) -> InitialState | None:
        """Where the filter is to start anew; None where it goes on as it is, or is ``lost``."""
        if not np.isfinite(seen.mean).all():  # it failed, and says so
            return None
        with np.errstate(all="ignore"):  # of what is not finite nothing is believed
            return self._judged(seen)

    def _judged(self, seen: Seen) -> InitialState | None:
        if not self.lost:
            self._position.note(seen.time, seen.position_contradicts)
            self._heading.note(seen.time, seen.heading_contradicts)
            if not (self._position.lasts or self._heading.lasts):
                return None
        start = seen.start
        self.lost = start is None
        if start is not None:
            self.restarts.append(float(start.time))
            self._position, self._heading = _Contradiction(), _Contradiction()
        return start


def said_of_restarts(drive: str, times: Sequence[float]) -> str:
    """What a filter did on a drive, to follow its name."""
    at = ", ".join(f"{t:.1f}" for t in times[:5]) + (" ..." if len(times) > 5 else "")
    often = f"{len(times)} times" if len(times) > 1 else "once"
    return f"lost its way on {drive} and started anew {often}, at t = {at} s"


class _Contradiction:
    """How long looks have contradicted a filter without a break."""

    def __init__(self) -> None:
        self._since, self._now, self._looks = 0.0, 0.0, 0

    def note(self, time: float, contradicts: bool | None) -> None:
        """What a look says; None: nothing, which is no break."""
        if contradicts is False:
            self._looks = 0
        elif contradicts:
            self._since = time if self._looks == 0 else self._since
            self._now = time
            self._looks += 1

    @property
    def lasts(self) -> bool:
        """Long enough for the filter to be lost."""
        return self._looks >= FEWEST_LOOKS and self._now - self._since >= LOST_AFTER


class Lately:
    """The last seconds that a live filter has seen, enough to align.

    Parameters
    ----------
    lever : sequence of float
        m forward and left from the IMU to the antenna.
    """

    def __init__(self, lever: Sequence[float]) -> None:
        self._lever = tuple(lever)
        self._samples, self._fixes = deque[tuple[float, ...]](), deque[tuple[float, ...]]()

    def sample(self, sample: tuple[float, float, float, float]) -> None:
        """An IMU sample, after all before it: time, ax, ay, gz."""
        samples = self._samples
        samples.append(sample)
        if samples[0][0] < sample[0] - _KEPT:
            self._forget()

    def _forget(self) -> None:
        """The samples from too long ago; one from before a gap stays."""
        samples, oldest = self._samples, self._samples[-1][0] - _KEPT
        while len(samples) > 1 and samples[1][0] < oldest:
            samples.popleft()

    def fix(self, time: float, x: float, y: float, var_x: float, var_y: float) -> None:
        """A fix and its stated variance, in whatever order; it has to be finite."""
        self._fixes.append((time, x, y, var_x, var_y))
        if len(self._fixes) > 1 and self._fixes[-2][0] > time:
            self._fixes = deque(sorted(self._fixes, key=itemgetter(0)))
        oldest = self._samples[-1][0] - _KEPT if self._samples else -np.inf
        while self._fixes and (self._fixes[0][0] < oldest or len(self._fixes) > _MOST_FIXES):
            self._fixes.popleft()

    @property
    def newest(self) -> float:
        """s, of the latest fix; -inf where there is none."""
        return self._fixes[-1][0] if self._fixes else -np.inf

    def last_fix(self, until: float) -> tuple[float, ...] | None:
        """The last fix up to a moment: time, x, y and the stated variances."""
        return next((fix for fix in reversed(self._fixes) if fix[0] <= until), None)

    def steps_since(self, time: float) -> Array:
        """The steps from a moment to the last sample, (k, 4), as `Seen.since`."""
        rows: list[tuple[float, ...]] = []
        for sample in reversed(self._samples):
            if sample[0] < time:
                break
            rows.append(sample)
        steps = np.array(rows[::-1])
        steps[:, 0] = np.diff(steps[:, 0], prepend=time)
        return steps

    def alignments(self, gyro_bias: float) -> Alignments:
        """Of the fixes of these seconds, and what samples there are that are numbers; the gyro's less a bias, rad/s."""
        samples = np.array(self._samples) - np.array([0.0, 0.0, 0.0, gyro_bias])
        imu = Imu(*samples[np.isfinite(samples).all(axis=1)].T)
        now = self._samples[-1][0]
        gps = Gps(*np.array([fix[:3] for fix in self._fixes if fix[0] <= now]).T)
        return Alignments(Drive("live", imu, gps, metadata={"gps_lever_arm_m": self._lever}))


def at_fix(time: float, fix: Array, variance: Array, theta: float, lever: Array) -> InitialState:
    """What is known of a car that can't be aligned: a fix (2,) m, and its variance (2,) m2."""
    mean = np.array([*(fix - _turned(lever, theta)), 0.0, 0.0, theta])
    return InitialState(mean, np.diag([*variance, SPEED_STD**2, SPEED_STD**2, np.pi**2 / 3]), time)


def _turned(lever: Array, theta: float) -> Array:
    c, s = np.cos(theta), np.sin(theta)
    return np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]])
