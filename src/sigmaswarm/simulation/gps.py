"""Simulate a GPS receiver: grades, errors and outliers.

Sources: gnss-ins-sim; u-blox data sheets (M8: 2.5 m CEP, which is 2.1 m per axis; 0.05 m/s); the CARLA Leaderboard's
sensor set-up (5e-6 deg). Position errors of real receivers are correlated over about a minute (Sensors 2020, 20, 6050).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.simulation.environments import Named, by_name
from sigmaswarm.simulation.motion import LeverArm, Motion
from sigmaswarm.simulation.sensors import gauss_markov

EARTH_RADIUS = 6378137.0  # m, radius of CARLA's sphere
METERS_PER_DEGREE = math.pi * EARTH_RADIUS / 180.0  # m, degree of latitude on CARLA's sphere


@dataclass(frozen=True)
class ErrorGrade(Named):
    """A grade whose errors are the sum of white noise and a first-order Gauss-Markov process."""

    white_std: float
    markov_std: float = 0.0
    markov_time: float = 60.0

    @property
    def std(self) -> float:
        """Total standard deviation, per axis."""
        return math.hypot(self.white_std, self.markov_std)

    def draw(self, rng: np.random.Generator, times: Array, axes: int) -> tuple[Array, Array]:
        """Draw the white and the correlated errors, (n, axes), at ``times`` (n,), s."""
        white = self.white_std * rng.standard_normal((len(times), axes))
        ratio = float(np.median(np.diff(times))) / self.markov_time
        return white, self.markov_std * gauss_markov(rng, len(times), axes, ratio)


@dataclass(frozen=True)
class GpsGrade(ErrorGrade):
    """A named grade of receiver.

    Attributes
    ----------
    white_std, markov_std : float
        Standard deviations per axis (m) of the white noise of each fix and of the first-order Gauss-Markov error.
    markov_time : float
        Correlation time, s.
    velocity_std : float or None
        Standard deviation of the velocity per axis, m/s; None if the receiver reports neither speed nor course.
    latency : float
        Delay of a fix relative to its time stamp, s. It is 0 in all grades, since loggers stamp fixes with their time
        of validity.
    lever_arm : tuple of float
        Vector from the IMU to the antenna, m forward, left, up.
    stated_factor : float
        Stated standard deviation divided by the true standard deviation.
    loss : float
        Probability that a fix is lost.
    carla : bool
        True if white noise is added in degrees, with CARLA's geodesy.
    """

    velocity_std: float | None = None
    latency: float = 0.0
    lever_arm: LeverArm = (0.0, 0.0, 0.0)
    stated_factor: float = 1.0
    loss: float = 0.0
    carla: bool = False
    source: str = ""


GPS_GRADES = by_name(
    GpsGrade("ideal", 0.0, velocity_std=0.0, source="no errors"),
    GpsGrade(
        "ublox-m8",
        0.5,
        math.sqrt(2.1**2 - 0.5**2),
        velocity_std=0.05,
        source="u-blox M8 data sheet; the split into 0.5 m of white noise and a correlated rest is from the "
        "author's memory, not verified",
    ),
    GpsGrade("white-1m", 1.0, source="1 m of white noise, the simplest error"),
    GpsGrade("gnss-ins-sim", 5.0, velocity_std=0.05, source="gnss-ins-sim: 5 m, 0.05 m/s, white"),
    GpsGrade(
        "f9p-rtk",
        0.01,
        velocity_std=0.05,
        source="u-blox ZED-F9P with RTK, from the author's memory, not verified",
    ),
    GpsGrade(
        "carla", 5e-6 * METERS_PER_DEGREE, carla=True, source="CARLA Leaderboard sensor set-up (5e-6 deg)"
    ),
)


@dataclass(frozen=True)
class HeadingGrade(ErrorGrade):
    """A named grade of the headings that a receiver reports.

    Attributes
    ----------
    white_std, markov_std : float
        Standard deviations of the white noise and of the first-order Gauss-Markov error, rad.
    markov_time : float
        Correlation time, s.
    mounting : float
        Angle of the antennas' baseline (rad), counter-clockwise from forward; unknown to the receiver.
    """

    mounting: float = 0.0
    source: str = ""


HEADING_GRADES = by_name(
    HeadingGrade("ideal", 0.0, source="no errors"),
    HeadingGrade(
        "dual-antenna",
        math.radians(0.3),
        math.sqrt(math.radians(0.4) ** 2 - math.radians(0.3) ** 2),
        source="u-blox ZED-F9P data sheet: 0.4 deg at a baseline of 1 m; the split into white and correlated noise "
        "is an assumption",
    ),
)


def with_heading(fixes: Gps, time: Array, yaw: Array, grade: HeadingGrade, rng: np.random.Generator) -> Gps:
    """Add headings to fixes. ``yaw`` (n,), rad, is the true heading at ``time`` (n,), s."""
    white, markov = grade.draw(rng, time, 1)
    theta = (yaw + grade.mounting + (white + markov)[:, 0])[np.searchsorted(time, fixes.time)]
    stated = np.full(len(theta), grade.std) if grade.std > 0 else None
    return replace(fixes, heading=np.asarray(wrap_angle(theta)), std_heading=stated)


def degrade(grade: GpsGrade, factor: float) -> GpsGrade:
    """Multiply the standard deviations of a grade by a factor."""
    errors = {name: getattr(grade, name) for name in ("white_std", "markov_std", "velocity_std")}
    return replace(grade, **{name: std and factor * std for name, std in errors.items()})


def measure_gps(
    times: Array,
    antenna: Motion,
    grade: GpsGrade,
    rng: np.random.Generator,
    outages: list[tuple[float, float]],
) -> Gps:
    """Make fixes with the time stamps ``times`` (n,), s.

    A fix measures the antenna's position at its time stamp minus the latency. There are no fixes in the ``outages``,
    pairs of start and end (s). The number of random numbers does not depend on the grade.
    """
    white, markov = grade.draw(rng, times, 2)
    velocity = antenna.velocity[:, :2] + (grade.velocity_std or 0.0) * rng.standard_normal((len(times), 2))
    keep = rng.random(len(times)) >= grade.loss
    for start, end in outages:
        keep &= (times < start) | (times >= end)

    position = antenna.position[:, :2]
    x, y = _through_degrees(position, white).T if grade.carla else (position + white + markov).T
    std = grade.stated_factor * grade.std  # ideal fixes state no standard deviation, since 0 is not valid
    stated = np.full(len(times), std) if std > 0 else None
    fixes = Gps(times, x, y, std_x=stated, std_y=stated)
    if grade.velocity_std is not None:
        fixes = replace(fixes, speed=np.hypot(*velocity.T), course=np.arctan2(velocity[:, 1], velocity[:, 0]))
    return fixes.select(keep)


def _through_degrees(position: Array, noise: Array) -> Array:
    """Add noise (n, 2) in m, converted to degrees as in CARLA, on a Mercator plane with origin 0, 0."""
    radius, equator = EARTH_RADIUS, math.log(math.tan(math.radians(90.0) / 2))
    lat = 2 * np.degrees(np.arctan(np.exp((radius * equator + position[:, 1]) / radius))) - 90
    lat += noise[:, 1] / METERS_PER_DEGREE
    lon = np.degrees(position[:, 0] / radius) + noise[:, 0] / METERS_PER_DEGREE
    north = np.log(np.tan(np.radians(90 + lat) / 2)) - equator
    return radius * np.column_stack([np.radians(lon), north])


def with_outliers(
    drive: Drive,
    rng: np.random.Generator,
    *,
    share: float = 0.06,
    offset: float = 20.0,
    length: tuple[float, float] = (0.2, 1.0),
) -> Drive:
    """Add bursts of outliers to the fixes of a drive. As in multipath, all fixes of a burst have the same error.

    Parameters
    ----------
    drive : Drive
    rng : numpy.random.Generator
        Generator that draws the first fix, the length and the direction of each burst from uniform distributions.
    share : float
        Minimum fraction of outliers among the fixes, in [0, 0.5]. The last burst may raise the fraction above this
        minimum.
    offset : float
        Size of the error, m.
    length : (float, float)
        Shortest and longest burst, s. If bursts overlap, a fix has the error of the burst that was drawn first.

    Raises
    ------
    InputError
        If ``share`` or ``length`` is out of range.
    """
    if not (0 <= share <= 0.5 and 0 <= length[0] <= length[1] < np.inf):
        raise InputError(
            f"share = {share:g} and length = {length} s: use a share of 0 to 0.5, and lengths of 0 s or more, the "
            "shorter one first"
        )
    time = drive.gps.time
    x, y, off = drive.gps.x.copy(), drive.gps.y.copy(), np.zeros(len(time), dtype=np.bool_)
    while off.mean() < share:
        begin = time[rng.integers(len(time))]
        span, direction = rng.uniform(*length), rng.uniform(0.0, 2 * np.pi)
        burst = (time >= begin) & (time <= begin + span) & ~off
        x[burst] += offset * np.cos(direction)
        y[burst] += offset * np.sin(direction)
        off |= burst
    # latitude and longitude of the original fixes no longer apply
    return replace(drive, frame="enu", gps=replace(drive.gps, x=x, y=y, lat=None, lon=None, alt=None))
