"""What makes a drive unusable as a whole, and what only looks wrong: gaps, units, axes."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive, Imu
from sigmaswarm.geodesy import wrap_angle

FEWEST_SAMPLES = 100
"""IMU samples that a drive has at least."""
FEWEST_FIXES = 10
"""Fixes that fall within the IMU's time at least."""

IMU_GAP = (10.0, 0.1)
"""An interval is a gap where it exceeds both this many usual intervals and this many s."""
GPS_GAP = (5.0, 2.0)
"""The same for fixes, and for truth."""

GRAVITY = 9.80665
"""m/s2, standard."""

_WINDOW = 5.0
"""s over which fixes give speed and course: long enough for metres of noise, short enough for turns."""

_SPARSEST = 1000.0
"""Windows a fix: more of them mean times that are in no seconds, or a corrupt one, and nothing can be seen."""


def shortage_of(drive: Drive) -> str | None:
    """What a drive lacks to be of use, as a sentence: time that IMU and GPS share, or samples of either."""
    imu, gps = drive.imu.time, drive.gps.time
    shared = int(np.count_nonzero((gps >= imu[0]) & (gps <= imu[-1])))
    if imu[0] > gps[-1] or gps[0] > imu[-1]:
        return (
            f"imu.csv: column t covers {imu[0]:g} to {imu[-1]:g} s, gps.csv {gps[0]:g} to {gps[-1]:g} s: "
            "they do not overlap; put both on one clock"
        )
    if len(imu) < FEWEST_SAMPLES:
        return f"imu.csv: {len(imu)} samples are too few; record at least {FEWEST_SAMPLES}"
    if shared < FEWEST_FIXES:
        return (
            f"gps.csv: {shared} fixes within the IMU's time, t = {imu[0]:g} to {imu[-1]:g} s, are too few; "
            f"record at least {FEWEST_FIXES}"
        )
    return None


@np.errstate(all="ignore")  # values at the ends of the number range are the doctor's to tell
def warnings_of(drive: Drive) -> list[str]:
    """What looks wrong about a drive, each as a sentence that names the file and the remedy.

    Gaps, angular rates in deg/s, accelerations in g, and gravity on the wrong axis. Nothing here stops work,
    so each check stays silent in doubt.
    """
    return [*_gaps(drive), *_angular_rate(drive), *_gravity(drive.imu), *_acceleration(drive)]


def _gaps(drive: Drive) -> Iterator[str]:
    """One sentence on the gaps of all files; the remedy is for the sensor whose gaps matter most."""
    crossed = (
        "a filter crosses a gap in one step of its true length, driven by the sample at its end, with Q "
        "scaled by length / usual interval; if the vehicle maneuvered there, split the drive"
    )
    alone = "a filter runs on the IMU alone there; nothing to do if so meant"
    found = [
        (_gaps_in("imu.csv", drive.imu.time, IMU_GAP), crossed),
        (_gaps_in("gps.csv", drive.gps.time, GPS_GAP), alone),
    ]
    if drive.truth is not None:
        unscored = "nothing is scored there; nothing to do if so meant"
        found.append((_gaps_in("truth.csv", drive.truth.time, GPS_GAP), unscored))
    told = [(gaps, remedy) for gaps, remedy in found if gaps]
    if told:
        yield f"{'; '.join(gaps for gaps, _ in told)}; {told[0][1]}"


def _gaps_in(file: str, time: Array, limit: tuple[float, float]) -> str:
    """The intervals of ``time`` (n,), s, that exceed ``limit``; empty where none does."""
    interval = np.diff(time)
    usual = float(np.median(interval)) if interval.size else 0.0
    count = int(np.count_nonzero(interval > max(limit[0] * usual, limit[1])))
    if not count:
        return ""
    i = int(np.argmax(interval))
    return (
        f"{file}: {count} gap{'s' if count > 1 else ''}, the longest {interval[i]:.2f} s "
        f"after t = {time[i]:.2f} s (usual interval {usual:.3f} s)"
    )


def _seen_by_fixes(drive: Drive, body_rate: Array) -> tuple[NDArray[np.complex128], Array, Array]:
    """Motion over consecutive windows as the fixes show it, beside the integral of an IMU column.

    Returns
    -------
    velocity : ndarray of complex, shape (k,)
        m/s east + i north, the mean over each window.
    integral : ndarray, shape (k - 1,)
        Of ``body_rate`` (n,) from each window's middle to the next one's.
    turn : ndarray, shape (k - 1,)
        rad, the change of course from each window to the next.
    """
    imu, gps = drive.imu, drive.gps
    begin, end = max(imu.time[0], gps.time[0]), min(imu.time[-1], gps.time[-1])
    if end - begin > _SPARSEST * _WINDOW * len(gps):
        end = begin
    knots = np.arange(begin, end, _WINDOW)
    position = np.interp(knots, gps.time, gps.x) + 1j * np.interp(knots, gps.time, gps.y)
    if len(knots) < 2:
        return np.zeros(0, np.complex128), np.zeros(0), np.zeros(0)
    velocity = np.diff(position) / _WINDOW
    total = np.append(0.0, np.cumsum(body_rate[1:] * np.diff(imu.time)))
    integral = np.diff(np.interp(knots[:-1] + _WINDOW / 2, imu.time, total))
    return velocity, integral, wrap_angle(np.diff(np.angle(velocity)))


def _angular_rate(drive: Drive) -> Iterator[str]:
    """Whether gz is in deg/s: it then turns 57 times as far as the course does."""
    velocity, turned, turn = _seen_by_fixes(drive, drive.imu.gz)
    moving = np.abs(velocity) > 4.0  # m/s; slower, the noise of the fixes makes the course
    both = moving[1:] & moving[:-1]
    if np.count_nonzero(both) >= 4:
        # deviations, so that a gyro's bias does not count; at least 0.02 rad, as a straight road has no turns
        degrees = np.std(turned[both]) > 5 * max(float(np.std(turn[both])), 0.02)
    else:
        degrees = np.quantile(np.abs(drive.imu.gz), 0.99) > 3.0  # rad/s: no car turns half round in a second
    if degrees:
        yield "imu.csv: column gz turns more than the course, as if in deg/s; multiply gx, gy, gz by pi/180"


def _gravity(imu: Imu) -> Iterator[str]:
    """Whether gravity shows as +9.8 m/s2 on az and nowhere else."""
    columns = {"ax": imu.ax, "ay": imu.ay, "az": imu.az}
    median = {name: float(np.median(values)) for name, values in columns.items() if values is not None}
    level = max(("ax", "ay"), key=lambda name: abs(median[name]))
    az = median.get("az", GRAVITY)
    if abs(median[level]) > 0.7 * GRAVITY:
        yield (
            f"imu.csv: column {level} has median {median[level]:.2f} m/s2, gravity, which belongs on az; "
            "exchange axes until x is forward, y left, z up"
        )
    elif 0.8 < abs(az) < 1.2:
        yield f"imu.csv: column az has median {az:.2f}, as if in g; multiply ax, ay, az by {GRAVITY}"
    elif az < -0.7 * GRAVITY:
        yield (
            f"imu.csv: column az has median {az:.2f} m/s2, but specific force is +9.8 at rest with z up; "
            "turn the axes, or change the sign of ax, ay, az where the sensor reports the opposite"
        )
    elif abs(az - GRAVITY) > 0.2 * GRAVITY:
        yield (
            f"imu.csv: column az has median {az:.2f} m/s2, but +9.8 is expected; check its unit and axis, or "
            "leave it out where gravity was already taken off"
        )


def _acceleration(drive: Drive) -> Iterator[str]:
    """Without az to tell: whether ax is in g, and so explains a tenth of the changes of speed."""
    if drive.imu.az is not None:
        return
    velocity, gained, _ = _seen_by_fixes(drive, drive.imu.ax)
    change = np.abs(np.diff(np.abs(velocity)))
    strong = change > 2.0  # m/s, above what the fixes' noise makes
    if np.count_nonzero(strong) >= 3 and np.abs(gained[strong]).sum() < 0.3 * change[strong].sum():
        yield f"imu.csv: column ax explains too little of the speed, as if in g; multiply ax, ay by {GRAVITY}"
