"""`LiveModel`: a Kalman filter that processes one sample at a time, for a user's model."""

from bisect import insort
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters.custom.log import FilterSteps, Log, build_steps
from sigmaswarm.filters.custom.model import Model, as_covariance
from sigmaswarm.filters.custom.run import check, kernel_of, run_kernel
from sigmaswarm.filters.live import LiveState
from sigmaswarm.geodesy import wrap_angle

State = tuple[Array, Array, Array]  # mean (n,), covariance (n, n), runs of outliers (m, 2)
Timed = tuple[float, Array]  # a measurement (m,) and its time, s


@dataclass(eq=False)
class _Sample:
    """Inputs of a step, the state before the step, and the measurements within the step."""

    before: float  # s, start of the step
    state: State
    time: float  # s, end of the step
    inputs: Array
    measurements: list[Timed]


class LiveModel:
    """Kalman filter for a user's model; it processes one sample at a time.

    As in a `Log`, the inputs at t_k belong to the step from t_(k-1) to t_k, so a measurement waits for the next inputs.
    If a measurement is at most ``history`` seconds late, the filter returns to the step that contains the measurement,
    and processes this step and the later steps again. The state equals the result of `run_model` for the same data in
    time order.

    Parameters
    ----------
    model : Model
    parameters : mapping of str to float
        See `run_model`.
    time : float
        Time of the start of the filter, s.
    mean, covariance : array_like, shapes (n,), (n, n)
        State estimate at the start.
    n_inputs : int
        Number of inputs of f.
    history : float
        Largest delay of a measurement, s.

    Attributes
    ----------
    too_late : int
        Number of measurements that were ignored because they were more than ``history`` seconds late or earlier than
        the start.

    Raises
    ------
    InputError
        If model, parameters and start do not match, or ``history`` is negative or not finite.
    """

    def __init__(
        self,
        model: Model,
        parameters: Mapping[str, float],
        *,
        time: float,
        mean: ArrayLike,
        covariance: ArrayLike,
        n_inputs: int = 0,
        history: float = 1.0,
    ) -> None:
        if not 0 <= history < np.inf:
            raise InputError(f"history = {history} s: pass a number of seconds, 0 or more")
        m = len(as_covariance(model.measurement_noise(model.values(parameters))))
        start = Log(
            name="live",
            time=np.array([time, time + 1.0]),
            measurement_time=np.array([time]),
            measurements=np.zeros((1, m)),
            mean=np.asarray(mean),
            covariance=np.asarray(covariance),
            inputs=np.zeros((2, n_inputs)),
        )
        check(model, start)
        self.model, self.parameters, self.history, self.too_late = model, dict(parameters), history, 0
        self._kernel = kernel_of(model, build_steps(start))
        self._time, self._state = float(time), (start.mean.copy(), start.covariance.copy(), np.zeros((m, 2)))
        self._m, self._n_inputs = m, n_inputs
        self._start, self._waiting = self._time, list[Timed]()
        self._samples = deque[_Sample]()

    def predict(self, t: float, inputs: ArrayLike = ()) -> None:
        """Process the inputs of the step to time t, s. They are ignored if t is not after the last step.

        Raises
        ------
        InputError
            If the number of inputs is wrong, an input is not finite, or t is not numeric.
        """
        u, t = _numbers("inputs", inputs, self._n_inputs), _seconds(t)
        if not self._time < t < np.inf:
            return
        now = [measured for measured in self._waiting if measured[0] <= t]
        self._waiting = self._waiting[len(now) :]
        sample = _Sample(self._time, self._state, t, u, now)
        self._samples.append(sample)
        while self._samples[0].time < t - self.history:
            self._samples.popleft()
        self._process(sample)

    def update(self, t: float, measurement: ArrayLike) -> bool:
        """Process a measurement, shape (m,), in the format of `Model.h`. An element without a value is NaN.

        Measurements of several sensors with the same time may be passed one after the other.

        Returns
        -------
        bool
            False if the measurement was ignored because it is too late, before the start of the filter, repeated, or
            without a value.

        Raises
        ------
        InputError
            If the number of elements is wrong, an element is infinite, or t is not numeric.
        """
        z, t = _numbers("measurement", measurement, self._m, absent=True), _seconds(t)
        if t > self._time or (t == self._time and not self._samples):
            return _store(self._waiting, t, z)
        late = [sample for sample in self._samples if t <= sample.time]
        if not late or not (t > late[0].before or t == late[0].before == self._start):
            self.too_late += 1
            return False
        if not _store(late[0].measurements, t, z):
            return False
        self._time, self._state = late[0].before, late[0].state
        for sample in late:
            sample.state = self._state
            self._process(sample)
        return True

    def _process(self, sample: _Sample) -> None:
        measurements, now, (mean, covariance, runs) = sample.measurements, sample.time, self._state
        ends = np.array([*(t for t, _ in measurements), now])
        steps = FilterSteps(
            dt=np.diff(ends, prepend=self._time),
            source=np.zeros(len(ends), dtype=np.int64),
            updates=np.where(np.arange(len(ends)) < len(measurements), np.arange(len(ends)), -1),
            records=np.where(ends == now, 0, -1),
            inputs=sample.inputs[np.newaxis],
            measurements=np.array([z for _, z in measurements]).reshape(-1, self._m),
            measurement_time=ends[: len(measurements)],
            mean=mean,
            covariance=covariance,
        )
        runs = runs.copy()
        run = run_kernel(self.model, self._kernel, steps, self.parameters, covariances=True, runs=runs)
        self._time, self._state = now, (run.mean[0], run.covariance[0], runs)

    @property
    def state(self) -> LiveState:
        """State estimate after the last inputs and all earlier measurements; NaN after a failure."""
        (mean, covariance, _), angles = self._state, self.model.indices(self.model.angles)
        mean = mean.copy()
        mean[angles] = wrap_angle(mean[angles])
        return LiveState(self._time, mean, covariance.copy(), bool(np.isnan(mean).any()))


def _numbers(name: str, values: ArrayLike, size: int, *, absent: bool = False) -> Array:
    try:
        numbers = np.array(values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise InputError(f"{name} contains values that are not numbers; pass floats") from None
    if len(numbers) != size:
        raise InputError(f"{name} has {len(numbers)} numbers; pass {size}")
    if (np.isinf(numbers) if absent else ~np.isfinite(numbers)).any():
        raise InputError(f"{name} contains a value that is not finite; omit the sample")
    return numbers


def _seconds(t: float) -> float:
    try:
        return float(t)
    except (TypeError, ValueError):
        raise InputError(f"t = {t!r} is not a number; pass seconds") from None


def _store(stored: list[Timed], t: float, z: Array) -> bool:
    """Insert a measurement by time, or merge it with one of the same time. Return False if no element is new."""
    for k, (time, known) in enumerate(stored):
        if time == t:
            both = np.where(np.isnan(known), z, known)
            stored[k] = t, both
            return bool((~np.isnan(both)).sum() > (~np.isnan(known)).sum())
    if np.isnan(z).all() or not np.isfinite(t):
        return False
    insort(stored, (t, z), key=itemgetter(0))
    return True
