"""outage-lstm: a filter that, in an outage, absorbs what a network makes of the IMU.

The network sees windows of the IMU, and says how far the car came in the last second, forward and left, and how sure
it is: the faster a car drives, the more it shakes, and the more it turns for the same lateral acceleration. What it
says is absorbed as `relative` tells. It is not told the filter's own speed: a network that is says it back, and what
is then absorbed is what the filter believed already.

Its errors last, for the road and the car do: they are taken for Gauss-Markov processes. While there are fixes they
are seen, as what the filter's own velocity says otherwise; in an outage the last one seen is taken off, fading. What
remains of them is not white either, as a filter believes, and a filter that was tuned on fixes is often too sure of
its velocity when they stay away. So two factors, of the forecasts' variance and of the velocity's Q in an outage, are
those with which hidden fixes of drives that the network was not trained on are likeliest. Where that is not plainly
better than the filter alone, nothing is absorbed, and the filter remains as it was.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.compiled.layout import R
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recording import SAMPLES, Recording
from sigmaswarm.filters.replay import Replay
from sigmaswarm.learned.cells import Weights, head, lstm, new_weights
from sigmaswarm.learned.outages import HORIZON, Windows, outage_windows
from sigmaswarm.learned.relative import Begin, Displacements

NAME = "outage-lstm"
VELOCITY_Q = [R.Q_U, R.Q_V]
LEAST_STD, MOST_STD = 0.02, 20.0
"""m: between which a network may be sure of a displacement over a second."""


@dataclass(frozen=True, eq=False)
class OutageLstm:
    """A trained network.

    Attributes
    ----------
    axes : tuple of str
        Of the IMU, those that it sees.
    window : float
        s that it looks back.
    weights : mapping of str to ndarray
        See `cells`; and ``center``, ``spread`` (f,) of the features, ``usual``, ``scale`` (2,) m of what it says.
        ``kept`` (2,) and ``lasts`` (2,) s: an error of one moment is, t s later, kept exp(-t / lasts) of it.
    inflation : float
        The factor of its variances; inf: nothing is absorbed.
    unsure : float
        The factor of the velocity's Q in outages.
    """

    axes: tuple[str, ...]
    window: float
    weights: Mapping[str, Array]
    inflation: float = 1.0
    unsure: float = 1.0

    def told(self, features: Array) -> tuple[Array, Array]:
        """Displacements (k, 2), m forward and left, and their variances (k, 2), m2, of the IMU alone."""
        said = said_of(np, self.weights, features)
        std = np.clip(np.exp(said[:, 2:]) * self.weights["scale"], LEAST_STD, MOST_STD)
        return self.weights["usual"] + said[:, :2] * self.weights["scale"], std**2

    def remains(self, age: Any) -> Any:
        """How much of an error is still there after ``age`` s, (..., 2)."""
        return self.weights["kept"] * np.exp(-np.asarray(age)[..., np.newaxis] / self.weights["lasts"])

    def forecasts(self, windows: Windows) -> dict[int, "Forecast"]:
        """What it says at the ends of windows, by the numbers of these samples."""
        moved, variance = self.told(windows.features)
        before, _ = self.told(windows.features_at_first)
        each = zip(
            *(windows.begin.tolist(), windows.end.tolist(), windows.first.tolist(), windows.age.tolist()),
            *(moved, variance, before),
            strict=True,
        )
        return {end: Forecast(begin, first, age, *said) for begin, end, first, age, *said in each}

    def forecast(self, asked: "Forecast", velocity: Array) -> tuple[Array, Array]:
        """A displacement (2,), m forward and left, and its variance (2,), m2, given the filter's at the last fix."""
        left = self.remains(asked.age)
        moved = asked.moved + left * (HORIZON * velocity - asked.before)
        return moved, self.inflation * (asked.variance * (1.0 - left**2) + LEAST_STD**2)


@dataclass(frozen=True, eq=False)
class Forecast:
    """What a network says of a window in an outage.

    Attributes
    ----------
    begin, first : int
        The samples at which it begins, and behind the last fix.
    age : float
        s from ``first`` to its end.
    moved, variance : (2,) m, m2
    before : (2,) m
        What it said at ``first``.
    """

    begin: int
    first: int
    age: float
    moved: Array
    variance: Array
    before: Array


def said_of(xp: Any, weights: Weights, features: Any) -> Any:
    """What a network says of features (k, STEPS, f): displacements and ln std, (k, 4)."""
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


def untrained(
    rng: np.random.Generator, axes: tuple[str, ...], window: float, units: int, features: Array, moved: Array
) -> OutageLstm:
    """A network to begin with; ``features`` (k, STEPS, f) and ``moved`` (k, 2), m, set its scales."""
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


class OutageRun(Recording):
    """A filter over a replay whose displacements in outages a network forecasts.

    With no outage its pieces have the bits of `Recording`.

    Parameters
    ----------
    replay, parameters, samples, recover
        As of `Recording`.
    network : OutageLstm
    windows : Windows, optional
        Of `outage_windows`, where they are known already.

    Attributes
    ----------
    initial : InitialState
    absorbed, turned_away : int
        Displacements, so far.
    """

    def __init__(
        self,
        replay: Replay,
        parameters: FilterParameters,
        network: OutageLstm,
        *,
        samples: int = SAMPLES,
        recover: bool = False,
        windows: Windows | None = None,
    ) -> None:
        super().__init__(replay, parameters, samples=samples, recover=recover)
        self.initial = replay.initial
        self.absorbed = self.turned_away = 0
        self._displacements = Displacements(replay, parameters)
        self._network, self._done = network, 0
        self._begin: dict[int, Begin] = {}
        self._velocity: dict[int, Array] = {}
        self._own_q = self._rows[0, VELOCITY_Q].copy()
        self._asked: dict[int, Forecast] = {}
        self._marks = np.empty(0, dtype=np.intp)
        if np.isfinite(network.inflation):
            if windows is None:
                windows = outage_windows(replay.timeline, axes=network.axes, window=network.window)
            self._asked = network.forecasts(windows)
            self._marks = np.unique(np.concatenate([windows.begin, windows.end, windows.first, windows.over]))
        self._begins = {asked.begin for asked in self._asked.values()}
        self._firsts = {asked.first for asked in self._asked.values()}
        self._over = set() if windows is None else set(windows.over.tolist())

    def _run_to(self, stops: NDArray[np.intp], record: Array) -> NDArray[np.bool_]:
        first, self._done = self._done, self._done + len(stops)
        low, high = np.searchsorted(self._marks, [first, self._done])
        lost, row = np.zeros(len(stops), dtype=np.bool_), 0
        for mark in (self._marks[low:high] - first).tolist():
            lost[row : mark + 1] = super()._run_to(stops[row : mark + 1], record[row : mark + 1])
            self._look_at(first + mark, int(stops[mark]), record[mark], lost=bool(lost[mark]))
            row = mark + 1
        if row < len(stops):
            lost[row:] = super()._run_to(stops[row:], record[row:])
        return lost

    def _look_at(self, sample: int, stop: int, record: Array, *, lost: bool) -> None:
        """Absorb the displacement that ends at a sample, and keep what one needs that begins there."""
        asked = self._asked.get(sample)
        if asked is not None and not lost:
            velocity, begin = self._velocity.get(asked.first), self._begin.pop(asked.begin, None)
            if velocity is None or begin is None:
                return
            moved, variance = self._network.forecast(asked, velocity)
            if self._displacements.absorb(begin, self._rows[0], stop, moved, np.diag(variance)):
                record[:-1, 0] = self._rows[0, self._state, 0]
                self.absorbed += 1
            else:
                self.turned_away += 1
            self._rows[0, VELOCITY_Q] = self._network.unsure * self._own_q
        if sample in self._over:
            self._rows[0, VELOCITY_Q] = self._own_q
        if sample in self._firsts and not lost:
            self._velocity[sample] = body_velocity(self._rows[0, : THETA + 1, 0], self._heading)
        if sample in self._begins and not lost:
            self._begin[sample] = Begin(self._rows[0].copy(), self._place.copy())

    @property
    def _heading(self) -> float:
        return float(self._estimate()[0][THETA])

    def _reset(self, start: InitialState) -> None:
        super()._reset(start)
        self._begin, self._velocity = {}, {}  # of the filter that was lost


def body_velocity(state: Array, theta: float) -> Array:
    """Velocity forward and left, (2,) m/s."""
    c, s = np.cos(theta), np.sin(theta)
    return np.array([c * state[2] + s * state[3], c * state[3] - s * state[2]])


def calibrated(network: OutageLstm, inflation: float, unsure: float) -> OutageLstm:
    """The same, as sure of itself and of the filter as told."""
    return replace(network, inflation=inflation, unsure=unsure)
