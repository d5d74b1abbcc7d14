"""Check the plausibility of a drive: amount of data, times, gaps, units and axes.

The doctor checks for most of these faults in more detail, and uses some of these messages.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Gps, Imu, Truth
from sigmaswarm.errors import DriveError, DriveWarning, SigmaswarmWarning
from sigmaswarm.geodesy import STANDARD_GRAVITY, wrap_angle

MIN_SAMPLES = 100  # smallest number of IMU samples
MIN_SHARED_FIXES = 10  # smallest number of fixes within the IMU's time span
IMU_GAP = (10.0, 0.1)  # limits of a gap of the IMU, in usual intervals and in s; a gap exceeds both
GPS_GAP = (5.0, 2.0)  # limits of a gap of fixes or truth, in usual intervals and in s; a gap exceeds both
MIN_UNSHARED_TIME = 10.0  # s; a longer time without the other sensor at the start or end is reported
# Time without fixes at the start or end of the IMU's time span, as a fraction of the span, above which it is reported.
# Many logs begin before the first fix.
MIN_UNSHARED_SHARE = 0.1
GRAVITY = STANDARD_GRAVITY
IMPOSSIBLE_RATE = 3.0  # rad/s; no car makes half a turn in a second
TIME_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}  # units per second
_MAX_INTERVALS = (2.0, 60.0)  # s between samples and between fixes; longer intervals suggest another unit
# s between samples and between fixes; in the right unit, intervals are not longer
_USUAL_INTERVALS = (0.5, 20.0)
_JUMP = 3600.0  # s; a longer interval is due to a corrupt time stamp or to a clock that was set
_WINDOW = 5.0  # s, window for speed and course: long enough for noise of meters, short enough for turns


@dataclass(frozen=True)
class Remark:
    """A probable fault. ``code`` is a code of the doctor (docs/doctor.md)."""

    code: str
    file: str
    columns: str
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.file}: {self.what}; {self.remedy}"


@dataclass(frozen=True)
class GapSummary:
    """Number of gaps, start and length of the longest gap (s), and usual interval (s)."""

    count: int
    start: float
    length: float
    usual: float


def check_tables(
    imu: Imu, gps: Gps, truth: Truth | None, placed: Callable[[str], str]
) -> list[SigmaswarmWarning]:
    """Raise `DriveError` if a drive has too few data. Return warnings of other faults.

    ``placed`` adds the folder to a message that begins with the name of a file.
    """
    if shortage := shortage_of(imu, gps):
        raise DriveError(placed(shortage))
    return [DriveWarning(placed(str(remark)), remark.code) for remark in remarks_of(imu, gps, truth)]


def shortage_of(imu: Imu, gps: Gps) -> str | None:
    """Return a sentence if a drive has too few data, otherwise None."""
    first, last = imu.time[[0, -1]]
    if first > gps.time[-1] or gps.time[0] > last:
        return (
            f"imu.csv: column t covers {first:.1f} to {last:.1f} s, but gps.csv covers {gps.time[0]:.1f} to "
            f"{gps.time[-1]:.1f} s, so they do not overlap; convert both to one clock"
        )
    if len(imu) < MIN_SAMPLES:
        return f"imu.csv: {len(imu)} samples are too few; record at least {MIN_SAMPLES}"
    shared = int(np.count_nonzero((gps.time >= first) & (gps.time <= last)))
    if shared < MIN_SHARED_FIXES:
        return (
            f"gps.csv: {shared} fixes within the IMU's time span, t = {first:g} to {last:g} s, are too few; "
            f"record at least {MIN_SHARED_FIXES}"
        )
    return None


@np.errstate(all="ignore")  # values may overflow, which the doctor reports
def remarks_of(imu: Imu, gps: Gps, truth: Truth | None) -> list[Remark]:
    if spoiled := invalid_times(imu, gps):
        return spoiled
    gravity = gravity_on(imu) or gravity_up(imu)
    single = [remark for remark in (unshared_times(imu.time, gps.time), gravity) if remark]
    return [*_gaps(imu, gps, truth), *_angular_rate(imu, gps), *single, *_acceleration(imu, gps)]


def invalid_times(imu: Imu, gps: Gps) -> list[Remark]:
    """List faults of the times that make other checks meaningless: a wrong unit, or a clock that jumps."""
    if wrong := _time_unit(imu.time, gps.time):
        return [wrong]
    remedy = "delete the rows with wrong times; if the logger paused, make one drive from each part"
    remarks: list[Remark] = []
    for file, gaps in ("imu.csv", gaps_in(imu.time, IMU_GAP)), ("gps.csv", gaps_in(gps.time, GPS_GAP)):
        if gaps and gaps.length > _JUMP:
            what = f"column t jumps by {gaps.length:.4g} s after t = {gaps.start:.2f} s"
            remarks.append(Remark("time-jump", file, "t", what, remedy))
    return remarks


def _time_unit(imu: Array, gps: Array) -> Remark | None:
    """Check for times in ms, us or ns: in one file by the ratio of the time spans, in both files by the intervals."""
    spans = float(np.ptp(imu)), float(np.ptp(gps))
    if min(spans) <= 0:
        return None
    usual = np.median(np.diff(imu)), np.median(np.diff(gps))
    powers = float(np.log10(spans[0] / spans[1]))
    unit = next((u for u, f in TIME_UNITS.items() if abs(abs(powers) - np.log10(f)) <= 0.2), None)
    if unit:
        file = "imu.csv" if powers > 0 else "gps.csv"
        both = f"the IMU's samples cover {spans[0]:.4g} s and the fixes {spans[1]:.4g} s"
        what = f"{both}, as if t were in {unit}"
    elif usual[0] > _MAX_INTERVALS[0] or usual[1] > _MAX_INTERVALS[1]:
        fits = (
            u
            for u, f in TIME_UNITS.items()
            if usual[0] <= _USUAL_INTERVALS[0] * f and usual[1] <= _USUAL_INTERVALS[1] * f
        )
        unit, file = next(fits, None), "imu.csv, gps.csv"
        every = f"the IMU's samples are {usual[0]:.6g} s apart and the fixes {usual[1]:.6g} s"
        what = f"{every}, as if t were in {unit} in both files"
    else:
        return None
    if not unit:
        return None
    power = f"{TIME_UNITS[unit]:.0e}".replace("+0", "")
    remedy = f"divide t of {file.replace(', ', ' and ')} by {power}; in an import use --time or --map, for example "
    return Remark("time-unit", file, "t", what, f"{remedy}t=stamp*1e-{power[2:]}")


def gravity_on(imu: Imu) -> Remark | None:
    median = {"ax": float(np.median(imu.ax)), "ay": float(np.median(imu.ay))}
    axis = max(median, key=lambda name: abs(median[name]))
    if abs(median[axis]) <= 0.7 * GRAVITY:
        return None
    what = f"column {axis} has a median of {median[axis]:.2f} m/s2"
    if abs(median[axis]) > 2 * GRAVITY:
        what += ", which exceeds gravity"
        return Remark("gravity-axis", "imu.csv", axis, what, "check the unit of ax, ay, az")
    what += ", which is gravity and must be in az"
    remedy = "import with --mount auto (six axes), or exchange columns"
    remedy = f"rotate the axes to x forward, y left, z up: {remedy}"
    return Remark("gravity-axis", "imu.csv", axis, what, remedy)


def gravity_up(imu: Imu, unit: float = 1.0) -> Remark | None:
    """Check whether the median of az differs from +9.8 m/s2. ``unit`` is m/s2 per unit of az, if known."""
    if imu.az is None:
        return None
    az, columns = unit * float(np.median(imu.az)), "az"
    code, what = "accelerometer-up", f"column az has a median of {az:.2f} m/s2, but +9.8 is expected"
    if 0.8 < abs(az) < 1.2:
        code, columns = "accelerometer-unit", "ax, ay, az"
        what, remedy = (
            f"column az has a median of {az:.2f}, as if az were in g",
            f"multiply ax, ay, az by {GRAVITY}",
        )
    elif az < -0.7 * GRAVITY:
        what = f"column az has a median of {az:.2f} m/s2, but the specific force at rest is +9.8 m/s2 if z points up"
        remedy = "rotate the axes, or change the signs of ax, ay, az if the sensor reports the negated specific force"
    elif abs(az) < 0.2 * GRAVITY:
        remedy = "check its unit and axis, or omit the column if gravity was already subtracted"
    elif abs(az - GRAVITY) > 0.2 * GRAVITY:
        remedy = "check its unit and axis"
    else:
        return None
    return Remark(code, "imu.csv", columns, what, remedy)


def gaps_in(time: Array, limit: tuple[float, float], imu: Array | None = None) -> GapSummary | None:
    """Find the gaps of ``time`` (n,) in s with a limit such as `IMU_GAP`. Return None if there are none.

    If the IMU's times ``imu`` (s) are given, a gap that mostly coincides with a gap of the IMU is not counted, since
    the logger paused.
    """
    interval = np.diff(time)
    usual = float(np.median(interval)) if interval.size else 0.0
    gap = interval > max(limit[0] * usual, limit[1])
    if imu is not None and gap.any():
        paused = np.diff(imu)
        missing = np.where(paused > max(IMU_GAP[0] * float(np.median(paused)), IMU_GAP[1]), paused, 0.0)
        passed = np.interp(time, imu, np.append(0.0, np.cumsum(missing)))  # s of gaps until each time
        gap &= np.diff(passed) < interval / 2
    if not gap.any():
        return None
    i = int(np.argmax(np.where(gap, interval, 0.0)))
    return GapSummary(int(np.count_nonzero(gap)), float(time[i]), float(interval[i]), usual)


def _gaps(imu: Imu, gps: Gps, truth: Truth | None) -> Iterator[Remark]:
    crossed = (
        "in a gap a filter uses the mean of the samples before and after the gap, and increases the covariance of the "
        "state; if the car maneuvered during the gap, split the drive"
    )
    alone = "during this time a filter uses only the IMU; no action is needed if this is intended"
    unscored = "during this time errors are not measured; no action is needed if this is intended"
    sensors = [("imu", imu, IMU_GAP, crossed), ("gps", gps, GPS_GAP, alone)]
    sensors += [("truth", truth, GPS_GAP, unscored)] if truth is not None else []
    gaps_by_table: list[tuple[str, str, str]] = []
    for name, table, limit, remedy in sensors:
        if g := gaps_in(table.time, limit, imu.time if name == "gps" else None):
            many = f"there are {g.count} gaps; the longest lasts" if g.count > 1 else "there is a gap of"
            what = f"{many} {g.length:.2f} s after t = {g.start:.2f} s (usual interval {g.usual:.3f} s)"
            gaps_by_table.append((name, what, remedy))
    if gaps_by_table:
        name, what, remedy = gaps_by_table[0]
        others = "".join(f"; {other}.csv: {gaps}" for other, gaps, _ in gaps_by_table[1:])
        yield Remark(f"{name}-gap", f"{name}.csv", "t", what + others, remedy)


def outside_of(imu: Array, gps: Array) -> NDArray[np.bool_]:
    """Mark fixes before or after the IMU samples, which no filter uses. ``imu`` and ``gps`` are times, s."""
    return (gps < imu[0]) | (gps > imu[-1])


def unshared_times(imu: Array, gps: Array) -> Remark | None:
    """Describe fixes outside of the IMU's time span, and long parts of this span before and after all fixes."""
    early, late = imu[0] - gps[0], gps[-1] - imu[-1]
    alone = ""
    if max(-early, -late) > max(MIN_UNSHARED_TIME, MIN_UNSHARED_SHARE * (imu[-1] - imu[0])):
        ends = [(-early, "first"), (-late, "last")]
        parts = [f"{which} {length:.0f} s" for length, which in ends if length > MIN_UNSHARED_TIME]
        alone = f"there are no fixes during the IMU's {' and '.join(parts)}"
    if max(early, late) > MIN_UNSHARED_TIME:
        count = np.count_nonzero(outside_of(imu, gps))
        ends = [(early, "before its first sample"), (late, "after its last sample")]
        up_to = " and ".join(f"up to {length:.0f} s {where}" for length, where in ends if length >= 0.5)
        what = f"{count} of {len(gps)} fixes lie outside of the IMU's time span, {up_to}, and are not used"
        remedy = "no action is needed if the receiver recorded longer than the IMU; otherwise convert both to one clock"
        return Remark("gps-outside", "gps.csv", "t", f"{what}; {alone}" if alone else what, remedy)
    if not alone:
        return None
    remedy = (
        "a filter starts after the first fixes, and uses the IMU alone after the last fix; no action is needed "
        "if this is intended"
    )
    return Remark("imu-outside", "imu.csv", "t", alone, remedy)


def _seen_by_fixes(imu: Imu, gps: Gps, body_rate: Array) -> tuple[NDArray[np.complex128], Array, Array]:
    """Return the mean velocity of the fixes in each window, and the changes from window to window.

    The first array is the velocity (k,), m/s east + i north. The other arrays (k - 1,) are the integral of
    ``body_rate`` and the change of course, rad, between the middles of consecutive windows. Windows without fixes are
    left out.
    """
    start, end = max(imu.time[0], gps.time[0]), min(imu.time[-1], gps.time[-1])
    window = np.unique(np.floor((gps.time[(gps.time >= start) & (gps.time <= end)] - start) / _WINDOW))
    first = start + _WINDOW * window
    first = first[first + _WINDOW < end]
    at = np.stack([first, first + _WINDOW])
    position = np.interp(at, gps.time, gps.x) + 1j * np.interp(at, gps.time, gps.y)
    velocity = (position[1] - position[0]) / _WINDOW
    total = np.append(0.0, np.cumsum(body_rate[1:] * np.diff(imu.time)))
    integral = np.diff(np.interp(first + _WINDOW / 2, imu.time, total))
    return velocity, integral, wrap_angle(np.diff(np.angle(velocity)))


def impossible_rate(gz: Array) -> bool:
    return bool(np.quantile(np.abs(gz), 0.99) > IMPOSSIBLE_RATE)


def _angular_rate(imu: Imu, gps: Gps) -> Iterator[Remark]:
    """Check for gz in deg/s, whose integral is 57 times the change of course."""
    velocity, turned, turn = _seen_by_fixes(imu, gps, imu.gz)
    moving = np.abs(velocity) > 4.0  # m/s; at lower speeds, noise of the fixes dominates the course
    both = moving[1:] & moving[:-1]
    if np.count_nonzero(both) >= 4:
        # Standard deviations do not depend on the gyro's bias; at least 0.02 rad, since straight roads have no turns.
        degrees = np.std(turned[both]) > 5 * max(float(np.std(turn[both])), 0.02)
    else:
        degrees = impossible_rate(imu.gz)
    if degrees:
        what = "the integral of column gz exceeds the changes of course, as if gz were in deg/s"
        yield Remark("gyro-unit", "imu.csv", "gz", what, "multiply gx, gy, gz by pi/180")


def _acceleration(imu: Imu, gps: Gps) -> Iterator[Remark]:
    """If there is no az, check for ax in g: its integral is then about a tenth of the changes of speed."""
    if imu.az is not None:
        return
    velocity, gained, _ = _seen_by_fixes(imu, gps, imu.ax)
    change = np.abs(np.diff(np.abs(velocity)))
    strong = change > 2.0  # m/s, above the fixes' noise
    if np.count_nonzero(strong) >= 3 and np.abs(gained[strong]).sum() < 0.3 * change[strong].sum():
        what = "the integral of column ax is too small for the changes of speed, as if ax were in g"
        yield Remark("accelerometer-unit", "imu.csv", "ax, ay", what, f"multiply ax, ay by {GRAVITY}")
