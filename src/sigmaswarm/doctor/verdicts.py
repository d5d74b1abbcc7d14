"""From fits with their covariances to what is the case: units, signs, axes, mounting, and the clocks' offset."""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from sigmaswarm.doctor.pushing import Pushing
from sigmaswarm.doctor.turning import Turning
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Array

DEGREE = math.pi / 180
FAMILIAR = 1.35
"""A factor this close to a known one (1, -1, deg/s) is that one."""
LEAST_SHARE = 0.2
"""Of the course's changes that a gyro's column explains at least if it is believed."""
CLEARLY = 16.0
"""Of chi-square: how much better than the log as it stands another reading must be."""
ALIKE = 0.05
"""How far M's entries off the axes may stray for other reasons: tilt that goes with the maneuvers, slip."""
SCALE = 0.12
"""The same along the axes; besides, a body that rolls and pitches makes accelerometers feel 5 to 10% more."""
SHOWN = 0.25
"""Deviation of an entry of M, in its unit, below which the drive shows it."""
MOUNTED = math.radians(40)
"""Beyond that, a rotation counts as axes exchanged."""


@dataclass(frozen=True)
class Yaw:
    """Which column times which factor is the yaw rate, in rad/s; ``known`` if the drive shows it."""

    column: str
    factor: float
    known: bool


def yaw_of(turning: Turning | None) -> Yaw:
    """The gyro's column, sign and unit that the course agrees with; in doubt those of the format."""
    if turning is None or turning.share < LEAST_SHARE or abs(turning.gain) < 6 * turning.std:
        return Yaw("gz", 1.0, known=False)
    for factor in (1.0, -1.0, DEGREE, -DEGREE):
        ratio = turning.gain / factor
        if 1 / FAMILIAR < ratio < FAMILIAR:
            return Yaw(turning.column, factor, known=True)
    return Yaw("gz", 1.0, known=False)


@dataclass(frozen=True, eq=False)
class Mount:
    """How the accelerometers' columns have to be read.

    Attributes
    ----------
    axes : (2, 2), signed permutation of (ax, ay)
    unit : 1, or m/s2 per g
    angle, angle_std : rad: the axes, so read, are turned about z by -angle against the car
    margin : how much better (chi-square) this reading is than the log as it stands
    known : (forward, left): whether the drive shows that axis
    scale : (forward, left): what is left to multiply by, and its deviation
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

    @property
    def as_recorded(self) -> bool:
        """Whether columns, signs and unit are those of the format."""
        return bool(np.array_equal(self.axes, np.eye(2))) and self.unit == 1


def mount_of(pushing: Pushing) -> Mount:
    """The simplest reading of the columns that the fit agrees with."""
    found = pushing.matrix.ravel()
    covariance = pushing.covariance[:4, :4]
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
    known = _known(pushing, axes, unit)
    changed = [not np.array_equal(row, usual) for row, usual in zip(axes, np.eye(2), strict=True)]
    if unit == 1 and not any(k and c for k, c in zip(known, changed, strict=True)):
        axes = np.eye(2)  # an axis that the drive does not show stays as it is
    misfits = np.array([misfit(axes, unit, angle) for angle in angles])
    k = int(np.clip(np.argmin(misfits), 1, len(angles) - 2))
    bend = (misfits[k - 1] + misfits[k + 1] - 2 * misfits[k]) / (angles[1] - angles[0]) ** 2
    spread = np.sqrt(np.diag(covariance)).reshape(2, 2) / unit
    turned_back = pushing.matrix @ axes.T / unit
    scale = tuple((float(turned_back[i, i]), float((spread @ np.abs(axes.T))[i, i])) for i in range(2))
    return Mount(
        axes,
        unit,
        float(angles[np.argmin(misfits)]),
        float(math.sqrt(2 / bend)) if bend > 0 else math.inf,
        as_it_is - best,
        _known(pushing, axes, unit),
        scale,  # pyright: ignore[reportArgumentType]
    )


def _known(pushing: Pushing, axes: Array, unit: float) -> tuple[bool, bool]:
    """Whether the drive shows forward and left well enough, were the columns read so."""
    spread = np.sqrt(np.diag(pushing.covariance)[:4]).reshape(2, 2) / unit
    forward, left = np.diag(spread @ np.abs(axes.T)) < SHOWN
    return bool(forward), bool(left)


def _signed_permutations() -> list[Array]:
    """All eight ways to read two columns as forward and left, the format's own first."""
    orders = (np.eye(2), np.eye(2)[::-1])
    return [np.diag([a, b]) @ order for order in orders for a, b in product((1.0, -1.0), repeat=2)]


@dataclass(frozen=True)
class Clock:
    """By how many s the fixes are late, and how well that is known."""

    late: float
    std: float


def clock_of(turning: Turning | None, yaw: Yaw, pushing: Pushing | None, mount: Mount | None) -> Clock:
    """What accelerometers and gyro say together; the more doubtful, the more they disagree."""
    told: list[tuple[float, float]] = []
    if pushing is not None and mount is not None:
        told.append(_late_given(pushing, mount))
    if turning is not None and yaw.known and turning.share > 0.5:
        told.append((turning.late, turning.late_std))
    if not told:
        return Clock(0.0, math.inf)
    weight = np.array([1 / std**2 for _, std in told])
    late = float(weight @ [late for late, _ in told] / weight.sum())
    chi = float(weight @ [(value - late) ** 2 for value, _ in told]) / max(len(told) - 1, 1)
    return Clock(late, math.sqrt(max(chi, 1.0) / weight.sum()))


def _late_given(pushing: Pushing, mount: Mount) -> tuple[float, float]:
    """The lateness and its deviation, now that M is about known (the fit's Gaussian, conditioned)."""
    c, s = math.cos(mount.angle), math.sin(mount.angle)
    expected = (mount.unit * np.array([[c, -s], [s, c]]) @ mount.axes).ravel()
    slack = mount.unit * np.where(mount.axes != 0, SCALE, ALIKE).ravel()
    covariance = pushing.covariance
    gain = np.linalg.solve(covariance[:4, :4] + np.diag(slack**2), covariance[:4, 4])
    late = pushing.late + gain @ (expected - pushing.matrix.ravel())
    return float(late), float(math.sqrt(max(covariance[4, 4] - gain @ covariance[:4, 4], 1e-6)))
