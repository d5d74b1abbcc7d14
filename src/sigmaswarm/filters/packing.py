"""Parameter sets and states in the rows and lanes of the compiled kernel, and what comes out of them.

What is done once a drive and a chunk costs time beside a kernel that takes 0.2 ms, and it holds Python's lock while
other threads wait: so it is done for all drives together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.compilation import cached
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters import tilted
from sigmaswarm.filters.compiled.layout import (
    CONSTANT_ROWS,
    CONSTANTS,
    MEAN,
    N_KEPT,
    N_STATE,
    R,
    lanes_for,
    most_lanes,
    state_rows,
)
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import STANDSTILL_RATE_NOISE, Switches, starts_of, switches
from sigmaswarm.filters.student import OUTLIERS_SPAN

N_SUMS = R.LOG_DET - R.SQ_POSITION + 1
"""Sums that are shown: those of `replay.Sums`, in its order."""
_SHOWN = slice(R.SQ_POSITION, R.LOG_DET + 1)


@dataclass(frozen=True, eq=False)
class Chunk:
    """Up to `most_lanes` parameter sets of one model and with the same switches, packed once for all replays."""

    sets: tuple[FilterParameters, ...]
    _constants: dict[float, Array] = field(default_factory=dict[float, Array])

    def __post_init__(self) -> None:
        p = self.sets[0]
        kinds = MODELS[p.model].kinds
        if p.kind not in kinds:
            raise InputError(
                f"{p.model} is not compiled as {p.kind}; take kind {' or '.join(kinds)}, or run_textbook"
            )

    def constants(self, nominal_interval: float) -> Array:
        """As `pack_constants`."""
        if nominal_interval not in self._constants:
            self._constants[nominal_interval] = pack_constants(self.sets, nominal_interval)
        return self._constants[nominal_interval]

    @property
    def model(self) -> ModelName:
        """Of all its sets."""
        return self.sets[0].model

    @cached_property
    def takes_accuracy(self) -> bool:
        """Whether any of the sets looks at what the receiver states of its fixes."""
        return any(p.accuracy_scale is not None for p in self.sets)

    @cached_property
    def plausible(self) -> NDArray[np.bool_]:
        """See `plausible`; shape (n_sets,)."""
        return np.array([plausible(p) for p in self.sets], dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class Packed:
    """Parameter sets in chunks for the kernel, and where each chunk's sets stand among them all."""

    size: int
    chunks: tuple[tuple[NDArray[np.intp], Chunk], ...]


def pack(parameter_sets: Sequence[FilterParameters]) -> Packed:
    """Group parameter sets so that those of a chunk can run side by side."""
    groups: dict[tuple[str, Switches], list[int]] = {}
    for i, p in enumerate(parameter_sets):
        groups.setdefault((p.model, switches(p)), []).append(i)
    parts = [
        group[i : i + lanes]
        for (model, _), group in groups.items()
        for lanes in (most_lanes(model),)
        for i in range(0, len(group), lanes)
    ]
    return Packed(
        len(parameter_sets),
        tuple((np.array(part), Chunk(tuple(parameter_sets[i] for i in part))) for part in parts),
    )


def _lanes(n_sets: int) -> NDArray[np.intp]:
    """Which of n sets is in each lane: as many lanes as it takes, the last set again in those left."""
    return np.minimum(np.arange(lanes_for(n_sets)), n_sets - 1)


def pack_constants(parameter_sets: Sequence[FilterParameters], nominal_interval: float) -> Array:
    """The kernel's constants, shape (N_CONSTANTS, lanes), of a chunk's sets.

    ``nominal_interval`` (s) is the drive's: Q is converted where a set refers to another one.
    """
    numbers = np.array([_numbers(p) for p in parameter_sets])
    of = _Numbers(*numbers.T)  # each (n_sets,)
    n = parameter_sets[0].n_states
    gamma2 = of.alpha**2 * (n + of.kappa)
    per_interval = nominal_interval / np.where(of.interval > 0.0, of.interval, nominal_interval)
    q = per_interval * np.array([p.process_noise for p in parameter_sets]).T
    values = dict.fromkeys((f"Q_{letter}" for letter in MEAN), 0.0) | {
        **dict(zip((f"Q_{letter}" for letter in MEAN), q, strict=False)),
        "GAMMA": (1.0 - of.extended) * np.sqrt(gamma2),
        "SHORTENS": (of.extended - 1.0) * 2 / gamma2,
        "SPREAD": of.alpha**2 * (n + of.kappa - 1) + of.beta,
        "SECOND": 1.0 - of.extended,
        "RX": of.rx,
        "RY": of.ry,
        "R_VELOCITY": of.velocity,
        "R_LATERAL": of.lateral,
        "R_STANDSTILL": of.standstill,
        "R_ODOMETER": of.odometer,
        "ODOMETER_SCALE": 1 / of.odometer_scale,
        "ODOMETER_LATENCY": of.odometer_latency,
        "R_RATE": STANDSTILL_RATE_NOISE,
        "REAR_AXLE": of.rear_axle,
        "LATENCY": of.latency,
        "GATE": of.gate,
        "FORGETTING": np.where(of.adaptive == 1.0, of.forgetting, 1.0),
        "FADING": np.where(of.fading == 1.0, of.forgetting, -1.0),
        "FUZZY": np.where(of.fuzzy == 1.0, of.forgetting, -1.0),
        "WIDTH_RATIO": of.width_ratio,
        "WIDTH_TREND": of.width_trend,
        "GAIN_R": of.gain_r,
        "GAIN_Q": of.gain_q,
        "ACCURACY": of.accuracy,
        "DOF": of.dof,
        "PATIENCE": (OUTLIERS_SPAN - 1e-6) / nominal_interval,  # whatever rounding does to times since 1970
    }
    constants = np.empty((len(CONSTANTS), len(parameter_sets)))
    for row, name in zip(constants, CONSTANTS, strict=True):
        row[:] = values[name]
    return constants[:, _lanes(len(parameter_sets))]


class _Numbers(NamedTuple):
    """What the constants are made of: of one set, or columns of many. What a filter does not take is inf, or 0."""

    alpha: Any
    beta: Any
    kappa: Any
    interval: Any
    rx: Any
    ry: Any
    accuracy: Any
    dof: Any
    gate: Any
    latency: Any
    velocity: Any
    lateral: Any
    rear_axle: Any
    standstill: Any
    odometer: Any
    odometer_scale: Any
    odometer_latency: Any
    extended: Any
    adaptive: Any
    fading: Any
    fuzzy: Any
    forgetting: Any
    width_ratio: Any
    width_trend: Any
    gain_r: Any
    gain_q: Any


def _numbers(p: FilterParameters) -> _Numbers:
    rx, ry = p.measurement_noise
    return _Numbers(
        *(p.alpha, p.beta, p.kappa, p.nominal_interval or 0.0),
        *(rx, ry, p.accuracy_scale or 0.0, p.robust_dof or 0.0, _or_inf(p.gate), p.latency),
        *(_or_inf(p.velocity_noise), _or_inf(p.lateral_noise), p.rear_axle, _or_inf(p.standstill_noise)),
        *(_or_inf(p.odometer_noise), p.odometer_scale, p.odometer_latency),
        *(p.kind == "ekf", p.kind == "adaptive-ukf", p.kind == "strong-tracking-ukf", p.kind == "fuzzy-ukf"),
        *(p.forgetting, *p.fuzzy_widths, *p.fuzzy_gains),
    )


def _or_inf(variance: float | None) -> float:
    return math.inf if variance is None else variance


def start_rows(initial: Sequence[InitialState], nominal_intervals: Sequence[float], chunk: Chunk) -> Array:
    """All that a chunk's filters are at m starts, shape (m, N_KEPT, lanes); intervals (s) are the drives'."""
    model, bias_std = chunk.model, np.array([p.bias_std for p in chunk.sets])[_lanes(len(chunk.sets))]
    rows = np.zeros((len(initial), N_KEPT, len(bias_std)))
    for each, start, interval in zip(rows, initial, nominal_intervals, strict=True):
        mean, covariance = starts_of(start, MODELS[model], bias_std)
        each[:N_STATE] = pack_states(mean, covariance, model)
        each[R.HEADING] = mean[:, THETA]
        each[CONSTANT_ROWS] = chunk.constants(interval)
    rows[:, [R.DET, R.TAIL, R.OK]] = 1.0
    rows[:, [R.QUICK, R.SLOW, R.TIMES_R, R.TIMES_Q]] = 1.0
    rows[:, R.RECENT] = -1.0
    return rows


def pack_states(mean: Array, covariance: Array, model: ModelName) -> Array:
    """State rows (..., N_STATE, lanes) of means (..., lanes, n) and covariances (..., lanes, n, n)."""
    rows, columns = _upper(mean.shape[-1])
    state = np.zeros((*mean.shape[:-2], N_STATE, mean.shape[-2]))
    parts = [mean]
    if MODELS[model].tilts:
        parts = [mean.copy(), tilted.quaternion_of(mean)]
        parts[0][..., tilted.ATTITUDE] = 0.0  # the error's place
    packed = np.concatenate([*parts, covariance[..., rows, columns]], axis=-1)
    state[..., state_rows(model), :] = packed.swapaxes(-1, -2)
    return state


def unpack_states(state: Array, model: ModelName) -> tuple[Array, Array]:
    """Means (..., r, n) and covariances (..., r, n, n), as a filter has them, of its `state_rows`, (..., s, r)."""
    n = len(MODELS[model].states)
    rows, columns = _upper(n)
    mean, packed = state[..., :n, :].swapaxes(-1, -2).copy(), state[..., -len(rows) :, :].swapaxes(-1, -2)
    if MODELS[model].tilts:
        mean[..., tilted.ATTITUDE] = tilted.angles_of(state[..., n : n + 4, :].swapaxes(-1, -2))
    covariance = np.empty((*packed.shape[:-1], n, n))
    covariance[..., rows, columns] = packed
    covariance[..., columns, rows] = packed
    return mean, covariance


def believed(state: Array, model: ModelName) -> tuple[Array, Array]:
    """As `unpack_states`, with the covariance of the mean itself: of a tilted model's angles."""
    mean, covariance = unpack_states(state, model)
    tilts = MODELS[model].tilts
    return mean, tilts.as_angles(mean, covariance) if tilts else covariance


@cache
def _upper(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the upper triangle, column by column, as the kernel packs it."""
    columns, rows = np.tril_indices(n)
    return rows, columns


def unpack_sums(rows: Array, chunk: Chunk) -> tuple[Array, NDArray[np.bool_]]:
    """The columns of `Sums`, (9, m, n_sets), NaN where a set failed, and where one did, of final rows of m replays."""
    n_sets = len(chunk.sets)
    sound = _sound(rows, chunk.model)[:, :n_sets] & chunk.plausible
    return np.where(sound, rows[:, _SHOWN, :n_sets].swapaxes(0, 1), np.nan), ~sound


def _sound(rows: Array, model: ModelName) -> NDArray[np.bool_]:
    """Which lanes never failed and end with a positive definite covariance, shape (m, lanes)."""
    final = rows[:, state_rows(model)]
    finite = np.isfinite(final).all(axis=1) & np.isfinite(rows[:, _SHOWN]).all(axis=1)
    return finite & (rows[:, R.OK] == 1.0) & definite(unpack_states(final, model)[1])


def plausible(p: FilterParameters) -> bool:
    """With Q >= 0 and R > 0 nothing but rounding can make P indefinite; otherwise it may go unnoticed for long."""
    return min(p.process_noise) >= 0 and min(p.measurement_noise) > 0


def definite(covariance: Array) -> NDArray[np.bool_]:
    """Which of the covariances (..., n, n) are positive definite, but for rounding.

    The eigenvalues of the correlation lie above -1e-9 if, with 1e-9 added to its diagonal, all pivots are positive.
    """
    n = covariance.shape[-1]
    found = np.empty(covariance.shape[:-2], dtype=np.bool_)
    _find_definite(np.ascontiguousarray(covariance).reshape(-1, n, n), found.reshape(-1))
    return found


@cached(nogil=True, error_model="numpy")
def _find_definite(covariances: Array, found: NDArray[np.bool_]) -> None:
    n = covariances.shape[1]
    scale, a = np.empty(n), np.empty((n, n))
    for m in range(len(covariances)):
        p, sound = covariances[m], True
        for i in range(n):
            scale[i] = math.sqrt(p[i, i]) if p[i, i] > 0.0 else math.nan
            for j in range(n):
                sound &= math.isfinite(p[i, j])
        for i in range(n):
            for j in range(i, n):
                a[i, j] = p[i, j] / (scale[i] * scale[j])
            a[i, i] += 1e-9
        for k in range(n):
            sound &= a[k, k] > 0.0
            for i in range(k + 1, n):
                factor = a[k, i] / a[k, k]
                for j in range(i, n):
                    a[i, j] -= factor * a[k, j]
        found[m] = sound
