"""Compute course and speed from the fixes alone, mark jumps of the fixes, and exchange their coordinates."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.windows import Complex
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import white_noise
from sigmaswarm.drives.tables import Mask
from sigmaswarm.geodesy import enu_to_geodetic, geodetic_to_enu

NEIGHBORS = 3  # number of fixes on each side that predict the position of a fix
MAX_ACCELERATION = 8.0  # m/s2, largest acceleration of a car; a larger one is a jump of the fixes
SPAN_LIMITS = (3.0, 6.0)  # s, shortest and longest time over which one velocity is computed
SPEED_STD = 0.5  # m/s, intended standard deviation of the velocity
MIN_SPEED = 3.0  # m/s; at lower speeds the course is noise
STANDS = 0.1  # m/s; a vehicle with a lower usual speed is stationary, even if its receiver is quiet
USUAL_SHARE = 0.5  # fraction of a slow vehicle's usual speed above which accurate fixes determine a course


@dataclass(frozen=True, eq=False)
class Course:
    time: Array  # (n,) s
    position: Complex  # (n,) m, east + i north
    velocity: Complex  # (n,) m/s, east + i north; the mean over about `span`, weighted by a parabola
    std: float  # m/s per axis, standard deviation of the velocity due to white noise of the fixes
    angle: Array  # (n,) rad, the course, unwrapped
    moving: Mask  # (n,), True if the car is fast enough for a course
    slowest: float  # m/s, lowest speed with a course
    span: float  # s, averaging time of the velocity

    @property
    def interval(self) -> float:
        """Median time from one fix to the next, s."""
        return float(np.median(np.diff(self.time)))


def with_exchanged_axes(drive: Drive) -> Drive | None:
    """Exchange x and y of the fixes, or latitude and longitude. Return None if the longitudes cannot be latitudes."""
    gps, x, y = drive.gps, drive.gps.y, drive.gps.x
    if drive.frame == "wgs84" and drive.origin:
        lat, lon, alt = drive.origin
        if abs(lon) > 89:
            return None
        lats, lons, alts = enu_to_geodetic(np.stack([gps.x, gps.y, np.zeros(len(gps))], -1), drive.origin).T
        x, y, _ = geodetic_to_enu(lons, lats, alts, (lon, lat, alt)).T
    return replace(drive, gps=replace(gps, x=x, y=y, std_x=gps.std_y, std_y=gps.std_x))


def with_reversed_east(drive: Drive) -> Drive | None:
    """Reverse x, as a wrong sign of the longitudes does. Return None for fixes recorded in meters."""
    return replace(drive, gps=replace(drive.gps, x=-drive.gps.x)) if drive.frame == "wgs84" else None


def mark_jumps(time: Array, position: Complex) -> Mask:
    """Mark fixes (n,) whose distance from the line through their neighbors is impossible for a car."""
    kept = np.arange(len(time))
    if len(time) < 10:
        return np.zeros(len(time), bool)
    # one jump at a time, the largest among its neighbors, since a jump distorts the lines of its neighbors
    for _ in range(20):
        off = np.abs(_off_line(time[kept], position[kept]))
        reach = 0.5 * MAX_ACCELERATION * (NEIGHBORS * np.gradient(time[kept])) ** 2
        limit = 12 * float(np.median(off)) + reach
        worst = sliding_window_view(np.pad(off, NEIGHBORS), 2 * NEIGHBORS + 1).max(axis=1)
        bad = (off > limit) & (off == worst)
        if not bad.any() or len(kept) - bad.sum() < 10:
            break
        kept = kept[~bad]
    return ~np.isin(np.arange(len(time)), kept)


def _off_line(time: Array, position: Complex) -> Complex:
    """Return the offset (n,), m, of each fix from the straight line through its neighbors, east + i north."""
    n = len(time)
    offsets = np.array([k for k in range(-NEIGHBORS, NEIGHBORS + 1) if k])
    index = np.arange(n)[:, None] + offsets
    weight = ((index >= 0) & (index < n)).astype(np.float64)
    index = index.clip(0, n - 1)
    t, p = time[index] - time[:, None], position[index]
    s0, s1, s2 = weight.sum(1), (weight * t).sum(1), (weight * t**2).sum(1)
    q0, q1 = (weight * p).sum(1), (weight * t * p).sum(1)
    return position - (q0 * s2 - q1 * s1) / np.maximum(s0 * s2 - s1**2, 1e-12)


def course_of(time: Array, position: Complex) -> Course:
    interval, noise = float(np.median(np.diff(time))), white_noise(position)
    # the slope of a line through n fixes over T has the standard deviation noise sqrt(12 / n) / T
    span = float(np.clip((12 * noise**2 * interval / SPEED_STD**2) ** (1 / 3), *SPAN_LIMITS))
    span = max(span, 4.5 * interval)
    first, last = np.searchsorted(time, time - span / 2), np.searchsorted(time, time + span / 2, side="right")
    velocity = np.zeros(len(time), dtype=np.complex128)
    for i in np.flatnonzero(last - first >= 3):
        stretch = slice(first[i], last[i])
        t = time[stretch] - time[stretch].mean()
        velocity[i] = t @ position[stretch] / (t @ t)
    whole = (last - first) >= 0.7 * span / interval  # no velocity in a gap or at the ends
    whole &= (time - span / 2 >= time[0] - interval) & (time + span / 2 <= time[-1] + interval)
    std = float(noise * np.sqrt(12 * interval / span) / span)
    usual = float(np.quantile(np.abs(velocity[whole]), 0.9)) if whole.any() else 0.0
    slowest = max(min(MIN_SPEED, USUAL_SHARE * usual), STANDS, 6 * std)
    moving = whole & (np.abs(velocity) > slowest)
    angle = np.zeros(len(time))
    angle[moving] = np.unwrap(np.angle(velocity[moving]))
    return Course(time, position, velocity, std, angle, moving, slowest, span)
