"""Outages as `outage-lstm` sees them: when there is one, and what the IMU said up to a moment in it.

All of it is causal: it depends on nothing that comes after the moment.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Imu
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError

HORIZON = 1.0
"""s: how long a displacement lasts."""
OUTAGE_AFTER = 2.0
"""s without a fix, after which there is an outage: receivers that still work come at 1 Hz and faster."""
STEPS = 40
"""Into which a window is resampled, whatever its length."""
_QUIET = 1e-3
"""m/s2, and a tenth of it in rad/s, added to what an axis shakes by, so that it has a logarithm."""
_GRAVITY = 9.80665


@dataclass(frozen=True, eq=False)
class Windows:
    """Moments in the outages of a drive, and what the IMU said before them.

    Attributes
    ----------
    begin, end : ndarray of int, shape (k,)
        Numbers of the IMU samples after the start between which the displacement is asked for.
    features : ndarray, shape (k, STEPS, f)
        Before the end: see `features_at`.
    first : ndarray of int, shape (k,)
        The sample behind the last fix, of windows in outages.
    features_at_first : ndarray, shape (k, STEPS, f)
    age : ndarray, shape (k,)
        s from there to the end.
    over : ndarray of int
        The samples behind the fixes that end the outages.
    """

    begin: NDArray[np.intp]
    end: NDArray[np.intp]
    features: Array
    first: NDArray[np.intp]
    features_at_first: Array
    age: Array
    over: NDArray[np.intp]


def outage_windows(line: Timeline, *, axes: Sequence[str], window: float) -> Windows:
    """Every `HORIZON` in a drive's outages; hidden fixes have not come.

    An outage begins at a fix, but is one only `OUTAGE_AFTER` later.

    Parameters
    ----------
    line : Timeline
    axes : sequence of str
        Of the IMU, those that the network sees.
    window : float
        s that it looks back.
    """
    time = line.imu_time
    came = np.concatenate([[line.start], line.end[line.absorbs]])
    spans = [
        (fix, until)
        for fix, until in zip(came, np.append(came[1:], np.inf), strict=True)
        if min(until, time[-1]) - fix >= OUTAGE_AFTER
    ]
    none = np.empty(0, dtype=np.intp)
    begins, ends, firsts = [none], [none], [none]
    for fix, until in spans:
        begin, end = _pairs(time, fix, until, HORIZON)
        late = time[end] - fix >= OUTAGE_AFTER
        begins.append(begin[late])
        ends.append(end[late])
        firsts.append(np.full(int(late.sum()), np.searchsorted(time, fix)))
    begin, end, first = (np.concatenate(each) for each in (begins, ends, firsts))
    over = np.searchsorted(time, [until for _, until in spans if until <= time[-1]])
    return Windows(
        begin,
        end,
        features_at(line, end, axes=axes, window=window),
        first,
        features_at(line, first, axes=axes, window=window),
        time[end] - time[first],
        over,
    )


def all_windows(
    line: Timeline, *, axes: Sequence[str], window: float, every: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """All over a drive, one ``every`` so many s (a part of `HORIZON`): begin, end and features as of `Windows`."""
    begin, end = _pairs(line.imu_time, line.start, np.inf, every)
    return begin, end, features_at(line, end, axes=axes, window=window)


def _pairs(
    time: Array, after: float, until: float, every: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Samples, `HORIZON` apart, from one moment until another, (k,) each."""
    first, stop = np.searchsorted(time, [after, until])
    grid = np.arange(float(time[first]), float(time[stop - 1]) + 1e-9, every) if stop > first else np.empty(0)
    at = np.searchsorted(time[:stop], grid - 1e-9)
    per = round(HORIZON / every)
    begin, end = at[:-per], at[per:]
    held = time[end] - time[begin] < 1.5 * HORIZON  # not across a gap in the IMU
    return begin[held], end[held]


def features_at(line: Timeline, end: NDArray[np.intp], *, axes: Sequence[str], window: float) -> Array:
    """What the IMU said in the last ``window`` s before some samples, (k, STEPS, 2 axes).

    Of each step and axis the mean (m/s2, rad/s), and the logarithm of what it shakes by (the same): of a driving car
    the latter grows with the speed.
    """
    imu = line.drive.imu
    edges = line.imu_time[end][:, np.newaxis] + np.linspace(-window, 0.0, STEPS + 1)
    means: list[Array] = []
    shakes: list[Array] = []
    for axis in axes:
        values = _axis(imu, axis, line.drive.name)
        values = values - (_GRAVITY if axis == "az" else 0.0)
        mean = _means(imu.time, values, edges)
        variance = _means(imu.time, values**2, edges) - mean**2
        means.append(mean)
        quiet = _QUIET if axis.startswith("a") else 0.1 * _QUIET
        shakes.append(np.log(np.sqrt(np.maximum(variance, 0.0)) + quiet))
    return np.stack([*means, *shakes], axis=-1)


def _means(time: Array, values: Array, edges: Array) -> Array:
    """Means of a signal between edges (k, m + 1), (k, m); before the first sample it is that one."""
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])
    inside = np.maximum(edges, time[0])
    length = np.diff(inside, axis=1)
    sums = np.diff(np.interp(inside, time, whole), axis=1)
    return np.where(length > 0.0, sums / np.where(length > 0.0, length, 1.0), values[0])


def _axis(imu: Imu, axis: str, name: str) -> Array:
    values = getattr(imu, axis)
    if values is None:
        raise InputError(
            f"{name}: its imu.csv has no {axis}, which the network was trained with; train one on drives of this car"
        )
    return values
