"""Which filter suits some logs, by what they have: the one rule behind `tune`'s default and all that names it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive

VARIES = 1.5
"""95% quantile of the stated deviations over the 5% quantile, from which on they tell good fixes from bad ones."""
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


def suited(drives: Sequence[Drive]) -> Suited:
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
    worse. The figures stand in docs/results.md, "What tune takes by itself".
    """
    six = bool(drives) and all(map(has_attitude, drives))
    wheels = bool(drives) and all(d.odometer is not None for d in drives)
    spreads = [spread for d in drives if (spread := stated_spread(d))]
    stated = bool(drives) and len(spreads) == len(drives)
    use = ("lateral", "standstill", *(("odometer",) if wheels else ()), *(("accuracy",) if stated else ()))
    all_there = all(axis is not None for d in drives for axis in (d.imu.az, d.imu.gx, d.imu.gy))
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
