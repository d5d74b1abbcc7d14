"""What is known of the errors of a drive's fixes: what its receiver states, and what the fixes show."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Drive


def stated_std(drive: Drive) -> tuple[float, float] | None:
    """The receiver's stated standard deviation east and north, m; None where the log states none.

    The median over the fixes, where the log states one of each; else ``gps_std_m`` of drive.toml.
    """
    gps = drive.gps
    if gps.std_x is not None and gps.std_y is not None:
        return float(np.median(gps.std_x)), float(np.median(gps.std_y))
    std = drive.metadata.get("gps_std_m")
    return None if std is None else (float(std), float(std))


def white_noise(position: NDArray[np.complexfloating[Any, Any]]) -> float:
    """The noise of fixes from one to the next, m per axis; 0 of fewer than four.

    Robust, of third differences, which remove the motion. Errors that last longer than some fixes are not in it.

    Parameters
    ----------
    position : ndarray of complex, shape (n,)
        East + i north, m, of fixes at even times.
    """
    third = np.diff(position, n=3)
    spread = np.concatenate([third.real, third.imag])
    return float(np.median(np.abs(spread)) / 0.6745 / np.sqrt(20.0)) if len(third) else 0.0


def motion_in_noise(interval: float) -> float:
    """What the motion itself leaves in `white_noise` of fixes that are ``interval`` s apart, m, in a city."""
    return 0.02 + 0.15 * interval**2
