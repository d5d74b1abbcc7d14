"""The fits and masks that all checks look at, worked out once for a drive."""

from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.doctor.acceleration_fit import LATENESS, AccelerationFit, fit_acceleration, heading_of
from sigmaswarm.doctor.clock_search import LEAST_TURN, WIDEST, search_offset
from sigmaswarm.doctor.fixes import Course, Mask, course_of, jumps
from sigmaswarm.doctor.mounting import Mounting, mounting_of, turned
from sigmaswarm.doctor.verdicts import ClockOffset, Mount, Yaw, clock_of, mount_of, yaw_of
from sigmaswarm.doctor.windows import Complex
from sigmaswarm.doctor.yaw_fit import YawFit, fit_yaw
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.frozen import frozen_fixes
from sigmaswarm.drives.sensors import white_noise

SEARCHED = 2.3
"""s: an offset this close to the bounds of the fit is not used."""
FEWEST = 20
"""Fixes; with fewer, only checks without motion run."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """A drive and the quantities computed from it.

    Attributes
    ----------
    drive : Drive
        Its IMU turned by ``mounting``, where that is ``mounted``: what follows is about these axes.
    mounting : Mounting or None
        How the IMU sits in the vehicle, of a log with six axes.
    stale, outlying : (n,) bool: fixes that repeat an earlier one; fixes far off the path
    used : (m,) int: indices of the fixes in ``course``
    course : Course or None
    yaw_fit, yaw : the regression of the course on the gyro, and its reading
    acceleration, mount : the regression of the path on the accelerometers, and its reading
    clock : the fixes' delay
    moved : s, taken off the fixes' times, where the clocks are far apart: what follows is about these times
    noise, scatter : m per axis: of the fixes from one to the next, and about the path over ten seconds
    """

    drive: Drive
    stale: Mask
    outlying: Mask
    used: np.ndarray[tuple[int], np.dtype[np.intp]]
    course: Course | None
    yaw_fit: YawFit | None
    yaw: Yaw
    acceleration: AccelerationFit | None
    mount: Mount | None
    clock: ClockOffset
    noise: float
    scatter: float
    mounting: Mounting | None = None
    moved: float = 0.0

    @property
    def follows(self) -> bool:
        """True where the course follows the gyro, or turns too little to show it."""
        fit = self.yaw_fit
        return fit is None or fit.course_change < LEAST_TURN or (self.yaw.known and abs(fit.late) < SEARCHED)

    @property
    def mounted(self) -> bool:
        """True where the IMU is turned against the vehicle, and by how much is known."""
        return self.mounting is not None and self.mounting.needed

    @property
    def drives(self) -> bool:
        """True where the fixes show a course anywhere."""
        return self.course is not None and bool(self.course.moving.any())

    @property
    def span(self) -> tuple[float, float]:
        """From the first to the last IMU sample, s."""
        return float(self.drive.imu.time[0]), float(self.drive.imu.time[-1])


def gather(drive: Drive) -> Evidence:
    """Fit the gyro to the course and the accelerometers to the path, and read the fits.

    Where the gyro does not follow the course, an offset of the clocks of up to 40 s is searched first, and the fixes'
    times are moved by it before axes are read.
    """
    evidence = _gather(drive)
    if evidence.course is None or evidence.follows:
        return evidence
    late = search_offset(drive, evidence.course)
    if late is None:  # without the clock no axis can be read
        unknown = yaw_of(None)
        return replace(evidence, yaw=unknown, mount=None, clock=clock_of(None, unknown, None, None))
    rest = 0.0
    for _ in range(2):  # the fits say the rest
        moved = replace(drive, gps=replace(drive.gps, time=drive.gps.time - late))
        evidence = _gather(moved)
        rest = evidence.clock.late if np.isfinite(evidence.clock.std) else 0.0
        late += rest
    clock = ClockOffset(late, max(evidence.clock.std, 0.05), WIDEST)
    return replace(evidence, clock=clock, moved=late - rest)


def _gather(drive: Drive) -> Evidence:
    gps, imu = drive.gps, drive.imu
    old = frozen_fixes(gps)
    inside = ~old & (gps.time >= imu.time[0]) & (gps.time <= imu.time[-1])
    off = np.zeros(len(gps), dtype=np.bool_)
    off[inside] = jumps(gps.time[inside], (gps.x + 1j * gps.y)[inside])
    used = np.flatnonzero(inside & ~off)
    if len(used) < FEWEST:
        yaw = yaw_of(None)
        blind = clock_of(None, yaw, None, None)
        return Evidence(drive, old, off, used, None, None, yaw, None, None, blind, 0.0, 0.0)
    course = course_of(gps.time[used], (gps.x + 1j * gps.y)[used])
    mounting = mounting_of(drive, course)
    if mounting and mounting.needed:
        imu = turned(imu, mounting.repair)
        drive = replace(drive, imu=imu)
    yaw_fit = fit_yaw(drive, course)
    yaw = yaw_of(yaw_fit)
    acceleration = None
    if course.moving.any():
        rate: Array = yaw.factor * getattr(imu, yaw.column)
        coarse = yaw_fit.late if yaw_fit and yaw.known and yaw_fit.share > 0.5 else 0.0
        acceleration = fit_acceleration(
            drive, course, lambda late: heading_of(imu.time, course, rate, late), coarse + LATENESS
        )
    mount = mount_of(acceleration) if acceleration else None
    noise, scatter = white_noise(course.position), 0.0
    if acceleration:
        noise, scatter = _noise(acceleration)
        off[used[_far_off(acceleration)]] = True
    return Evidence(
        drive,
        old,
        off,
        used,
        course,
        yaw_fit,
        yaw,
        acceleration,
        mount,
        clock_of(yaw_fit, yaw, acceleration, mount),
        noise,
        scatter,
        mounting,
    )


def _noise(acceleration: AccelerationFit) -> tuple[float, float]:
    """m per axis: noise from one fix to the next, and scatter about the IMU's path; both robust."""
    second = np.diff(acceleration.residual, n=2, axis=1)

    def spread(v: Complex) -> float:
        return float(np.median(np.abs(np.concatenate([v.real.ravel(), v.imag.ravel()]))) / 0.6745)

    n = acceleration.rows.shape[1]  # each window's own three unknowns take their share
    return spread(second) / np.sqrt(6.0), spread(acceleration.residual) * np.sqrt(n / (n - 3))


def _far_off(acceleration: AccelerationFit) -> np.ndarray:
    """Numbers, among the used fixes, of those that lie far off the IMU's path in every window."""
    size = np.abs(acceleration.residual)
    off = size > 0.2 + 4 * float(np.quantile(size, 0.9))  # m; of Gaussian noise that is 8.6 deviations
    rows, counts = np.unique(acceleration.rows, return_counts=True)
    far, times = np.unique(acceleration.rows[off], return_counts=True)
    return far[times == counts[np.searchsorted(rows, far)]]
