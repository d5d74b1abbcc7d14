"""Lost and found: how a filter notices that it has lost its way, and where it starts anew.

The fixes of the last seconds tell position, speed and heading by themselves (`drives.alignment`). A filter that
contradicts them for long, and by far more than it allows for, is lost: it starts anew from such an alignment. One rule
serves a run and a live filter.

The numbers are from nine recordings, each run by filters tuned on it and on others. Where a filter is sound its heading
is 20 deg off the alignments for 8 s at most (fixes drift sideways in a city), and its position is 20 m and 5 sigma off
the fixes for 6 s; where it is lost, for 18 s and more.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import Alignments, InitialState
from sigmaswarm.drives.drive import Array, Drive, Gps, Imu
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled.live import LEAP
from sigmaswarm.filters.compiled.watch import LATEST_LOOK, LOOK_INTERVAL
from sigmaswarm.filters.models import GYRO_BIAS, THETA, planar5
from sigmaswarm.geodesy import wrap_angle

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
    since : function that gives the steps from the fix to the moment, (k, 4) s, m/s2, m/s2, rad/s, with ax, ay, gz
    heading : function that gives the heading at the moment by the log alone, rad, roughly; NaN where it says nothing
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
    since: Callable[[], Array]
    heading: Callable[[], float]
    align: Callable[[], InitialState | None]

    @property
    def position_contradicts(self) -> bool:
        """Whether the fix lies far off the filter's forecast."""
        x, y, vx, vy, theta = self.mean[:5].tolist()
        back = self.latency + self.time - self.fix_time
        east, north = self.fix.tolist()  # plain numbers: nearly always it ends here
        c, s = math.cos(theta), math.sin(theta)
        forward, left = self.lever[:2].tolist()
        east -= x - back * vx + c * forward - s * left
        north -= y - back * vy + s * forward + c * left
        if math.hypot(east, north) <= POSITION_OFF:
            return False
        off = np.array([east, north])
        covariance = self.covariance[:2, :2] + np.diag(self.fix_variance)
        try:
            return bool(off @ np.linalg.solve(covariance, off) > MANY_SIGMAS**2)
        except np.linalg.LinAlgError:  # a fix and a filter that are both certain
            return True

    @property
    def heading_contradicts(self) -> bool | None:
        """Whether the heading is far off that of the alignment; None where there is none."""
        theta, heading = float(self.mean[THETA]), self.heading()
        if not math.isfinite(heading):
            return None
        if abs(math.remainder(heading - theta, math.tau)) < SUSPECT:
            return False
        aligned = self.start
        if aligned is None:
            return None
        off = abs(wrap_angle(float(aligned.mean[THETA]) + self._turned_by_bias(aligned) - theta))
        std = np.sqrt(self.covariance[THETA, THETA] + aligned.covariance[THETA, THETA])
        return bool(off > max(HEADING_OFF, MANY_SIGMAS * std))

    def _turned_by_bias(self, aligned: InitialState) -> float:
        """How far an alignment would head elsewhere, rad, with the gyro's bias that the filter knows."""
        gyro = aligned.gyro
        if gyro is None or len(self.mean) <= GYRO_BIAS:
            return 0.0
        more = float(self.mean[GYRO_BIAS]) - gyro.taken
        return more * (float(gyro.turns[THETA]) - (self.time - self.fix_time))

    @property
    def start(self) -> InitialState | None:
        """Where a filter could start anew at this moment: the alignment, moved on by the steps since the fix."""
        aligned = self.align()
        if aligned is None:
            return None
        mean, gyro = aligned.mean, aligned.gyro
        biases = np.array([0.0, 0.0, gyro.taken if gyro else 0.0])
        for dt, *imu in self.since():
            mean = planar5(mean, dt, np.array(imu) - biases)
        sound = np.isfinite(mean).all() and np.isfinite(aligned.covariance).all()
        return InitialState(mean, aligned.covariance, self.time, gyro) if sound else None


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
        return self.look_back([seen.time], lambda _: seen)[1]

    def look_back(
        self, times: Sequence[float], seen: Callable[[int], Seen]
    ) -> tuple[int | None, InitialState | None]:
        """Look at a filter at some moments: the first at which it is lost, and where it could start anew there.

        ``seen`` gives what is seen at the k-th of the times, s. Of one that is ``lost`` already only one is looked at.
        """
        with np.errstate(all="ignore"):  # of what is not finite nothing is believed
            first = 0 if self.lost else self._first_lost(times, seen)
            if first is None:
                return None, None
            start = seen(first).start
        self.lost = start is None
        if start is not None:
            self.restarts.append(float(start.time))
            self._position, self._heading = _Contradiction(), _Contradiction()
        return first, start

    def _first_lost(self, times: Sequence[float], seen: Callable[[int], Seen]) -> int | None:
        far = self._position.first_lasting(times, lambda k: seen(k).position_contradicts)
        times = times if far is None else times[: far + 1]
        turned = self._heading.first_lasting(times, lambda k: seen(k).heading_contradicts)
        return far if turned is None else turned


def said_of_restarts(drive: str, times: Sequence[float]) -> str:
    """What a filter did on a drive, to follow its name."""
    at = ", ".join(f"{t:.1f}" for t in times[:5]) + (" ..." if len(times) > 5 else "")
    often = f"{len(times)} times" if len(times) > 1 else "once"
    return f"lost its way on {drive} and started anew {often}, at t = {at} s"


class _Contradiction:
    """How long looks have contradicted a filter without a break."""

    def __init__(self) -> None:
        self._since, self._now, self._looks = 0.0, 0.0, 0

    def first_lasting(self, times: Sequence[float], says: Callable[[int], bool | None]) -> int | None:
        """The first of some looks at which it lasts; None where it does not.

        ``says`` takes long, so it is asked backwards from the next look at which it could last, until one says that
        nothing contradicts: what was before that one plays no part.
        """
        begin = 0
        while begin < len(times):
            end, said = begin + self._soonest(times[begin:]), list[tuple[int, bool | None]]()
            for k in range(end, begin - 1, -1):
                said.append((k, says(k)))
                if said[-1][1] is False:
                    break
            for k, contradicts in reversed(said):
                self.note(times[k], contradicts)
                if self.lasts:
                    return k
            begin = end + 1
        return None

    def _soonest(self, times: Sequence[float]) -> int:
        """The first look at which it would last if all contradicted; the last one where none is."""
        since = self._since if self._looks else times[0]
        lasting = (
            t - since >= LOST_AFTER and self._looks + k + 1 >= FEWEST_LOOKS for k, t in enumerate(times)
        )
        return next((k for k, lasts in enumerate(lasting) if lasts), len(times) - 1)

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


def steps_since(samples: Array, time: float) -> Array:
    """The steps from a moment to the last sample, (k, 4), as `Seen.since`, of samples (m, 4 or more)."""
    steps = samples[samples[:, 0] >= time, :4]
    steps[:, 0] = np.diff(steps[:, 0], prepend=time)
    return steps


def aligned_by(samples: Array, fixes: Array, lever: Array, gyro_bias: float) -> InitialState | None:
    """By the last seconds of a stream: samples (k, 4 or 6) time, ax, ay, gz, gx, gy, and fixes (m, 3) s, m, m.

    ``gyro_bias``: what is known of it about up, rad/s.
    """
    columns = samples[np.isfinite(samples).all(axis=1)].T
    columns[3] -= gyro_bias
    imu = Imu(**dict(zip(("time", "ax", "ay", "gz", "gx", "gy"), columns, strict=False)))
    if not len(imu):
        return None
    drive = Drive("live", imu, Gps(*fixes.T), metadata={"gps_lever_arm_m": tuple(lever.tolist())})
    try:
        alignments = Alignments(drive)
        found = alignments.at(len(alignments.time) - 1) if len(alignments.time) else None
    except (ArithmeticError, np.linalg.LinAlgError):  # of samples such as 1e200
        return None
    if found is None or found.gyro is None or not gyro_bias:
        return found
    return replace(found, gyro=found.gyro.beside(gyro_bias))


def at_fix(time: float, fix: Array, variance: Array, theta: float, lever: Array) -> InitialState:
    """What is known of a car that can't be aligned: a fix (2,) m, and its variance (2,) m2."""
    mean = np.array([*(fix - _turned(lever, theta)), 0.0, 0.0, theta])
    return InitialState(mean, np.diag([*variance, SPEED_STD**2, SPEED_STD**2, np.pi**2 / 3]), time)


def _turned(lever: Array, theta: float) -> Array:
    c, s = np.cos(theta), np.sin(theta)
    return np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]])
