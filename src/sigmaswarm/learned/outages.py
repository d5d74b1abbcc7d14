"""Outages and inputs of `outage-lstm`; the inputs are causal windows of the IMU."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError

HORIZON = 1.0  # s, duration of a displacement
OUTAGE_AFTER = 2.0
"""Time since the last fix after which an outage begins, s; a working receiver has 1 Hz or more."""
STEPS = 40  # number of steps of a resampled window
_QUIET = 1e-3
"""Offset that is added to the vibration of an axis before the logarithm, m/s2; the offset for a gyro is 1e-4 rad/s."""
_GRAVITY = 9.80665


@dataclass(frozen=True, eq=False)
class Windows:
    """Times in the outages of a drive, and the inputs at them.

    - ``begin``, ``end``: IMU samples, counted from the filter's start, of a displacement (k,).
    - ``features``, ``features_at_first``: inputs at ``end`` and ``first`` (k, STEPS, f), see `features_at`.
    - ``first``: sample after the last fix (k,).
    - ``age``: time from ``first`` to ``end``, s (k,).
    - ``over``: samples after the fixes that end the outages.
    """

    begin: NDArray[np.intp]
    end: NDArray[np.intp]
    features: Array
    first: NDArray[np.intp]
    features_at_first: Array
    age: Array
    over: NDArray[np.intp]


def outage_windows(line: Timeline, *, axes: Sequence[str], window: float) -> Windows:
    """Divide a drive's outages, which begin `OUTAGE_AFTER` after a fix, into windows of `HORIZON`; ignore hidden fixes.

    ``axes`` of the IMU are the inputs; ``window`` is their length, s.
    """
    time = line.imu_time
    came = np.concatenate([[line.start], line.end[line.updates]])
    spans = [
        (fix, until)
        for fix, until in zip(came, np.append(came[1:], np.inf), strict=True)
        if min(until, time[-1]) - fix >= OUTAGE_AFTER
    ]
    none = np.empty(0, dtype=np.intp)
    begins, ends, firsts = [none], [none], [none]
    for fix, until in spans:
        begin, end = pairs_of(time, fix, until, HORIZON)
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


def pairs_of(
    time: Array, after: float, until: float, every: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return indices of pairs of samples, `HORIZON` apart, between two times, (k,) each."""
    first, stop = np.searchsorted(time, [after, until])
    grid = np.arange(float(time[first]), float(time[stop - 1]) + 1e-9, every) if stop > first else np.empty(0)
    at = np.searchsorted(time[:stop], grid - 1e-9)
    per = round(HORIZON / every)
    begin, end = at[:-per], at[per:]
    near = time[end] - time[begin] < 1.5 * HORIZON  # not across a gap in the IMU
    return begin[near], end[near]


def features_at(line: Timeline, end: NDArray[np.intp], *, axes: Sequence[str], window: float) -> Array:
    """Return the inputs from the last ``window`` s before some samples, (k, STEPS, 2 axes).

    The inputs are the mean (m/s2, rad/s) and the logarithm of the standard deviation, which grows with the speed of a
    car.
    """
    time = line.drive.imu.time
    edges = line.imu_time[end][:, np.newaxis] + np.linspace(-window, 0.0, STEPS + 1)
    means: list[Array] = []
    shakes: list[Array] = []
    for axis in axes:
        values: Array | None = getattr(line.drive.imu, axis)
        if values is None:
            raise InputError(
                f"{line.drive.name}: imu.csv has no {axis}, an input of the network; train a network on drives of this "
                "car"
            )
        values = values - (_GRAVITY if axis == "az" else 0.0)
        mean = _means(time, values, edges)
        variance = _means(time, values**2, edges) - mean**2
        means.append(mean)
        quiet = _QUIET if axis.startswith("a") else 0.1 * _QUIET
        shakes.append(np.log(np.sqrt(np.maximum(variance, 0.0)) + quiet))
    return np.stack([*means, *shakes], axis=-1)


def _means(time: Array, values: Array, edges: Array) -> Array:
    """Return the means (k, m) of a signal between edges (k, m + 1); before its first sample the signal is constant."""
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])
    inside = np.maximum(edges, time[0])
    length = np.diff(inside, axis=1)
    sums = np.diff(np.interp(inside, time, whole), axis=1)
    return np.where(length > 0.0, sums / np.where(length > 0.0, length, 1.0), values[0])
