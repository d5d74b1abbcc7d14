"""Compare measurements with gravity and with the motion of the fixes, for plots."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.fixes import Course, course_of, mark_jumps
from sigmaswarm.doctor.windows import integral, smoothed
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.stale_fixes import stale_fixes
from sigmaswarm.drives.tables import Mask

MIN_FIXES = 8
MIN_SPEED = 1.0  # m/s, lowest speed at which a course is shown
AVERAGING_TIME = 2.0  # s; the specific force is averaged, since vibration would hide gravity
RATE = 10.0  # Hz, rate of the averaged specific force
# rad/s, largest bias that is removed; the plot shows a larger one as a fault of gz
MAX_BIAS = np.radians(5.0)
# Findings that the plot of each agreement shows, by the beginnings of their codes
FINDINGS = {
    "timing": (
        *("imu-gap", "imu-rate", "imu-repeats", "imu-outside", "gps-gap", "gps-rate", "gps-outside"),
        *("clock-jump", "logger", "time"),
    ),
    "turning": ("gyro", "clock", "unseen-clock", "unseen-yaw", "reverse", "mirrored"),
    "gravity": ("gravity", "mounting", "accelerometer-up", "accelerometer-unit", "gyro-tilt"),
    "forward": ("accelerometer", "unseen-ax"),
    "sideways": ("unseen-ay", "unseen-tilt"),
    "speed": ("speed", "velocity", "odometer"),
    "course": ("course",),
}


@dataclass(frozen=True, eq=False)
class Agreement:
    """Measured quantities over time, and their expected values, for one plot.

    Attributes
    ----------
    key : str
        "timing", "turning", "gravity", "forward", "sideways", "speed" or "course".
    title, unit : str
    measured, expected : mapping of label to (time (n,) s, values (n,) in ``unit``)
    """

    key: str
    title: str
    unit: str
    measured: dict[str, tuple[Array, Array]]
    expected: dict[str, tuple[Array, Array]]


def shown_by(code: str) -> str:
    """Return the key of the `Agreement` that shows findings with this code; "" if the map of the fixes shows them."""
    return next((key for key, starts in FINDINGS.items() if code.startswith(starts)), "")


def agreements(drive: Drive) -> tuple[Agreement, ...]:
    """Compare the IMU, the odometer and the receiver's velocity with gravity and the motion of the fixes.

    Parameters
    ----------
    drive : Drive
        The drive; its truth is not used.

    Returns
    -------
    tuple of Agreement
        If the fixes have no course, agreements that require a moving vehicle are missing.
    """
    times = {"IMU": drive.imu.time, "fixes": drive.gps.time}
    steps = {name: (time[1:], np.diff(time)) for name, time in times.items()}
    timing = Agreement("timing", "Time from one sample to the next", "s", steps, {})
    return (_gravity(drive), *_of_motion(drive), timing)


def _gravity(drive: Drive) -> Agreement:
    imu, ends = drive.imu, drive.imu.time[[0, -1]]
    at = np.arange(ends[0], ends[1], 1 / RATE)
    names = [name for name in imu.axes if name[0] == "a"]
    measured = {name: (at, smoothed(imu.time, getattr(imu, name), at, AVERAGING_TIME)) for name in names}
    expected = {"ax, ay at rest: 0": (ends, np.zeros(2))}
    expected |= {"az at rest: 9.81": (ends, np.full(2, GRAVITY))} if "az" in names else {}
    return Agreement("gravity", "Gravity: means of the specific force over 2 s", "m/s²", measured, expected)


def _of_motion(drive: Drive) -> Iterator[Agreement]:
    imu, gps = drive.imu, drive.gps
    used = ~stale_fixes(gps) & (gps.time >= imu.time[0]) & (gps.time <= imu.time[-1])
    time, position = gps.time[used], gps.x[used] + 1j * gps.y[used]
    if len(time) < MIN_FIXES or not (np.diff(time) > 0).all():
        return
    good = ~mark_jumps(time, position)
    course = course_of(time[good], position[good])
    at, speed = course.time, np.abs(course.velocity)
    moving = speed > max(MIN_SPEED, 6 * course.std)
    # the velocity is unknown at the ends
    moving &= (at > at[0] + course.span / 2) & (at < at[-1] - course.span / 2)
    if np.count_nonzero(moving) < MIN_FIXES:
        return
    yield _turning(drive, course, moving)
    ax, ay, gz = (smoothed(imu.time, values, at, course.span) for values in (imu.ax, imu.ay, imu.gz))
    gain, sideways = ((at[moving], values[moving]) for values in (np.gradient(speed, at), speed * gz))
    title = "Longitudinal: ax compared with the change of speed"
    measured = {"ax": (at[moving], ax[moving])}
    yield Agreement("forward", title, "m/s²", measured, {"change of speed": gain})
    title, measured = "Lateral: ay compared with speed times yaw rate", {"ay": (at[moving], ay[moving])}
    yield Agreement("sideways", title, "m/s²", measured, {"speed x gz": sideways})
    own = {"receiver": (gps.time, gps.speed)} if gps.speed is not None else {}
    own |= {"odometer": (drive.odometer.time, drive.odometer.speed)} if drive.odometer else {}
    if own:
        yield Agreement("speed", "Speed", "m/s", own, {"fixes": (at, speed)})
    if gps.course is not None:
        stated = gps.time, np.degrees(gps.course)
        track = at[moving], np.degrees(np.angle(course.velocity[moving]))
        yield Agreement("course", "Course", "deg", {"receiver": stated}, {"fixes": track})


def _turning(drive: Drive, course: Course, moving: Mask) -> Agreement:
    """Compare the integral of gz, without its bias, with the course.

    Each part of the course between stops is shifted so that its mean equals that of the integral.
    """
    imu, at = drive.imu, course.time[moving]
    track = np.unwrap(np.angle(course.velocity[moving]))
    turned = np.interp(at, imu.time, integral(imu.time, imu.gz))
    piece = np.cumsum(np.append(0, np.diff(np.flatnonzero(moving)) > 1))
    pieces = (piece[:, np.newaxis] == np.arange(piece[-1] + 1)).astype(np.float64)
    slope = np.linalg.lstsq(np.column_stack([at - at[0], pieces]), track - turned, rcond=None)[0][0]
    turned += (at - at[0]) * np.clip(slope, -MAX_BIAS, MAX_BIAS)
    shifts = np.bincount(piece, track - turned) / np.bincount(piece)
    ends = np.flatnonzero(np.diff(piece)) + 1
    placed = np.insert(np.degrees(track - shifts[piece]), ends, np.nan)
    measured, expected = (at, np.degrees(turned)), (np.insert(at, ends, at[ends]), placed)
    title = "Turning: the integral of gz compared with the course"
    return Agreement("turning", title, "deg", {"gz": measured}, {"course": expected})
