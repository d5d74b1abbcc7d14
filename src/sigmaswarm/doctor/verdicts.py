"""Decisions from fits with covariances: units, signs, axes, mounting, and the clocks' offset."""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from sigmaswarm.doctor import acceleration_fit
from sigmaswarm.doctor.acceleration_fit import AccelerationFit
from sigmaswarm.doctor.yaw_fit import LATENESS, YawFit
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Array

DEGREE = math.pi / 180
FAMILIAR = 1.35
"""A factor this close to a known one (1, -1, deg/s) is that one."""
LEAST_SHARE = 0.2
"""Of the course's changes that a gyro's column explains at least if its gain is used, unless the gain is CERTAIN."""
CERTAIN = 12.0
"""Standard deviations of the gain: in a city, or with outliers, most of the course's changes are the fixes' own."""
CLEARLY = 16.0
"""Of chi-square: how much better than the log as it stands another reading must be."""
ALIKE = 0.05
"""Tolerance of M's entries off the axes, for other reasons: tilt that follows the maneuvers, slip."""
SCALE = 0.12
"""The same along the axes; besides, a body that rolls and pitches makes accelerometers feel 5 to 10% more."""
SHOWN = 0.25
"""Deviation of an entry of M, in its unit, below which the drive shows it."""
LEAST_OFFSET = 0.1
"""s between the clocks: less does not show behind a receiver's noise."""
CLEAR_OFFSET = (2.5, 3.3, 4.5)
"""Deviations: from the first on a note, from the second on a warning and a repair, from the third on serious."""
MOUNTED = math.radians(40)
"""Beyond that, a rotation counts as axes exchanged."""


@dataclass(frozen=True)
class Yaw:
    """The yaw rate in rad/s as a column times a factor; ``known`` if the drive shows it."""

    column: str
    factor: float
    known: bool


def yaw_of(yaw_fit: YawFit | None) -> Yaw:
    """Column, sign and unit of the gyro that agree with the course; if unclear those of the format."""
    size = 0.0 if yaw_fit is None else abs(yaw_fit.gain) / max(yaw_fit.std, 1e-12)
    if yaw_fit is None or size < 6 or (yaw_fit.share < LEAST_SHARE and size < CERTAIN):
        return Yaw("gz", 1.0, known=False)
    for factor in (1.0, -1.0, DEGREE, -DEGREE):
        ratio = yaw_fit.gain / factor
        if 1 / FAMILIAR < ratio < FAMILIAR:
            return Yaw(yaw_fit.column, factor, known=True)
    return Yaw("gz", 1.0, known=False)


@dataclass(frozen=True, eq=False)
class Mount:
    """The reading of the accelerometers' columns.

    Attributes
    ----------
    axes : (2, 2), signed permutation of (ax, ay)
    unit : 1, or m/s2 per g
    angle, angle_std : rad: the axes, so read, are turned about z by -angle against the car
    margin : how much better (chi-square) this reading is than the log as it stands
    known : (forward, left): True if the drive shows that axis
    scale : (forward, left): remaining factor, and its deviation
    """

    axes: Array
    unit: float
    angle: float
    angle_std: float
    margin: float
    known: tuple[bool, bool]
    scale: tuple[tuple[float, float], tuple[float, float]]

    @property
    def matrix(self) -> Array:
        """(2, 2): unit times axes."""
        return self.unit * self.axes


def mount_of(acceleration: AccelerationFit) -> Mount:
    """The simplest reading of the columns that the fit agrees with."""
    found = acceleration.matrix.ravel()
    covariance = acceleration.covariance[:4, :4]
    angles = np.radians(np.arange(-40.0, 40.5, 0.5))

    def misfit(axes: Array, unit: float, angle: float) -> float:
        c, s = math.cos(angle), math.sin(angle)
        expected = unit * (np.array([[c, -s], [s, c]]) @ axes)
        slack = unit * np.where(axes != 0, SCALE, ALIKE).ravel()
        off = found - expected.ravel()
        return float(off @ np.linalg.solve(covariance + np.diag(slack**2), off))

    as_it_is = misfit(np.eye(2), 1.0, 0.0)
    best, reading = as_it_is, (np.eye(2), 1.0)
    for axes, unit in product(_signed_permutations(), (1.0, GRAVITY)):
        plain = np.array_equal(axes, np.eye(2))
        price = 6.0 * (unit != 1) + 6.0 * (not plain) + 2.0 * (np.count_nonzero(np.diag(axes)) == 0)
        turned = min(
            misfit(axes, unit, angle) + (6.0 if abs(angle) > MOUNTED / 8 else 0.0) for angle in angles
        )
        if turned + price < best:
            best, reading = turned + price, (axes, unit)
    if as_it_is - best < CLEARLY and not (np.array_equal(reading[0], np.eye(2)) and reading[1] == 1):
        reading = (np.eye(2), 1.0)
    axes, unit = reading
    known = _known(acceleration, axes, unit)
    changed = [not np.array_equal(row, usual) for row, usual in zip(axes, np.eye(2), strict=True)]
    if unit == 1 and not any(k and c for k, c in zip(known, changed, strict=True)):
        axes = np.eye(2)  # an axis that the drive does not show stays as it is
    misfits = np.array([misfit(axes, unit, angle) for angle in angles])
    k = int(np.clip(np.argmin(misfits), 1, len(angles) - 2))
    bend = (misfits[k - 1] + misfits[k + 1] - 2 * misfits[k]) / (angles[1] - angles[0]) ** 2
    spread = np.sqrt(np.diag(covariance)).reshape(2, 2) / unit
    turned_back = acceleration.matrix @ axes.T / unit
    scale = tuple((float(turned_back[i, i]), float((spread @ np.abs(axes.T))[i, i])) for i in range(2))
    return Mount(
        axes,
        unit,
        float(angles[np.argmin(misfits)]),
        float(math.sqrt(2 / bend)) if bend > 0 else math.inf,
        as_it_is - best,
        _known(acceleration, axes, unit),
        scale,  # pyright: ignore[reportArgumentType]
    )


def _known(acceleration: AccelerationFit, axes: Array, unit: float) -> tuple[bool, bool]:
    """The axes, forward and left, that the drive shows well enough, were the columns read so."""
    spread = np.sqrt(np.diag(acceleration.covariance)[:4]).reshape(2, 2) / unit
    forward, left = np.diag(spread @ np.abs(axes.T)) < SHOWN
    return bool(forward), bool(left)


def _signed_permutations() -> list[Array]:
    """All eight ways to read two columns as forward and left, the format's own first."""
    orders = (np.eye(2), np.eye(2)[::-1])
    return [np.diag([a, b]) @ order for order in orders for a, b in product((1.0, -1.0), repeat=2)]


@dataclass(frozen=True)
class ClockOffset:
    """Delay of the fixes, s, its standard deviation, and the largest one searched."""

    late: float
    std: float
    searched: float

    @property
    def least(self) -> float:
        """The smallest estimate, s, that counts as an offset."""
        return max(LEAST_OFFSET, CLEAR_OFFSET[0] * self.std)

    @property
    def visible(self) -> float | None:
        """The smallest offset, s, that would have been seen with a probability of 95% or more; None: not any."""
        offset = self.least + 1.65 * self.std
        return offset if offset < self.searched else None


def clock_of(
    yaw_fit: YawFit | None, yaw: Yaw, acceleration: AccelerationFit | None, mount: Mount | None
) -> ClockOffset:
    """The delay by accelerometers and gyro together; the less certain, the more they disagree."""
    told: list[tuple[float, float]] = []
    searched = float(acceleration_fit.LATENESS[-1])
    if acceleration is not None and mount is not None:
        told.append(_late_given(acceleration, mount))
    if yaw_fit is not None and yaw.known and yaw_fit.share > 0.5:
        told.append((yaw_fit.late, yaw_fit.late_std))
        searched = float(LATENESS[-1])
    if not told:
        return ClockOffset(0.0, math.inf, 0.0)
    weight = np.array([1 / std**2 for _, std in told])
    late = float(weight @ [late for late, _ in told] / weight.sum())
    chi = float(weight @ [(value - late) ** 2 for value, _ in told]) / max(len(told) - 1, 1)
    return ClockOffset(late, math.sqrt(max(chi, 1.0) / weight.sum()), searched)


def _late_given(acceleration: AccelerationFit, mount: Mount) -> tuple[float, float]:
    """The lateness and its deviation, now that M is about known (the fit's Gaussian, conditioned)."""
    c, s = math.cos(mount.angle), math.sin(mount.angle)
    expected = (mount.unit * np.array([[c, -s], [s, c]]) @ mount.axes).ravel()
    slack = mount.unit * np.where(mount.axes != 0, SCALE, ALIKE).ravel()
    covariance = acceleration.covariance
    gain = np.linalg.solve(covariance[:4, :4] + np.diag(slack**2), covariance[:4, 4])
    late = acceleration.late + gain @ (expected - acceleration.matrix.ravel())
    return float(late), float(math.sqrt(max(covariance[4, 4] - gain @ covariance[:4, 4], 1e-6)))
