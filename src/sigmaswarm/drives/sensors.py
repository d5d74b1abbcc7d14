"""Determine the properties of logs on which the default filter depends, and compare vehicles and sensors of logs."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.drives.mounting import NO_ROTATION, Angles, axes_of
from sigmaswarm.geodesy import STANDARD_GRAVITY, rotation_of

# Ratio of the 95% to the 5% quantile of stated standard deviations above which the standard deviations are informative
MIN_STD_RATIO = 1.5
MIN_START_DISTANCE = 20.0  # m; a car that is farther from the first fix has moved
GRAVITY_TOLERANCE = 0.3  # largest deviation of the median of az from gravity, relative to gravity

MIN_WHITE_SHARE = 0.4
"""Smallest ratio of white noise to the stated or assumed standard deviation at which fix errors count as white.

The ratio is 1 in the data sets KITTI and colorado, 0.25 with a u-blox M8, and at most 0.02 with car receivers, which
smooth their fixes (data sets kingston-1, comma2k19, dresden).
"""
UNSTATED_GPS_STD = 2.1  # m per axis, assumed if a receiver states no accuracy: u-blox M8, 2.5 m CEP
MIN_WHITE_NOISE = 0.25 * UNSTATED_GPS_STD
"""Smallest white noise (standard deviation, m per axis) that counts as the error of fixes without stated accuracy.

If the fixes have less white noise, their error is unknown, since the receiver may smooth the fixes.
"""
FIXES_FOR_FIX_ERROR = 250
"""Smallest number of fixes, over all drives, at which `tune` uses fix-error by default.

On six of eight simulated drives of 142 s with a u-blox M8 at 1 Hz, fix-error increased the drift in outages of 30 s, in
one case to 1319 m. With 300 and 600 fixes, fix-error did not change the mean drift, and reduced the position error by 3
to 6%.
"""

LASTING_ERRORS = (
    "the scatter from fix to fix is well below the receiver's standard deviation, so the fix errors are probably "
    "correlated"
)
"""Reason for the option fix-error (see `has_lasting_errors`)."""

MAX_RATE_RATIO = 1.5  # largest ratio of the sampling rates of two drives with the same sensors
MAX_ANGLE = 10.0  # deg, largest angle between the mountings of two drives with the same mounting


@dataclass(frozen=True)
class LogProperties:
    """The properties of a drive that determine the choice of a filter and an objective."""

    name: str
    truth: bool
    interval: float  # s, median time between two IMU samples
    axes: tuple[str, ...]  # of the IMU
    attitude: bool  # `has_attitude`
    odometer: bool  # True if the drive has wheel speeds
    accuracy: bool  # True if the fixes have stated standard deviations
    velocity: bool  # True if the fixes have speeds and courses
    std_quantiles: tuple[float, float] | None  # `stated_std_quantiles`
    white: bool  # `has_white_errors`
    driven: float  # s from the first fix that is more than 20 m from the start to the last fix; 0 if there is none
    receiver_std: tuple[float, float]  # `receiver_std`
    heading: bool = False  # True if the fixes have headings
    lasting: bool = False  # `has_lasting_errors`
    fixes: int = 0  # number of fixes within the IMU's time span
    fix_interval: float = np.nan  # s, median time between two fixes
    noise: float = np.nan  # m per axis, white noise of the fixes
    # m per axis, standard deviation of the fixes' errors, NaN without truth; used only with objectives that use truth
    true_std: float = np.nan
    assumed_std: bool = False  # `assumes_std`
    mounting: Angles | None = None  # deg, mounting of the IMU; None if the drive states none


def log_properties(drive: Drive | LogProperties) -> LogProperties:
    if isinstance(drive, LogProperties):
        return drive
    gps, imu = drive.gps, drive.imu
    away = gps.time[np.hypot(gps.x - gps.x[:1], gps.y - gps.y[:1]) > MIN_START_DISTANCE]
    return LogProperties(
        name=drive.name,
        truth=bool(drive.truth),
        interval=drive.nominal_interval,
        axes=imu.axes,
        attitude=has_attitude(drive),
        odometer=drive.odometer is not None,
        accuracy=gps.std is not None,
        velocity=gps.velocity is not None,
        std_quantiles=stated_std_quantiles(drive),
        white=has_white_errors(drive),
        driven=float(gps.time[-1] - away[0]) if len(away) else 0.0,
        receiver_std=receiver_std(drive),
        heading=gps.heading is not None,
        lasting=has_lasting_errors(drive),
        fixes=int(np.sum((gps.time >= imu.time[0]) & (gps.time <= imu.time[-1]))),
        fix_interval=gps.interval,
        noise=white_noise(gps.position),
        true_std=true_std(drive),
        assumed_std=assumes_std(drive),
        # An imported drive states its axes, but not a rotation of zero.
        mounting=drive.mounting or (NO_ROTATION if axes_of(drive.metadata) else None),
    )


def has_attitude(drive: Drive) -> bool:
    """Return True if roll and pitch are observable: az, gx and gy exist, az shows gravity, and gx and gy vary."""
    az, gx, gy = drive.imu.az, drive.imu.gx, drive.imu.gy
    if az is None or gx is None or gy is None:
        return False
    upright = abs(float(np.median(az)) / STANDARD_GRAVITY - 1.0) < GRAVITY_TOLERANCE
    return upright and bool(np.ptp(gx) > 0) and bool(np.ptp(gy) > 0)


def stated_std_quantiles(drive: Drive) -> tuple[float, float] | None:
    """Return the 5% and 95% quantiles of the stated standard deviations, m; None if missing or nearly equal."""
    if (std := drive.gps.std) is None:
        return None
    low, high = np.quantile(std, [0.05, 0.95])
    return (float(low), float(high)) if high > MIN_STD_RATIO * low else None


def stated_std(drive: Drive) -> tuple[float, float] | None:
    """Return the standard deviation, m east and north, that the receiver states, or None.

    The result is the median over the fixes, or ``gps_std_m`` of drive.toml if the fixes have no standard deviations.
    """
    if (std := drive.gps.std) is not None:
        return float(np.median(std[0])), float(np.median(std[1]))
    stated = drive.metadata.get("gps_std_m")
    return None if stated is None else (float(stated), float(stated))


def receiver_std(drive: Drive) -> tuple[float, float]:
    """Return the standard deviation of the fixes of a drive's receiver, m east and north.

    If the receiver states no standard deviation, the result is that of the white noise of the fixes or, if this
    noise is small or hidden by motion, `UNSTATED_GPS_STD`.
    """
    if stated := stated_std(drive):
        return stated
    std = _visible_noise(drive) or UNSTATED_GPS_STD
    return std, std


def assumes_std(drive: Drive) -> bool:
    """Return True if neither the receiver nor the white noise of its fixes shows their standard deviation."""
    return stated_std(drive) is None and _visible_noise(drive) is None


def _visible_noise(drive: Drive) -> float | None:
    """Return the white noise of the fixes, m per axis; None if it is small or hidden by motion."""
    gps = drive.gps
    shown, moved = white_noise(gps.position), motion_in_noise(gps.interval)
    return shown if shown > max(MIN_WHITE_NOISE, 3 * moved) else None


def white_noise(position: NDArray[np.complexfloating[Any, Any]]) -> float:
    """Estimate the standard deviation of white noise in the fixes, m per axis; 0 for fewer than four fixes.

    The fixes (n,), east + i north (m), must be evenly spaced. The estimate is robust, and uses third differences, which
    remove the motion and correlated errors.
    """
    third = np.diff(position, n=3)
    return robust_std(third) / float(np.sqrt(20.0)) if len(third) else 0.0


def robust_std(off: NDArray[np.complexfloating[Any, Any]]) -> float:
    """Return a robust standard deviation of the real and imaginary parts about zero."""
    return float(np.median(np.abs(np.concatenate([off.real.ravel(), off.imag.ravel()]))) / 0.6745)


def antenna_track(drive: Drive, truth: Truth) -> tuple[Array, NDArray[np.complex128]]:
    """Return the times, s, and the positions of the antenna, x + iy in m, according to the truth.

    If the antenna is not at the IMU, times at which the truth has no heading are omitted.
    """
    track = truth.x + 1j * truth.y
    if drive.lever_arm.any():
        track = track + complex(*drive.lever_arm) * np.exp(1j * truth.theta)
    known = np.isfinite(track)
    return truth.time[known], track[known]


def true_std(drive: Drive) -> float:
    """Return a robust standard deviation of the fixes from the truth, m per axis; NaN without truth at their times."""
    gps = drive.gps
    if (truth := drive.truth) is None:
        return float("nan")
    time, track = antenna_track(drive, truth)
    if not len(time):
        return float("nan")
    gps = gps.select((gps.time >= time[0]) & (gps.time <= time[-1]))
    off = gps.x - np.interp(gps.time, time, track.real), gps.y - np.interp(gps.time, time, track.imag)
    return robust_std(off[0] + 1j * off[1]) if len(gps) else float("nan")


def true_gyro_bias(drive: Drive) -> float:
    """Return the mean bias of gz relative to the heading of the truth, rad/s; NaN if one of them is unknown.

    The scale error of the gyro is also fitted. Otherwise, it would appear as a bias if a drive turns mostly to one
    side.
    """
    imu, truth = drive.imu, drive.truth
    if truth is None:
        return float("nan")
    inside = (truth.time >= imu.time[0]) & (truth.time <= imu.time[-1]) & np.isfinite(truth.theta)
    time = truth.time[inside]
    if len(time) < 3 or not np.isfinite(imu.gz).all():
        return float("nan")
    steps = np.diff(imu.time) * (imu.gz[1:] + imu.gz[:-1]) / 2
    turned = np.interp(time, imu.time, np.append(0.0, np.cumsum(steps)))
    heading = turned - np.unwrap(turned - truth.theta[inside])  # the vehicle may turn in gaps of the truth
    columns = np.column_stack([time - time[0], heading - heading[0], np.ones(len(time))])
    return float(np.linalg.lstsq(columns, turned - heading, rcond=None)[0][0])


def has_white_errors(drive: Drive) -> bool:
    """Return True if a large part of the errors of the fixes is white noise (see `MIN_WHITE_SHARE`).

    If errors are correlated, or the receiver smooths the fixes, the white noise is far smaller than the errors.
    """
    gps = drive.gps
    off, shown = max(stated_std(drive) or (UNSTATED_GPS_STD,)), white_noise(gps.position)
    return shown > MIN_WHITE_SHARE * off and shown > 3 * motion_in_noise(gps.interval)


def has_lasting_errors(drive: Drive) -> bool:
    """Return True if white errors of size `receiver_std` would be visible from fix to fix, but are not visible.

    Such errors are correlated, or smaller than the receiver states. The result is False if motion between fixes would
    hide white errors, as with RTK. A repeated fix counts once.
    """
    position, least = drive.gps.position, MIN_WHITE_SHARE * max(receiver_std(drive))
    new = np.append(True, np.diff(position) != 0)
    if np.count_nonzero(new) < 4:
        return False
    moved = motion_in_noise(float(np.median(np.diff(drive.gps.time[new]))))
    return white_noise(position[new]) <= least and least > 3 * moved


def enough_for_fix_error(drives: Iterable[LogProperties]) -> bool:
    return sum(drive.fixes for drive in drives) >= FIXES_FOR_FIX_ERROR


def motion_in_noise(interval: float) -> float:
    """Return the contribution of city driving to `white_noise` (m) for fixes ``interval`` s apart."""
    return 0.02 + 0.15 * interval**2


def describe_vehicles(logs: Sequence[LogProperties]) -> str:
    """Return a warning if drives are clearly from different vehicles or sensors, otherwise ""."""
    found = "; ".join(differences(logs))
    return found and (
        f"the training drives seem to be from different vehicles or sensors: {found}. A tuned filter suits one "
        "vehicle and its sensors; tune a filter for each vehicle"
    )


def differences(logs: Sequence[LogProperties]) -> Iterator[str]:
    """Yield a clause for each property that clearly differs between the drives."""
    for sensor, interval in (("IMU", attrgetter("interval")), ("receiver", attrgetter("fix_interval"))):
        fast, slow = min(logs, key=interval), max(logs, key=interval)
        high, low = 1 / interval(fast), 1 / interval(slow)
        if high > MAX_RATE_RATIO * low:
            yield f"the rate of the {sensor} is {high:.3g} Hz in {fast.name} but {low:.3g} Hz in {slow.name}"
    pairs = [*combinations((log for log in logs if log.mounting), 2)]
    for one, other in sorted(pairs, key=lambda pair: -_angle(*pair))[:1]:
        if (angle := _angle(one, other)) > MAX_ANGLE:
            yield f"the mountings of the IMU in {one.name} and {other.name} differ by {angle:.0f} deg"


def _angle(one: LogProperties, other: LogProperties) -> float:
    """Return the angle between two mountings, deg."""
    first, second = (rotation_of(*(log.mounting or NO_ROTATION)) for log in (one, other))
    return float(np.degrees(np.arccos(np.clip((np.trace(first.T @ second) - 1) / 2, -1.0, 1.0))))
