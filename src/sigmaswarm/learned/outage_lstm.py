"""outage-lstm: a filter that uses a network's forecasts of displacements in outages.

The network estimates the displacement in the last second, forward and left, from windows of IMU samples. The windows
contain information on the speed, since vibration and lateral acceleration depend on it. The filter's speed is not an
input, since the update would use it twice.

Errors of the forecasts are modeled as Gauss-Markov processes. In an outage, the error at the last fix, multiplied by a
decay factor, is subtracted. Two other factors are chosen to maximize the likelihood of hidden fixes on validation data.
A factor on the variance of the forecasts accounts for the remaining correlation in time. A factor on the Q of the
velocity is needed, since the velocity covariance of a filter that was tuned with fixes is often too small in an outage.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.tables import Indices
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.filter_run import InterruptibleRun
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.geodesy import STANDARD_GRAVITY
from sigmaswarm.learned.displacements import Displacements, DisplacementStart, to_body_axes
from sigmaswarm.learned.fitting import Weights, head, lstm, new_weights

HORIZON = 1.0  # s, duration of a displacement
OUTAGE_AFTER = 2.0  # s from the last fix to the start of an outage; receivers have a rate of 1 Hz or more
WINDOW_STEPS = 40  # number of steps to which a window is resampled
_VIBRATION_OFFSET = 1e-3  # m/s2, added to the standard deviation before the logarithm; for a gyro 1e-4 rad/s


@dataclass(frozen=True, eq=False)
class Windows:
    """Displacements in the outages of a drive, and inputs of the network. Samples are IMU samples after the start."""

    begin: Indices  # (k,), samples at the start of a displacement
    end: Indices  # (k,), samples at its end
    features: Array  # (k, WINDOW_STEPS, f), inputs at ``end``, see `features_at`
    first: Indices  # (k,), samples after the last fix
    features_at_first: Array  # (k, WINDOW_STEPS, f), inputs at ``first``
    age: Array  # (k,) s, time from ``first`` to ``end``
    over: Indices  # samples after the fixes that end the outages


def outage_windows(line: Timeline, *, axes: Sequence[str], window: float) -> Windows:
    """Divide the outages of a drive into windows of `HORIZON` s. Hidden fixes do not end an outage.

    An outage begins `OUTAGE_AFTER` s after a fix. Inputs are the ``axes`` of the IMU over ``window`` s.
    """
    time = line.imu_time
    fix_times = np.concatenate([[line.start], line.end[line.updates]])
    spans = [
        (fix, until)
        for fix, until in zip(fix_times, np.append(fix_times[1:], np.inf), strict=True)
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
    begin, end, first = (np.concatenate(parts) for parts in (begins, ends, firsts))
    over = np.searchsorted(time, [until for _, until in spans if until <= time[-1]])
    features, at_first = (features_at(line, at, axes=axes, window=window) for at in (end, first))
    return Windows(begin, end, features, first, at_first, time[end] - time[first], over)


def pairs_of(time: Array, after: float, until: float, every: float) -> tuple[Indices, Indices]:
    """Return the first and the second samples, (k,), of pairs `HORIZON` apart. A pair starts every ``every`` s."""
    first, stop = np.searchsorted(time, [after, until])
    grid = np.arange(float(time[first]), float(time[stop - 1]) + 1e-9, every) if stop > first else np.empty(0)
    at = np.searchsorted(time[:stop], grid - 1e-9)
    per = round(HORIZON / every)
    begin, end = at[:-per], at[per:]
    near = time[end] - time[begin] < 1.5 * HORIZON  # no pairs across a gap of the IMU
    return begin[near], end[near]


def features_at(line: Timeline, end: Indices, *, axes: Sequence[str], window: float) -> Array:
    """Return the inputs of the network at the samples ``end``, (k, WINDOW_STEPS, 2 n) for n ``axes``.

    The inputs are the mean (m/s2, rad/s) and the logarithm of the standard deviation in each step of the last
    ``window`` s. The standard deviation shows the vibration, which grows with the speed of a car.
    """
    time = line.drive.imu.time
    edges = line.imu_time[end][:, np.newaxis] + np.linspace(-window, 0.0, WINDOW_STEPS + 1)
    means: list[Array] = []
    vibrations: list[Array] = []
    for axis in axes:
        values: Array | None = getattr(line.drive.imu, axis)
        if values is None:
            raise InputError(
                f"{line.drive.name}: imu.csv has no {axis}, an input of the network; train a network on drives of this "
                "car"
            )
        values = values - (STANDARD_GRAVITY if axis == "az" else 0.0)
        mean = _means(time, values, edges)
        variance = _means(time, values**2, edges) - mean**2
        means.append(mean)
        quiet = _VIBRATION_OFFSET if axis.startswith("a") else 0.1 * _VIBRATION_OFFSET
        vibrations.append(np.log(np.sqrt(np.maximum(variance, 0.0)) + quiet))
    return np.stack([*means, *vibrations], axis=-1)


def _means(time: Array, values: Array, edges: Array) -> Array:
    """Return the means (k, m) of a signal between times ``edges`` (k, m + 1), s.

    If both times precede the signal, the mean is the first value of the signal.
    """
    whole = cumulative_trapezoid(values, time, initial=0)
    inside = np.maximum(edges, time[0])
    length = np.diff(inside, axis=1)
    sums = np.diff(np.interp(inside, time, whole), axis=1)
    return np.where(length > 0.0, sums / np.where(length > 0.0, length, 1.0), values[0])


NAME = "outage-lstm"
VELOCITY_Q = [R.Q_U, R.Q_V]
MIN_STD, MAX_STD = 0.02, 20.0  # m, bounds of the standard deviation of a displacement over a second


class DisplacementForecast(NamedTuple):
    """Outputs of a network for a displacement in an outage."""

    begin: int  # index of the IMU sample at the start of the displacement
    first: int  # index of the first IMU sample after the last fix
    age: float  # s, time from ``first`` to the end of the displacement
    moved: Array  # (2,) m, the displacement
    variance: Array  # (2,) m2, its variance
    before: Array  # (2,) m, estimate of the displacement in the second before ``first``


@dataclass(frozen=True, eq=False)
class OutageLstm:
    """A trained network. Its inputs are ``axes`` of the IMU over ``window`` s.

    - ``weights``: weights of `cells`; mean ``center`` and standard deviation ``spread`` (f,) of the features; mean
      ``usual`` and standard deviation ``scale`` (2,) of the displacements, m; ``kept`` (2,) and ``lasts`` (2,), s: the
      errors have the autocorrelation kept exp(-t / lasts).
    - ``inflation``: factor on the variances of forecasts; if it is infinite, forecasts are not used.
    - ``unsure``: factor on the velocity's Q in outages.
    """

    axes: tuple[str, ...]
    window: float
    weights: Mapping[str, Array]
    inflation: float = 1.0
    unsure: float = 1.0

    def displacements(self, features: Array) -> tuple[Array, Array]:
        """Estimate displacements (k, 2), m forward and left, and variances (k, 2), m2, from the IMU alone."""
        raw = outputs_of(np, self.weights, features)
        std = np.clip(np.exp(raw[:, 2:]) * self.weights["scale"], MIN_STD, MAX_STD)
        return self.weights["usual"] + raw[:, :2] * self.weights["scale"], std**2

    def remains(self, age: Any) -> Any:
        """Return the fraction of an error, (..., 2), that remains after ``age`` s."""
        return self.weights["kept"] * np.exp(-np.asarray(age)[..., np.newaxis] / self.weights["lasts"])

    def forecasts(self, windows: Windows) -> dict[int, DisplacementForecast]:
        """Return the forecast of each window, by the index of the window's last sample."""
        numbers = (column.tolist() for column in (windows.begin, windows.first, windows.age))
        outputs = *self.displacements(windows.features), self.displacements(windows.features_at_first)[0]
        return dict(zip(windows.end.tolist(), map(DisplacementForecast, *numbers, *outputs), strict=True))

    def corrected(self, forecast: DisplacementForecast, velocity: Array) -> tuple[Array, Array]:
        """Subtract the error at the last fix, where the vehicle has the velocity ``velocity`` (2,), m/s in body axes.

        Return the displacement (2,), m, and its variance (2,), m2.
        """
        share = self.remains(forecast.age)
        moved = forecast.moved + share * (HORIZON * velocity - forecast.before)
        return moved, self.inflation * (forecast.variance * (1.0 - share**2) + MIN_STD**2)


def outputs_of(xp: Any, weights: Weights, features: Any) -> Any:
    """Return displacements in units of ``scale`` and ln of their standard deviations, (k, 4); inputs (k, steps, f)."""
    inputs = (features - weights["center"]) / weights["spread"]
    units = weights["hidden"].shape[0]
    state = xp.zeros((len(inputs), units)), xp.zeros((len(inputs), units))
    if xp is np:
        for step in range(inputs.shape[1]):
            state = lstm(np, weights, state, inputs[:, step])
    else:
        from jax import lax

        state, _ = lax.scan(lambda s, x: (lstm(xp, weights, s, x), None), state, xp.swapaxes(inputs, 0, 1))
    return head(weights, state[0])


def new_network(
    rng: np.random.Generator, axes: tuple[str, ...], window: float, units: int, features: Array, moved: Array
) -> OutageLstm:
    """Return a new network; ``features`` (k, WINDOW_STEPS, f) and ``moved`` (k, 2) in m determine its scales."""
    flat = features.reshape(-1, features.shape[-1])
    scales = {
        "center": flat.mean(axis=0),
        "spread": np.maximum(flat.std(axis=0), 1e-4),
        "usual": moved.mean(axis=0),
        "kept": np.zeros(2),
        "lasts": np.ones(2),
        "scale": np.maximum(moved.std(axis=0), 0.05),
    }
    return OutageLstm(axes, window, {**new_weights(rng, 4, features.shape[-1], units, 4), **scales})


class OutageRun(InterruptibleRun):
    """Run of a filter over a drive with forecasts of displacements in outages.

    Without outages, the results equal those of `FilterRun`. ``accepted`` and ``rejected`` count displacements.
    """

    def __init__(
        self,
        drive_pass: FilterPass,
        parameters: FilterParameters,
        network: OutageLstm,
        *,
        windows: Windows | None = None,
        **options: Any,
    ) -> None:
        super().__init__(drive_pass, parameters, **options)
        self.accepted = self.rejected = 0
        self._displacements = Displacements(drive_pass, parameters)
        self._network = network
        self._begin: dict[int, DisplacementStart] = {}
        self._velocity: dict[int, Array] = {}
        self._own_q = self._rows[0, VELOCITY_Q].copy()
        self._forecasts: dict[int, DisplacementForecast] = {}
        self._marks = np.empty(0, dtype=np.intp)
        if np.isfinite(network.inflation):
            if windows is None:
                windows = outage_windows(drive_pass.timeline, axes=network.axes, window=network.window)
            self._forecasts = network.forecasts(windows)
            self._marks = np.unique(np.concatenate([windows.begin, windows.end, windows.first, windows.over]))
        self._begins = {forecast.begin for forecast in self._forecasts.values()}
        self._firsts = {forecast.first for forecast in self._forecasts.values()}
        self._over = set() if windows is None else set(windows.over.tolist())

    def _at(self, sample: int, stop: int, record: Array, *, lost: bool) -> None:
        """Update with the displacement that ends at a sample. Store the state if a displacement begins there."""
        forecast = self._forecasts.get(sample)
        if forecast is not None and not lost:
            velocity, begin = self._velocity.get(forecast.first), self._begin.pop(forecast.begin, None)
            if velocity is None or begin is None:
                return
            moved, variance = self._network.corrected(forecast, velocity)
            if self._displacements.update(begin, self._rows[0], stop, moved, np.diag(variance)):
                record[:-1, 0] = self._rows[0, self._state, 0]
                self.accepted += 1
            else:
                self.rejected += 1
            self._rows[0, VELOCITY_Q] = self._network.unsure * self._own_q
        if sample in self._over:
            self._rows[0, VELOCITY_Q] = self._own_q
        if sample in self._firsts and not lost:
            _, _, east, north = self._rows[0, :4, 0]
            self._velocity[sample] = to_body_axes(east, north, self._estimate()[0][THETA])
        if sample in self._begins and not lost:
            self._begin[sample] = DisplacementStart(self._rows[0].copy(), self._cursor.copy())

    def _reset(self, start: InitialState) -> None:
        super()._reset(start)
        self._begin, self._velocity = {}, {}  # states of the diverged filter
