"""Fits and masks that all checks use."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import (
    DELAYS,
    MAX_RECORDED_ANGLE,
    MIN_VARIED,
    AccelerationFit,
    PlanarMounting,
    fit_acceleration,
    planar_mounting,
)
from sigmaswarm.doctor.clocks import (
    MAX_OFFSET,
    MIN_OFFSET,
    MIN_SEARCH_TURN,
    OFFSET_SIGMAS,
    ClockDrift,
    ClockOffset,
    clock_drift,
    clock_of,
    leveled_delay,
    search_offset,
)
from sigmaswarm.doctor.fixes import Course, course_of, mark_jumps, with_exchanged_axes, with_reversed_east
from sigmaswarm.doctor.mounting import Mounting, mounting_of, rotate_imu
from sigmaswarm.doctor.truth import MIN_DELAY, TruthFit, fit_truth, truth_as_fixes, truth_delay
from sigmaswarm.doctor.yaw_fit import MIN_GAIN_TURN, SUFFICIENT_SHARE, Yaw, YawFit, fit_yaw, yaw_of
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.sensors import robust_std, white_noise
from sigmaswarm.drives.stale_fixes import stale_fixes
from sigmaswarm.drives.suggestion import SuggestedFilter, suggest_filter
from sigmaswarm.drives.tables import Mask

MAX_FIT_OFFSET = 2.3  # s, largest offset that the fit determines; the fit tries delays up to 2.5 s
MIN_SEARCH_OFFSET = 0.3  # s, smallest offset that the search determines
# s, largest usual delay of a receiver; a larger delay is accepted if the search finds no other offset
MAX_USUAL_DELAY = 1.0
# Interpretation of a gyro without faults; another one is accepted only if no clock offset explains the data
AS_RECORDED = Yaw(known=True)
# Smallest cosine of the angles between az and gravity, and between ax and forward, at which mirrored fixes can be
# distinguished from an IMU with other axes.
MIN_UPRIGHT_COSINE = 0.7
MIN_SCALE_SIGMAS = 4.0  # smallest scale of ax and ay, in standard deviations, that confirms mirrored fixes
MIN_FIXES = 20  # smallest number of fixes for the checks that need motion
# Ratio of the stated noise to the scatter about a path of 10 s above which most of the error lasts longer than 10 s
MAX_SCATTER_RATIO = 2.5
# s, part of the standard deviation of the truth's delay that the fit to the IMU does not show. Without it, the error of
# one of 65 parts of 60 s of simulated drives exceeded 3.3 standard deviations; with it, the largest error is 2.2
# standard deviations.
MIN_TRUTH_STD = 0.03
CACHE_SIZE = 256  # number of drives whose scatter is cached, since each repetition of a tuning needs it
_scatters: dict[str, float] = {}
Mirror = Literal["", "exchanged", "reversed"]


@dataclass(frozen=True, eq=False)
class Evidence:
    drive: Drive  # with its IMU rotated by `mounting` if necessary; all fits are in these axes
    stale: Mask  # (n,), fixes that repeat an earlier fix
    outlying: Mask  # (n,), fixes far from the path
    used: NDArray[np.intp]  # (m,), indices of the fixes in `course`
    course: Course | None
    yaw_fit: YawFit | None
    yaw: Yaw  # interpretation of `yaw_fit`
    acceleration: AccelerationFit | None
    mount: PlanarMounting | None  # interpretation of `acceleration`
    clock: ClockOffset
    noise: float  # m per axis, noise from fix to fix
    scatter: float  # m per axis, scatter of the fixes about the path over ten seconds
    mounting: Mounting | None  # for a log with six axes
    moved: float = 0.0  # s, subtracted from the fixes' times if the clocks are far apart
    # The coordinates of the fixes are exchanged, or those in degrees have a wrong sign; the other fields refer to
    # corrected fixes
    mirrored: Mirror = ""

    @property
    def mounted(self) -> bool:
        """True if a known rotation of the IMU needs a correction."""
        return self.mounting is not None and self.mounting.needed

    @property
    def drives(self) -> bool:
        """True if any fix has a course."""
        return self.course is not None and bool(self.course.moving.any())

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the IMU, s."""
        return float(self.drive.imu.time[0]), float(self.drive.imu.time[-1])

    @property
    def delay(self) -> float:
        """Delay of the fixes in `course`, s, without `moved`, which is part of `clock`."""
        return self.clock.delay - self.moved

    @property
    def yaw_rate(self) -> Array:
        """The yaw rate (n,), rad/s, with correct column, sign and unit."""
        return self.yaw.rate(self.drive.imu)

    @cached_property
    def suggestion(self) -> SuggestedFilter:
        """The default filter of `tune` for the drive."""
        return suggest_filter([self.drive])

    @cached_property
    def clock_drift(self) -> ClockDrift | None:
        if self.course is None or self.yaw_fit is None:
            return None
        return clock_drift(self.drive, self.course, self.yaw_fit, self.yaw, self.noise)

    @cached_property
    def truth_delay(self) -> float | None:
        """Delay of the truth's clock relative to the recorded times of the fixes, s. None if this delay is unknown."""
        truth, gps = self.drive.truth, self.drive.gps
        if truth is None:
            return None
        delay = truth_delay(gps.time, gps.position, truth.time, truth.x + 1j * truth.y)
        return None if delay is None else delay - self.moved

    @cached_property
    def truth_fit(self) -> TruthFit | None:
        """Fit of the fixes to the truth; None without truth, or if the fixes are mirrored."""
        return None if self.course is None or self.mirrored else fit_truth(self.drive, self.course)

    @property
    def truth_has_clock_of_fixes(self) -> bool:
        """True if the truth has the clock of the fixes, not that of the IMU."""
        delay = self.truth_delay
        return delay is not None and abs(delay) < min(abs(delay + self.clock.delay), MIN_DELAY)


def gather(drive: Drive) -> Evidence:
    """Fit the gyro to the course and the accelerometers to the path, and interpret the fits.

    If the recorded gyro does not follow the course with a delay below 1 s, search for a clock offset of up to 40 s.
    If the recorded IMU agrees only with a mirror image of the fixes, all evidence refers to the mirror image.
    """
    evidence = _read(drive)
    evidence = _mirrored(evidence, drive) or evidence
    if clock := _clock_of_truth(evidence):
        evidence = replace(evidence, clock=clock)
    for old in list(_scatters)[: max(len(_scatters) + 1 - CACHE_SIZE, 0)]:
        _scatters.pop(old, None)
    _scatters[fingerprint(drive)] = evidence.scatter
    return evidence


def _clock_of_truth(evidence: Evidence) -> ClockOffset | None:
    """Estimate the delay of the fixes from the truth, on the clock of the fixes; None if impossible or not needed.

    An estimate from the truth is more accurate, since its errors are far smaller than those of the fixes.
    """
    clock = evidence.clock
    if evidence.moved or not MIN_OFFSET < clock.least < math.inf or (fit := evidence.truth_fit) is None:
        return None
    found = _gather(truth_as_fixes(evidence.drive, fit)).clock
    return clock.refined(found.delay, math.hypot(found.std, fit.std, MIN_TRUTH_STD))


def fix_scatter(drive: Drive) -> float:
    """Return `Evidence.scatter` of a drive, m per axis; the result is cached."""
    cached = _scatters.get(fingerprint(drive))
    return gather(drive).scatter if cached is None else cached


def _read(drive: Drive) -> Evidence:
    evidence = as_recorded = _gather(drive)
    course, fit = evidence.course, evidence.yaw_fit
    if course is None or fit is None:
        return evidence
    fits = evidence.yaw.known and abs(fit.delay) < MAX_FIT_OFFSET
    if fit.share > SUFFICIENT_SHARE and evidence.yaw == AS_RECORDED and abs(fit.delay) < MAX_USUAL_DELAY:
        return evidence
    delay = search_offset(drive, course)
    if (
        fits or fit.course_change < MIN_SEARCH_TURN
    ):  # only a large offset would contradict this interpretation
        if delay is None or abs(delay) < MAX_FIT_OFFSET:
            return evidence
    elif delay is None and (delay := search_offset(drive, course, scaled=True)) is None:
        # no axis can be interpreted without a common clock
        return replace(evidence, yaw=Yaw(), mount=None, clock=ClockOffset())
    rest = 0.0
    for _ in range(2):  # the fits determine the remaining offset
        evidence = _gather(replace(drive, gps=replace(drive.gps, time=drive.gps.time - delay)))
        # At walking speed, an antenna ahead of the rear axle looks like seconds of delay.
        rest = evidence.clock.delay if evidence.clock.std < MIN_SEARCH_OFFSET else 0.0
        delay += rest
    if not evidence.yaw.known:  # the turns agree only with an arbitrary factor
        return replace(as_recorded, yaw=Yaw(), mount=None, clock=ClockOffset())
    uncertain = OFFSET_SIGMAS[2] * evidence.clock.std if math.isfinite(evidence.clock.std) else 0.0
    if abs(delay) < max(MIN_SEARCH_OFFSET, uncertain):
        return as_recorded
    return replace(
        evidence, clock=ClockOffset(delay, max(evidence.clock.std, 0.05), MAX_OFFSET), moved=delay - rest
    )


def _mirrored(found: Evidence, drive: Drive) -> Evidence | None:
    """Compute the evidence with a mirror image of the fixes. Return None if no mirror image explains the IMU.

    No rotation of the IMU reverses gz and ay while z points up and ax agrees with the motion. An IMU on its side or
    upside down is excluded, since reversed accelerometers would then have the same effect.
    """
    imu, yaw, fit = drive.imu, found.yaw, found.yaw_fit
    if imu.az is None or fit is None or fit.course_change < MIN_GAIN_TURN:
        return None
    force = np.array([np.median(v) for v in (imu.ax, imu.ay, imu.az)])
    # 0.5 excludes logs without gravity, in m/s2 and in g
    if force[2] < max(MIN_UPRIGHT_COSINE * float(np.linalg.norm(force)), 0.5):
        return None
    turned_over = found.mounting is not None and found.mounting.repair[2, 2] < 0
    if yaw.known and yaw.factor > 0 and not turned_over:
        return None
    # an exchange changes the scale of degrees, unlike a sign, so the better fit shows which of the two is the fault
    others: dict[Mirror, Drive | None] = {
        "exchanged": with_exchanged_axes(drive),
        "reversed": with_reversed_east(drive),
    }
    read = [replace(_read(other), mirrored=kind) for kind, other in others.items() if other is not None]
    return max(filter(_agrees, read), key=lambda new: new.yaw_fit.share if new.yaw_fit else 0.0, default=None)


def _agrees(new: Evidence) -> bool:
    mount, upright = new.mount, np.diag(new.mounting.repair) if new.mounting else np.ones(3)
    right = new.yaw.known and new.yaw.factor > 0 and new.yaw.column == "gz"
    if not right or np.min(upright) < MIN_UPRIGHT_COSINE:
        return False
    if mount is None or not np.array_equal(mount.axes, np.eye(2)):
        return False
    return all(scale > MIN_SCALE_SIGMAS * std for scale, std in mount.scale)


def _gather(drive: Drive) -> Evidence:
    gps, imu = drive.gps, drive.imu
    position, stale = gps.position, stale_fixes(gps)
    inside = ~stale & (gps.time >= imu.time[0]) & (gps.time <= imu.time[-1])
    off = np.zeros(len(gps), dtype=np.bool_)
    off[inside] = mark_jumps(gps.time[inside], position[inside])
    used = np.flatnonzero(inside & ~off)
    course = course_of(gps.time[used], position[used]) if len(used) >= MIN_FIXES else None
    mounting = course and mounting_of(drive, course)
    if mounting and mounting.needed:
        imu = rotate_imu(imu, mounting.repair)
        drive = replace(drive, imu=imu)
    yaw_fit = course and fit_yaw(drive, course)
    yaw, acceleration, mount, clock = yaw_of(yaw_fit, imu), None, None, ClockOffset()
    if course and course.moving.any():
        delay = yaw_fit if yaw_fit and yaw.known and yaw_fit.share > 0.5 else None
        rate, tried = yaw.rate(imu), (delay.delay if delay else 0.0) + DELAYS
        acceleration = fit_acceleration(drive, course, rate, tried)
        mount = acceleration and planar_mounting(acceleration)
        as_recorded = (
            mount and np.array_equal(mount.matrix, np.eye(2)) and abs(mount.angle) <= MAX_RECORDED_ANGLE
        )
        if delay and not as_recorded:
            # Other axes are reported only if they agree with the delay that the gyro shows.
            known = fit_acceleration(drive, course, rate, np.array([delay.delay]), delay.delay_prior)
            mount = known and planar_mounting(known)
        clock = clock_of(yaw_fit, yaw, acceleration, mount)
        if acceleration and acceleration.varied > MIN_VARIED and as_recorded and yaw == AS_RECORDED:
            leveled = leveled_delay(drive, course, clock.delay)
            clock = clock.refined(*leveled) if leveled else clock
    noise, scatter = white_noise(course.position) if course else 0.0, 0.0
    if acceleration:
        n = acceleration.rows.shape[1]  # the three unknowns of each window reduce the residuals
        noise = robust_std(np.diff(acceleration.residual, n=2, axis=1)) / np.sqrt(6.0)
        scatter = robust_std(acceleration.residual) * np.sqrt(n / (n - 3))
        off[used[_far_off(acceleration)]] = True
    return Evidence(
        drive, stale, off, used, course, yaw_fit, yaw, acceleration, mount, clock, noise, scatter, mounting
    )


def _far_off(acceleration: AccelerationFit) -> np.ndarray:
    """Return the indices, among the used fixes, of fixes far from the IMU's path in every window that contains them."""
    size, count = np.abs(acceleration.residual), int(acceleration.rows.max()) + 1
    # m; for Gaussian noise, four times the quantile is 8.6 standard deviations
    off = size > 0.2 + 4 * float(np.quantile(size, 0.9))
    times, far = (
        np.bincount(rows.ravel(), minlength=count) for rows in (acceleration.rows, acceleration.rows[off])
    )
    return np.flatnonzero((far > 0) & (far == times))
