"""Sensor log for a user's model, and the steps of the filter at the merged times of inputs and measurements."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError


@dataclass(frozen=True, eq=False)
class Log:
    """One recording: inputs, measurements, the initial state of a filter, and truth if known.

    The filter steps to each ``time``; the inputs at t_k belong to the step from t_(k-1) to t_k. A measurement between
    two times splits the step. Measurements before the first or after the last ``time`` are ignored.

    Attributes
    ----------
    name : str
    time : ndarray, shape (k,)
        Times to which the filter steps, s, strictly increasing.
    measurement_time : ndarray, shape (f,)
        Times of the measurements, s, strictly increasing; they may differ from ``time``.
    measurements : ndarray, shape (f, m)
        Shape (f,) is read as (f, 1). NaN means that an element has no value; the update then uses the other elements.
        `from_sensors` merges sensors.
    mean, covariance : ndarray, shapes (n,), (n, n)
        State estimate at ``time[0]``, where the filter starts. It must not be computed from truth.
    inputs : ndarray, shape (k, u), optional
        Inputs of the process; shape (k,) is read as (k, 1). If None, the input of f is an empty array.
    truth : mapping of str to ndarray, shape (j,)
        True values of some or all states, by name. No filter uses them.
    truth_time : ndarray, shape (j,), optional
        Times of truth, s, strictly increasing; ``time`` by default.

    Raises
    ------
    InputError
        If a shape or a value is not valid.
    """

    name: str
    time: Array
    measurement_time: Array
    measurements: Array
    mean: Array
    covariance: Array
    inputs: Array | None = None
    truth: Mapping[str, Array] = field(default_factory=dict[str, Array])
    truth_time: Array | None = None

    @classmethod
    def from_sensors(
        cls,
        name: str,
        time: ArrayLike,
        sensors: Mapping[str, tuple[ArrayLike, ArrayLike]],
        mean: ArrayLike,
        covariance: ArrayLike,
        *,
        inputs: ArrayLike | None = None,
        truth: Mapping[str, ArrayLike] | None = None,
        truth_time: ArrayLike | None = None,
    ) -> "Log":
        """Merge sensors, each with its own times, into the measurements of one log.

        Parameters
        ----------
        sensors : mapping of str to (times, values)
            Times (f,), s, strictly increasing, and values (f, m) or (f,). A measurement has the elements of all sensors
            in the order of this mapping; ``h`` must return them in this order. Rows that are all NaN are left out.
        name, time, mean, covariance, inputs, truth, truth_time
            See `Log`.

        Raises
        ------
        InputError
            If a shape or a value is not valid, or a sensor has no value within ``time``.
        """
        clock, columns = _clock(name, "time", time), list[tuple[Array, Array]]()
        given: Any = sensors
        if not isinstance(given, Mapping) or not given:
            raise _wrong(
                name, "sensors must be a mapping of names to (times, values), with at least one sensor"
            )
        for sensor, pair in sensors.items():
            role = f"sensors[{sensor!r}]"
            try:
                times, values = pair
            except (TypeError, ValueError):
                raise _wrong(name, f"{role} is not a pair; pass (times, values)") from None
            moments = _clock(name, f"times of {role}", times)
            table = _table(name, f"values of {role}", values, f"times of {role}", len(moments), absent=True)
            kept = ~np.isnan(table).all(axis=1)
            _check_overlap(name, role, moments[kept], clock)
            columns.append((moments[kept], table[kept]))
        merged = np.unique(np.concatenate([moments for moments, _ in columns]))
        measurements = np.full((len(merged), sum(table.shape[1] for _, table in columns)), np.nan)
        first = 0
        for moments, table in columns:
            last = first + table.shape[1]
            measurements[np.searchsorted(merged, moments), first:last] = table
            first = last
        others: Any = {"inputs": inputs, "truth": truth or {}, "truth_time": truth_time}
        return cls(name, clock, merged, measurements, np.asarray(mean), np.asarray(covariance), **others)

    def __post_init__(self) -> None:
        time = self._keep("time", _clock(self.name, "time", self.time))
        fixes = self._keep("measurement_time", _clock(self.name, "measurement_time", self.measurement_time))
        given = (self.measurements, "measurement_time", len(fixes))
        measurements = self._keep("measurements", _table(self.name, "measurements", *given, absent=True))
        inputs = np.empty((len(time), 0)) if self.inputs is None else self.inputs
        self._keep("inputs", _table(self.name, "inputs", inputs, "time", len(time)))
        mean = self._keep("mean", _finite(self.name, "mean", self.mean))
        self._keep("covariance", _finite(self.name, "covariance", self.covariance))
        self._check_start(mean)
        clock = "time" if self.truth_time is None else "truth_time"
        moments = time if self.truth_time is None else _clock(self.name, clock, self.truth_time)
        self._keep("truth_time", moments)
        truth = {key: _finite(self.name, f"truth[{key!r}]", column) for key, column in self.truth.items()}
        for key, column in truth.items():
            if column.shape != moments.shape:
                raise self.wrong(
                    f"truth[{key!r}] has shape {column.shape}, but {clock} has {len(moments)} values; "
                    "pass one value for each time"
                )
        object.__setattr__(self, "truth", truth)
        measured = ~np.isnan(measurements)
        if not measured.any(axis=1).all():
            row = int(np.argmin(measured.any(axis=1)))
            raise self.wrong(f"measurements[{row}] has no value, only nan; omit the row")
        for i in range(measurements.shape[1]):
            _check_overlap(self.name, f"measurements[:, {i}]", fixes[measured[:, i]], time)

    def wrong(self, what: str) -> InputError:
        return _wrong(self.name, what)

    def _keep(self, name: str, column: Array) -> Array:
        column.setflags(write=False)
        object.__setattr__(self, name, column)
        return column

    def _check_start(self, mean: Array) -> None:
        if mean.ndim != 1:
            raise self.wrong(f"mean has shape {mean.shape}; pass one value for each state")
        n = len(mean)
        if self.covariance.shape != (n, n):
            raise self.wrong(
                f"covariance has shape {self.covariance.shape}; pass a matrix of shape ({n}, {n}) for {n} states"
            )
        try:
            np.linalg.cholesky(self.covariance)
            sound = np.allclose(self.covariance, self.covariance.T, rtol=1e-9, atol=0)
        except np.linalg.LinAlgError:
            sound = False
        if not sound:
            raise self.wrong(
                "covariance is not symmetric and positive definite; pass for example a diagonal covariance "
                "with positive variances"
            )


def _wrong(log: str, what: str) -> InputError:
    return InputError(f"log {log}: {what}")


def _finite(log: str, name: str, values: ArrayLike | None, *, absent: bool = False) -> Array:
    """Return a copy as an array of finite numbers; NaN is allowed if ``absent`` is True."""
    try:
        column = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise _wrong(log, f"{name} is not an array of numbers; convert it to floats") from None
    bad = np.argwhere(np.isinf(column) if absent else ~np.isfinite(column))
    if len(bad):
        index = ", ".join(str(i) for i in bad[0])
        value = column[tuple(bad[0])]
        raise _wrong(log, f"{name}[{index}] is {value:g}; correct the value, or omit the row")
    return column


def _clock(log: str, name: str, values: ArrayLike | None) -> Array:
    time = _finite(log, name, values)
    if time.ndim != 1 or not len(time):
        raise _wrong(log, f"{name} has shape {time.shape}; pass one time, in s, for each row")
    late = np.flatnonzero(np.diff(time) <= 0)
    if len(late):
        i = int(late[0]) + 1
        raise _wrong(
            log,
            f"{name}[{i}] = {time[i]:g} s does not come after {time[i - 1]:g} s; sort the rows by time and delete "
            "repeated rows",
        )
    return time


def _table(log: str, name: str, values: ArrayLike, clock: str, length: int, *, absent: bool = False) -> Array:
    table = _finite(log, name, values, absent=absent)
    table = table[:, np.newaxis] if table.ndim == 1 else table
    if table.ndim != 2 or len(table) != length:
        raise _wrong(
            log,
            f"{name} has shape {np.shape(values)}, but {clock} has {length} values; pass one row for each",
        )
    return table


def _check_overlap(log: str, name: str, moments: Array, time: Array) -> None:
    if not len(moments):
        raise _wrong(
            log,
            f"{name} has no value, only nan; omit this sensor and its elements of h and measurement_noise",
        )
    if not np.any((moments >= time[0]) & (moments <= time[-1])):
        raise _wrong(
            log,
            f"{name} has no value within time = {time[0]:g} to {time[-1]:g} s; convert all times to one clock",
        )


@dataclass(frozen=True, eq=False)
class FilterSteps:
    """Steps of a filter over a log. The first step has length zero, for a measurement at the first time."""

    dt: Array  # (k,), s
    source: NDArray[np.int64]  # (k,), row of ``inputs`` for each step
    updates: NDArray[np.int64]  # (k,), row of ``measurements`` for the update at the step's end, or -1
    records: NDArray[np.int64]  # (k,), row of the log's ``time`` at which the step ends, or -1
    inputs: Array  # (i, u)
    measurements: Array  # (f, m), within the log's time; NaN: no value
    measurement_time: Array  # (f,), s
    mean: Array  # (n,), at the start
    covariance: Array  # (n, n), at the start


def build_steps(log: Log) -> FilterSteps:
    usable = (log.measurement_time >= log.time[0]) & (log.measurement_time <= log.time[-1])
    moments = log.measurement_time[usable]
    ends = np.union1d(log.time, moments)
    return FilterSteps(
        dt=np.diff(ends, prepend=ends[0]),
        source=np.searchsorted(log.time, ends).astype(np.int64),  # the first input at or after the step's end
        updates=_rows(moments, ends),
        records=_rows(log.time, ends),
        inputs=log.inputs if log.inputs is not None else np.empty((len(log.time), 0)),
        measurements=log.measurements[usable],
        measurement_time=moments,
        mean=log.mean,
        covariance=log.covariance,
    )


def _rows(times: Array, ends: Array) -> NDArray[np.int64]:
    """Return the index in ``times`` of each element of ``ends``; -1 if ``times`` does not contain the element."""
    known = np.isin(ends, times)
    return np.where(known, np.cumsum(known) - 1, -1).astype(np.int64)
