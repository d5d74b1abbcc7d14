"""A log's clocks, merged into the steps of a filter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.custom.log import Log


@dataclass(frozen=True, eq=False)
class Steps:
    """What a filter does with a log, step by step.

    The first step has length zero: it only absorbs, where there is a measurement at the very start.

    Attributes
    ----------
    dt : (k,) s
    source : (k,) int: the row of the inputs that drives each step
    absorbs : (k,) int: the row of ``measurements`` that is absorbed at the step's end, or -1
    records : (k,) int: the row of the log's ``time`` at which the step ends, or -1
    inputs : (i, u)
    measurements : (f, m), those within the log's time
    measurement_time : (f,) s
    mean, covariance : (n,), (n, n), the start
    """

    dt: Array
    source: NDArray[np.int64]
    absorbs: NDArray[np.int64]
    records: NDArray[np.int64]
    inputs: Array
    measurements: Array
    measurement_time: Array
    mean: Array
    covariance: Array


def build_steps(log: Log) -> Steps:
    """Merge a log's ``time`` and its measurements."""
    usable = (log.measurement_time >= log.time[0]) & (log.measurement_time <= log.time[-1])
    moments = log.measurement_time[usable]
    ends = np.union1d(log.time, moments)
    return Steps(
        dt=np.diff(ends, prepend=ends[0]),
        source=np.searchsorted(log.time, ends).astype(np.int64),  # the first input at or after the step's end
        absorbs=_rows(moments, ends),
        records=_rows(log.time, ends),
        inputs=log.inputs if log.inputs is not None else np.empty((len(log.time), 0)),
        measurements=log.measurements[usable],
        measurement_time=moments,
        mean=log.mean,
        covariance=log.covariance,
    )


def _rows(times: Array, ends: Array) -> NDArray[np.int64]:
    """Which row of ``times`` each of ``ends`` is, or -1."""
    found = np.isin(ends, times)
    return np.where(found, np.cumsum(found) - 1, -1).astype(np.int64)
