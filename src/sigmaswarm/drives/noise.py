"""What is known of the errors of a drive's fixes: what its receiver states, and what the fixes show."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Drive

WHITE = 0.4
"""Share of what a receiver's fixes are off by that is to be white: 1 of KITTI's and colorado's fixes, 0.25 of a u-blox
M8's, 0.02 or less of those that cars' receivers smooth (kingston-1, comma2k19, dresden)."""
UNSTATED_GPS_STD = 2.1
"""m per axis of a receiver that states nothing: u-blox M8, 2.5 m CEP."""


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


def has_white_errors(drive: Drive) -> bool:
    """Whether most of what the fixes err by is new with each fix, as far as the log can tell.

    Of a receiver that smooths, or whose errors last, neighbouring fixes differ by far less than they are off.
    """
    gps = drive.gps
    off, shown = max(stated_std(drive) or (UNSTATED_GPS_STD,)), white_noise(gps.x + 1j * gps.y)
    return shown > WHITE * off and shown > 3 * motion_in_noise(float(np.median(np.diff(gps.time))))


def motion_in_noise(interval: float) -> float:
    """What the motion itself leaves in `white_noise` of fixes that are ``interval`` s apart, m, in a city."""
    return 0.02 + 0.15 * interval**2
