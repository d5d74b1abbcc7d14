"""Find the start of a filter (its time and initial state) from samples up to this time, without truth.

The heading of a car is not observable at standstill. After several meters of driving, the course over ground shows it.
The fit to the fixes of the last few seconds (`alignment_fit`) uses the gyro to correct the course for turns, and the
accelerometer to correct it for changes of speed. The gyro's bias is subtracted, and the fit repeated, only if the fixes
contradict a gyro without bias, or if the vehicle is slow.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment_fit import AlignmentFit, InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gyro_bias import CONTRADICTS, MAX_BIAS, GyroBiasEvidence
from sigmaswarm.drives.sensors import white_noise
from sigmaswarm.drives.stale_fixes import stale_fixes
from sigmaswarm.drives.tables import Indices, headings_of
from sigmaswarm.errors import AlignmentError
from sigmaswarm.geodesy import wrap_angle

MIN_DURATION = 4.0  # s, shortest duration of an alignment
MAX_DURATION = 6.0  # s, longest duration of an alignment; the error due to the gyro's bias grows with time
MIN_TRAVEL = 20.0  # m, smallest travel within `MAX_DURATION` for an accurate heading; requires 12 km/h
ALIGNMENT_FIXES = 4  # smallest number of fixes within `MAX_DURATION`; one fix every 3 s is not enough
# m, smallest chord (distance from the first to the last fix), a cheap test before the fit
MIN_CHORD = 0.5 * MIN_TRAVEL
# largest residual of an alignment, relative to the travel; fixes that jump have larger residuals
MAX_MISFIT = 0.3
MAX_HEADING_STD = np.radians(6.0)  # rad, largest standard deviation of the heading of an alignment
REFITS = 3  # number of repeated fits, after which the gyro bias has converged

SLOW_DURATIONS = 15.0, 30.0, 60.0, 90.0  # s, windows for slow vehicles, see `SLOW_CHORD`
SLOW_TRAVEL = 10.0  # m, smallest travel in a window for slow vehicles
SLOW_SPEED = 0.15  # m/s, smallest mean speed of slow vehicles; fixes of a parked receiver drift more slowly
SLOW_CHORD = 1.5 * MIN_TRAVEL  # m; on a slow drive, fixes within `MAX_DURATION` are never farther apart
SLOW_HEADING_STD = np.radians(12.0)  # rad, as `MAX_HEADING_STD`, including the effect of the gyro's bias
# For slow vehicles that drive to and fro in a small area: smallest chord, m, largest standard deviation of the heading,
# rad, and largest residual relative to the travel. The last two exclude parked receivers, whose positions wander.
NEAR_CHORD, NEAR_HEADING_STD, NEAR_MISFIT = 2.0, np.radians(3.0), 0.04
SLOW_FIXES = 8  # smallest number of fixes in a window for slow vehicles
SLOW_INTERVAL = 1.0  # s, smallest interval between used fixes; errors of closer fixes are correlated
SLOW_STEP = 2.0  # s between trials of windows for slow vehicles
SLOW_BIAS_STD = np.radians(1.0)  # rad/s, standard deviation of the prior of the gyro's bias for slow vehicles

REPAIR_FINDINGS = "repair the findings of `sigmaswarm doctor`"
STATE_HEADING = (
    "write the heading at the first IMU sample (degrees counter-clockwise from east) at the top of drive.toml, for "
    "example heading_deg = 90, or import with --heading-from-north"
)
STATED_HEADING_STD = np.radians(5.0)  # rad, smallest assumed standard deviation of a stated heading
MAX_STATED_STD = np.radians(12.0)  # rad, largest stated standard deviation of a heading for a start
# Standard deviations at a start with a stated heading
STATED_POSITION_STD = 3.0  # m per axis
STATED_SPEED_STD = 10.0  # m/s forward
STATED_LATERAL_STD = 1.0  # m/s to the left


@dataclass(frozen=True)
class StartFailure:
    what: str
    remedy: str


def initial_state(drive: Drive, *, as_recorded: bool = False) -> InitialState:
    """Find the first time at which position, speed and heading are known.

    The start is the first fix that follows 20 m of forward driving in 4 to 6 s (12 km/h or faster), with at least four
    fixes in that time. On a slower drive, it is the first fix after 10 m of travel in up to 90 s, or after more travel
    if the fixes are noisy. If the metadata have ``heading_deg`` (degrees counter-clockwise from east, at the first IMU
    sample), the start is the first fix. If the fixes have a column ``heading``, the start is not later than the first
    fix with a heading. The state depends only on samples up to the start.

    Parameters
    ----------
    drive : Drive
        The drive; its truth is not used.
    as_recorded : bool
        Also use stale fixes as positions (see `drives.stale_fixes`).

    Raises
    ------
    AlignmentError
        If there is no such time. The message gives the reason.
    """
    found = find_start(drive, as_recorded=as_recorded)
    if isinstance(found, StartFailure):
        raise AlignmentError(f"{drive.name}: {found.what}; {found.remedy}")
    return found


def find_start(drive: Drive, *, as_recorded: bool = False) -> InitialState | StartFailure:
    """Return the initial state as `initial_state` does, or the reason why no filter can start."""
    # a filter can start only if IMU samples follow
    usable = (drive.gps.time > drive.imu.time[0]) & (drive.gps.time < drive.imu.time[-1])
    usable = usable if as_recorded else usable & ~stale_fixes(drive.gps)
    if drive.heading is not None:
        return _stated_start(drive, usable)
    headed = usable & (headings_of(drive.gps)[1] <= MAX_STATED_STD**2)
    first = drive.gps.time[headed][0] if headed.any() else np.inf
    alignments = Alignments(drive, usable)
    for k in range(np.searchsorted(alignments.time, first)):
        if found := alignments.at(k):
            return found
    if headed.any():
        return _stated_start(drive, headed)
    slow = None
    if alignments.slow:
        slow = _slow_start(drive, usable) or _slow_start(drive, usable, near=True)
    return slow or alignments.failure_reason()


def is_slow(drive: Drive) -> bool:
    """Return True if the vehicle is too slow for a normal start: fixes rarely move `MIN_TRAVEL` in `MAX_DURATION`."""
    usable = np.isfinite(drive.gps.x + drive.gps.y)
    time, position = drive.gps.time[usable], drive.gps.position[usable]
    first = np.searchsorted(time, time - MAX_DURATION)
    return bool(len(time)) and float(np.mean(np.abs(position - position[first]) >= MIN_TRAVEL)) < 0.01


def _slow_start(drive: Drive, usable: NDArray[np.bool_], *, near: bool = False) -> InitialState | None:
    """Return the earliest alignment of a slow vehicle. For each fix, shorter windows are tried first."""
    windows = [Alignments(drive, usable, longest, near=near) for longest in SLOW_DURATIONS]
    tried = -np.inf
    for k, time in enumerate(windows[0].time):
        if time - tried >= SLOW_STEP:
            tried = time
            for alignments in windows:
                if found := alignments.at(k):
                    return found
    return None


def _stated_start(drive: Drive, usable: NDArray[np.bool_]) -> InitialState | StartFailure:
    """Return the state at the first usable fix: its speed is unknown, its heading is from drive.toml or the fix."""
    gps, imu = drive.gps, drive.imu
    fixes = np.flatnonzero(usable & np.isfinite(gps.x + gps.y))
    if not len(fixes):
        return StartFailure(
            "no fix lies within the IMU's time span, so no filter can start", "use a longer drive"
        )
    first, time = fixes[0], float(gps.time[fixes[0]])
    std = STATED_HEADING_STD
    if drive.heading is not None:
        theta = wrap_angle(drive.heading + float(np.interp(time, imu.time, _integrated(imu.time, imu.gz))))
    else:
        heading, variance = headings_of(gps)
        theta, std = wrap_angle(float(heading[first])), max(std, float(np.sqrt(variance[first])))
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    x, y = np.array([gps.x[first], gps.y[first]]) - turn @ drive.lever_arm
    covariance = np.diag([STATED_POSITION_STD**2] * 2 + [0.0] * 2 + [std**2])
    covariance[2:4, 2:4] = turn @ np.diag([STATED_SPEED_STD**2, STATED_LATERAL_STD**2]) @ turn.T
    unknown = GyroBiasEvidence(np.zeros(3), np.full(3, np.inf), 0.0, np.zeros(5))
    return InitialState(np.array([x, y, 0.0, 0.0, theta]), covariance, time, unknown)


class Alignments:
    """The alignments that end at each fix, computed on first use.

    ``usable`` (number of fixes,) marks the fixes to use, by default all fixes. ``time`` (m,) contains the times of the
    used fixes within the IMU's time span, s. ``longest`` is the longest duration of an alignment, s; it is above
    `MAX_DURATION` for slow vehicles. ``near`` accepts `NEAR_CHORD` if the heading is accurate, for slow vehicles in a
    small area.
    """

    def __init__(
        self,
        drive: Drive,
        usable: NDArray[np.bool_] | None = None,
        longest: float = MAX_DURATION,
        *,
        near: bool = False,
    ) -> None:
        self._drive = drive
        self._slowly = longest > MAX_DURATION
        inside = (drive.gps.time > drive.imu.time[0]) & (drive.gps.time <= drive.imu.time[-1])
        inside &= np.isfinite(drive.gps.x + drive.gps.y)
        fixes = np.flatnonzero(inside if usable is None else inside & usable)
        self._used, self.time = fixes, drive.gps.time[fixes]
        self._position = drive.gps.position[fixes]
        self._first = np.searchsorted(self.time, self.time - longest, side="left")
        count = np.arange(len(fixes)) - self._first + 1
        self._chord = np.abs(self._position - self._position[self._first])
        shortest, fewest = (longest / 2, SLOW_FIXES) if self._slowly else (MIN_DURATION, ALIGNMENT_FIXES)
        self._many = (self.time - self.time[self._first] >= shortest) & (count >= fewest)
        self._worth = self._many & (self._chord >= (NEAR_CHORD if near else MIN_CHORD))
        # largest standard deviation of the heading, and largest misfit
        self._slow_limits = (NEAR_HEADING_STD, NEAR_MISFIT) if near else (SLOW_HEADING_STD, MAX_MISFIT)
        self._found: dict[int, InitialState | None] = {}

    def at(self, k: int) -> InitialState | None:
        """Return the alignment that ends at the k-th used fix, or None if the fixes or their motion do not suffice."""
        if k not in self._found:
            with np.errstate(all="ignore"):  # a fit that overflows is not an alignment
                fitted = self._fitted_slow if self._slowly else self._fitted
                self._found[k] = fitted(k) if self._worth[k] else None
        return self._found[k]

    @property
    def slow(self) -> bool:
        """True if there are enough fixes, and no window has a chord of `SLOW_CHORD` or more."""
        return bool(self._many.any()) and not np.any(self._chord[self._many] >= SLOW_CHORD)

    def failure_reason(self) -> StartFailure:
        time, travel = f"{MAX_DURATION:g} s", f"{MIN_TRAVEL:g} m"
        if self._many.any():
            if np.any(self._chord[self._many] >= MIN_TRAVEL):
                return StartFailure(
                    f"the positions of the fixes change by {travel} within {time}, but this motion never agrees with "
                    "the IMU, so the heading can't be determined; the fixes scatter or jump, or an axis, a unit or the "
                    "clock of the IMU is wrong",
                    f"{REPAIR_FINDINGS}, or {STATE_HEADING}",
                )
            return StartFailure(
                f"the vehicle never travels {travel} within {time}, and its travel within {SLOW_DURATIONS[-1]:g} s is "
                "always too short relative to the noise of the fixes, so the heading can't be determined",
                f"use a longer or a faster drive ({3.6 * MIN_TRAVEL / MAX_DURATION:.0f} km/h for "
                f"{time}), or {STATE_HEADING}",
            )
        every = float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0
        if every > MAX_DURATION / (ALIGNMENT_FIXES - 1):
            what = f"the fixes are {every:.3g} s apart, but a heading needs {ALIGNMENT_FIXES} fixes within {time}"
            return StartFailure(f"no filter can start, since {what}", "record fixes at 1 Hz or faster")
        span = float(self.time[-1] - self.time[0]) if len(self.time) else 0.0
        usable = f"the usable fixes ({len(self.time)} of {len(self._drive.gps.time)}) span {span:.3g} s"
        needs = f"a heading needs {ALIGNMENT_FIXES} fixes within {time} that span at least {MIN_DURATION:g} s"
        return StartFailure(
            f"no filter can start, since {usable}, but {needs}",
            "use a longer drive with fixes at 1 Hz or faster, without gaps or repeated positions",
        )

    def _fitted(self, k: int) -> InitialState | None:
        fit = self._fit(np.arange(self._first[k], k + 1))
        if CONTRADICTS * fit.yaw_std < abs(fit.yaw_bias) < MAX_BIAS:
            for _ in range(REFITS):
                fit.subtract(fit.yaw_bias)
        smooth = fit.misfit <= MAX_MISFIT * fit.travel
        usable = fit.travel >= MIN_TRAVEL and fit.heading_std <= MAX_HEADING_STD and smooth
        return fit.state() if usable else None

    def _fitted_slow(self, k: int) -> InitialState | None:
        """Fit the gyro's bias too, and do not use the accelerometer, since the effect of its bias grows with time.

        The part of the fixes' stated variance that is not white noise is attributed to lasting errors.
        """
        first = int(self._first[k])
        interval = float(self.time[k] - self.time[first]) / (k - first)
        rows = np.arange(k, first - 1, -max(1, round(SLOW_INTERVAL / interval)))[::-1]
        if len(rows) < SLOW_FIXES:
            return None
        fit, share = self._fit(rows), 0.0
        for _ in range(REFITS):
            share = float(1.0 / (1.0 + (fit.bias_std / SLOW_BIAS_STD) ** 2))
            fit.subtract(share * fit.yaw_bias)
        fit.add_bias_variance(share * fit.bias_std**2)
        std = self._drive.gps.std
        stated = self._drive.metadata.get("gps_std_m", 0.0) if std is None else std[:, self._used[rows]]
        lasting = float(np.median(stated)) ** 2 - white_noise(self._position[rows]) ** 2
        fit.add_lasting_errors(max(lasting, 0.0))
        largest_std, misfit = self._slow_limits
        far = fit.travel >= max(SLOW_TRAVEL, SLOW_SPEED * fit.span) and fit.misfit <= misfit * fit.travel
        usable = far and fit.heading_std <= largest_std and abs(fit.yaw_bias) < MAX_BIAS
        return fit.state(tilts=False) if usable else None

    def _fit(self, rows: Indices) -> AlignmentFit:
        axes = {axis: values for axis, values in self._integrals.items() if axis != "ax" or not self._slowly}
        return AlignmentFit(self._drive, axes, self.time[rows], self._position[rows])

    @cached_property
    def _integrals(self) -> dict[str, Array]:
        """Time integrals of the IMU's measurements since the first sample, by axis."""
        imu = self._drive.imu
        rates = {axis: getattr(imu, axis) for axis in ("gz", "ax", "gx", "gy", "ay")}
        return {axis: _integrated(imu.time, rate) for axis, rate in rates.items() if rate is not None}

    @cached_property
    @np.errstate(all="ignore")
    def course(self) -> Array:
        """Rough heading at each fix, rad, shape (m,). NaN if the window has too few fixes or a chord below `MIN_CHORD`.

        The heading is the direction of the chord, corrected for turns. A change of speed in a turn causes an error of a
        few degrees.
        """
        imu, turned = self._drive.imu, self._integrals["gz"]
        direction = np.exp(1j * turned)
        direction[1:] = 0.5 * (direction[1:] + direction[:-1]) * np.diff(imu.time)
        direction[0] = 0.0
        way = np.cumsum(direction, out=direction)
        at = np.interp(self.time, imu.time, way)
        psi = np.interp(self.time, imu.time, turned)
        first, last = self._first[self._worth], np.flatnonzero(self._worth)
        course = np.full(len(self.time), np.nan)
        chord = self._position[last] - self._position[first]
        course[last] = np.angle(chord * (at[last] - at[first]).conj() * np.exp(1j * psi[last]))
        return course


def _integrated(time: Array, rate: Array) -> Array:
    """Return the time integral of a rate since the first IMU sample, at the IMU's times."""
    return np.concatenate([[0.0], np.cumsum(rate[1:] * np.diff(time))])
