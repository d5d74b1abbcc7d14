"""Which filter suits some logs, by what they have: the one rule behind `tune`'s default and all that names it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.drives.noise import has_white_errors

VARIES = 1.5
"""95% quantile of the stated deviations over the 5% quantile, from which on they tell good fixes from bad ones."""
STARTED = 20.0
"""m from the first fix: the car is under way."""
NEAR_GRAVITY = 0.3
"""Share of gravity by which az may be off in the median, to be taken for the vertical axis in m/s2."""


@dataclass(frozen=True)
class Suited:
    """A filter for some logs.

    Attributes
    ----------
    model : str
        A name of `filters.names.ModelName`.
    use : tuple of str
        What it uses beside the fixes' positions, as ``--use`` takes them.
    because : str
        What the logs have that speaks for it.
    """

    model: str
    use: tuple[str, ...]
    because: str

    @property
    def options(self) -> str:
        """As they are typed."""
        return f"--model {self.model} --use {' '.join(self.use)}"


@dataclass(frozen=True)
class Equipment:
    """What a log has: all that decides which filters and objectives it allows.

    Attributes
    ----------
    name : str
    truth : bool
        Whether it is there, with at least one row.
    interval : float
        s, the usual one between two IMU samples.
    axes : tuple of str
        Of the IMU, those that are there.
    attitude : bool
        See `has_attitude`.
    odometer, accuracy, velocity : bool
        Whether it has the wheels' speed, and the receiver's stated deviations, and its speed and course.
    spread : (float, float) or None
        See `stated_spread`.
    white : bool
        See `sigmaswarm.drives.noise.has_white_errors`.
    driven : float
        s that the log goes on after it has moved 20 m.
    """

    name: str
    truth: bool
    interval: float
    axes: tuple[str, ...]
    attitude: bool
    odometer: bool
    accuracy: bool
    velocity: bool
    spread: tuple[float, float] | None
    white: bool
    driven: float


def equipment(drive: Drive | Equipment) -> Equipment:
    """What a drive has; itself where that is known already."""
    if isinstance(drive, Equipment):
        return drive
    gps, imu = drive.gps, drive.imu
    return Equipment(
        name=drive.name,
        truth=bool(drive.truth),
        interval=drive.nominal_interval,
        axes=tuple(axis for axis in ("ax", "ay", "az", "gx", "gy", "gz") if getattr(imu, axis) is not None),
        attitude=has_attitude(drive),
        odometer=drive.odometer is not None,
        accuracy=gps.std_x is not None and gps.std_y is not None,
        velocity=gps.speed is not None and gps.course is not None,
        spread=stated_spread(drive),
        white=has_white_errors(drive),
        driven=_driven(drive.gps),
    )


def _driven(gps: Gps) -> float:
    away = gps.time[np.hypot(gps.x - gps.x[:1], gps.y - gps.y[:1]) > STARTED]
    return float(gps.time[-1] - away[0]) if len(away) else 0.0


def suited(drives: Sequence[Drive | Equipment]) -> Suited:
    """The filter for cars that suits logs by what all of them have; nothing is run, and no score is looked at.

    - **tilted12** where every IMU has six axes, with gravity on az: it estimates roll and pitch, so that hills and
      braking do not pass for motion. **planar8** for the others.
    - **lateral** and **standstill** always: they hold the heading, which fixes alone leave free.
    - **odometer** where every log has one.
    - **accuracy** where every receiver states its deviation, and what they state varies.
    - **robust** always: it costs next to nothing where no fix lies far off, and is needed where some do.

    Not taken are the gate (tuned on one receiver it turns good fixes of another away), the receiver's velocity (no log
    with truth was at hand that has it) and latency. Models are not chosen by scores: held-out likelihood and forecasts
    chose 18 to 24% worse than the best in the mean, and 61 to 122% at worst; one good model for all was 4 to 12%
    worse. The figures stand in docs/results.md, "Default filter".
    """
    found = [equipment(drive) for drive in drives]
    six = bool(found) and all(one.attitude for one in found)
    wheels = bool(found) and all(one.odometer for one in found)
    spreads = [one.spread for one in found if one.spread]
    stated = bool(found) and len(spreads) == len(found)
    use = ("lateral", "standstill", *(("odometer",) if wheels else ()), *(("accuracy",) if stated else ()))
    all_there = all(len(one.axes) == 6 for one in found)
    missing = "az, gx or gy of the IMU look wrong" if all_there else "an IMU without az, gx and gy"
    reasons = ["six IMU axes" if six else missing]
    if wheels:
        reasons.append("an odometer")
    if stated:
        low, high = min(low for low, _ in spreads), max(high for _, high in spreads)
        reasons.append(f"stated deviations from {low:.2g} to {high:.2g} m")
    return Suited("tilted12" if six else "planar8", (*use, "robust"), ", ".join(reasons))


def has_attitude(drive: Drive) -> bool:
    """Whether the log tells roll and pitch: az, gx and gy are there, gravity is on az, and gx and gy are alive."""
    az, gx, gy = drive.imu.az, drive.imu.gx, drive.imu.gy
    if az is None or gx is None or gy is None:
        return False
    upright = abs(float(np.median(az)) / GRAVITY - 1.0) < NEAR_GRAVITY
    return upright and bool(np.ptp(gx) > 0) and bool(np.ptp(gy) > 0)


def stated_spread(drive: Drive) -> tuple[float, float] | None:
    """Quantiles of the stated deviations, 5% and 95%, m, where they tell good fixes from bad ones."""
    std_x, std_y = drive.gps.std_x, drive.gps.std_y
    if std_x is None or std_y is None:
        return None
    low, high = np.quantile(np.concatenate([std_x, std_y]), [0.05, 0.95])
    return (float(low), float(high)) if high > VARIES * low else None
