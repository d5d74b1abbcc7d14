"""Outliers put into a drive: bursts of fixes that are all off by the same way, as reflections make them."""

from dataclasses import replace

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError


def with_outliers(
    drive: Drive,
    rng: np.random.Generator,
    *,
    share: float = 0.06,
    offset: float = 20.0,
    length: tuple[float, float] = (0.2, 1.0),
) -> Drive:
    """The drive with bursts of outliers among its fixes; nothing else is changed.

    Parameters
    ----------
    drive : Drive
    rng : numpy.random.Generator
        Draws when each burst begins (any fix is as likely), how long it lasts and where to it is off, all uniformly.
    share : float
        Of the fixes that are off, in [0, 0.5]; with the last burst, a few more.
    offset : float
        m by which they are off.
    length : (float, float)
        s, the shortest and the longest burst. Bursts that meet are one of the length of both.

    Raises
    ------
    InputError
        If ``share`` or ``length`` can't be used.
    """
    if not (0 <= share <= 0.5 and 0 <= length[0] <= length[1] < np.inf):
        raise InputError(
            f"share = {share:g} and length = {length} s: at most half of the fixes can be off, for times of 0 or more, "
            "the shorter one first"
        )
    time = drive.gps.time
    x, y, off = drive.gps.x.copy(), drive.gps.y.copy(), np.zeros(len(time), dtype=np.bool_)
    while off.mean() < share:
        begin, span, way = time[rng.integers(len(time))], rng.uniform(*length), rng.uniform(0.0, 2 * np.pi)
        burst = (time >= begin) & (time <= begin + span) & ~off
        x[burst] += offset * np.cos(way)
        y[burst] += offset * np.sin(way)
        off |= burst
    # degrees, where the log had them, would contradict
    return replace(drive, frame="enu", gps=replace(drive.gps, x=x, y=y, lat=None, lon=None, alt=None))
