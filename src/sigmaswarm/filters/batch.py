"""Many parameter sets over many drives: packs records into the compiled kernel's arrays and back.

What is done once a drive and a chunk costs time beside a kernel that takes 0.2 ms, and it holds Python's lock while
other threads wait: so it is done for all drives together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled import lanes, run
from sigmaswarm.filters.parameters import FilterParameters

Array = NDArray[np.float64]

LATERAL_INTERVAL = 0.1
"""s between two looks at the lateral velocity: its error is not white, so more of them tell no more."""
STANDSTILL_INTERVAL = 0.1
"""s between two looks at the velocity at standstill."""
STANDSTILL_RATE_NOISE = np.radians(0.5) ** 2
"""rad2/s2: variance of the gyro around its bias while the car stands."""


@dataclass(frozen=True, eq=False)
class Targets:
    """Moments at which estimates are compared with a known position and heading.

    Attributes
    ----------
    rows : (m, 5)
        Weight of the later of the two estimates around the moment; x, y (m); theta (rad); 1 where the heading
        counts, else 0.
    end : (k,) int64
        How many targets lie before the end of each step of the time line.
    """

    rows: Array
    end: NDArray[np.int64]

    @classmethod
    def none(cls, timeline: Timeline) -> "Targets":
        """Nothing to compare with."""
        return cls(np.empty((0, 5)), np.zeros(len(timeline.dt), dtype=np.int64))

    @property
    def n_positions(self) -> int:
        """How many positions are compared."""
        return len(self.rows)

    @cached_property
    def n_headings(self) -> int:
        """How many headings are compared."""
        return int(self.rows[:, run.SCORES_HEADING].sum())


@dataclass(frozen=True, eq=False)
class Replay:
    """One pass over a drive, ready for any number of filters: where they start, step, and are compared."""

    timeline: Timeline
    initial: InitialState
    targets: Targets
    _arrays: dict[tuple[bool, bool, bool], "DriveArrays"] = field(default_factory=dict)  # pyright: ignore[reportUnknownVariableType]

    @cached_property
    def n_hidden(self) -> int:
        """How many fixes are hidden from the filter."""
        return int(self.timeline.hides.sum())

    def arrays(self, velocity: bool, lateral: bool, standstill: bool) -> "DriveArrays":
        """What the kernel reads of the drive, in its order; the flags depend on what a filter takes beside fixes."""
        taken = velocity, lateral, standstill
        if taken not in self._arrays:
            line, targets = self.timeline, self.targets
            flags = flags_of(line, *taken)
            self._arrays[taken] = line.steps, flags, line.fixes, line.lever, targets.rows, targets.end
        return self._arrays[taken]


DriveArrays = tuple[Array, NDArray[np.int64], Array, Array, Array, NDArray[np.int64]]
"""steps, flags, fixes, lever, targets and their ends: see `compiled.run.run_lanes`."""


@dataclass(frozen=True, eq=False)
class Chunk:
    """At most LANES parameter sets of one model and with the same switches, packed once for any number of replays."""

    sets: tuple[FilterParameters, ...]
    _constants: dict[float, Array] = field(default_factory=dict[float, Array])

    def constants(self, nominal_interval: float) -> Array:
        """As `pack_constants`."""
        if nominal_interval not in self._constants:
            self._constants[nominal_interval] = pack_constants(self.sets, nominal_interval)
        return self._constants[nominal_interval]

    @cached_property
    def plausible(self) -> NDArray[np.bool_]:
        """See `plausible`; shape (n_sets,)."""
        return np.array([plausible(p) for p in self.sets], dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class Batch:
    """Parameter sets in chunks for the kernel, and where each chunk's sets stand in the batch."""

    size: int
    chunks: tuple[tuple[NDArray[np.intp], Chunk], ...]


def pack(parameter_sets: Sequence[FilterParameters]) -> Batch:
    """Group parameter sets so that those of a chunk can run side by side."""
    groups: dict[tuple[str, bool, bool, bool], list[int]] = {}
    for i, p in enumerate(parameter_sets):
        groups.setdefault((p.model, *switches(p)), []).append(i)
    parts = [g[i : i + lanes.LANES] for g in groups.values() for i in range(0, len(g), lanes.LANES)]
    return Batch(
        len(parameter_sets),
        tuple((np.array(part), Chunk(tuple(parameter_sets[i] for i in part))) for part in parts),
    )


@dataclass(frozen=True, eq=False)
class Sums:
    """What replays add up for each parameter set; every array has shape (n_replays, n_sets).

    Attributes
    ----------
    squared_position : m2, over targets
    squared_heading : rad2, over targets whose heading counts
    nees : sum of e^T P^-1 e of the position over targets
    squared_fix : m2, residuals of the fixes after they were absorbed
    squared_forecast : m2, innovations of the hidden fixes
    nis : sum of nu^T S^-1 nu over the fixes, hidden ones included
    log_determinant : sum of ln det S over the fixes, hidden ones included
    failed : bool: the covariance lost its definiteness, or something became NaN
    """

    squared_position: Array
    squared_heading: Array
    nees: Array
    squared_fix: Array
    squared_forecast: Array
    nis: Array
    log_determinant: Array
    failed: NDArray[np.bool_]


def run_replays(replays: Sequence[Replay], parameter_sets: Sequence[FilterParameters] | Batch) -> Sums:
    """Run one filter per parameter set over each replay. Results do not depend on a set's place or company."""
    batch = parameter_sets if isinstance(parameter_sets, Batch) else pack(parameter_sets)
    columns = np.empty((len(_SUM_ROWS), len(replays), batch.size))
    failed = np.empty((len(replays), batch.size), dtype=np.bool_)
    for places, chunk in batch.chunks:
        rows = start_rows(replays, chunk)
        for replay, lane_rows in zip(replays, rows, strict=True):
            run_rows(replay, chunk, lane_rows, new_place(), len(replay.timeline.dt))
        columns[:, :, places], failed[:, places] = unpack_sums(rows, chunk)
    return Sums(*columns, failed=failed)


def unpack_sums(rows: Array, chunk: Chunk) -> tuple[Array, NDArray[np.bool_]]:
    """The columns of `Sums`, (8, m, n_sets), NaN where a set failed, and where one did, of final rows of m replays."""
    n_sets = len(chunk.sets)
    sound = _sound(rows, chunk.sets[0].n_states)[:, :n_sets] & chunk.plausible
    return np.where(sound, rows[:, _SUM_ROWS, :n_sets].swapaxes(0, 1), np.nan), ~sound


def joined(parts: Sequence[Sums], axis: int) -> Sums:
    """Sums of more replays (axis 0) or more sets (axis 1)."""
    if len(parts) == 1:
        return parts[0]
    return Sums(**{name: np.concatenate([getattr(s, name) for s in parts], axis) for name in vars(parts[0])})


def plausible(p: FilterParameters) -> bool:
    """With Q >= 0 and R > 0 nothing but rounding can make P indefinite; otherwise it may go unnoticed for long."""
    return min(p.process_noise) >= 0 and min(p.measurement_noise) > 0


def definite(covariance: Array) -> NDArray[np.bool_]:
    """Which of the covariances (..., n, n) are positive definite, but for rounding.

    The eigenvalues of the correlation lie above -1e-9 if, with 1e-9 added to its diagonal, all pivots are positive.
    """
    n = covariance.shape[-1]
    with np.errstate(all="ignore"):  # what is not positive, or not finite, ends as such a pivot
        scale = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        scaled = covariance / (scale[..., :, np.newaxis] * scale[..., np.newaxis, :]) + 1e-9 * np.eye(n)
        a = np.moveaxis(scaled, (-2, -1), (0, 1)).copy()
        sound = np.isfinite(covariance).all(axis=(-2, -1))
        for k in range(n):
            sound &= a[k, k] > 0
            for i in range(k + 1, n):
                a[i, i:] -= a[k, i] / a[k, k] * a[k, i:]
    return np.asarray(sound)


_SUM_ROWS = np.arange(lanes.SQ_POSITION, lanes.LOG_DET + 1)
"""In the order of `Sums`."""


_NOT_RECORDED, _NO_INNOVATIONS = np.empty((0, lanes.N_STATE + 1, 0)), np.empty((0, 5))


def start_rows(replays: Sequence[Replay], chunk: Chunk) -> Array:
    """All that LANES filters are at the start of each of m replays, shape (m, N_KEPT, LANES)."""
    rows = np.zeros((len(replays), lanes.N_KEPT, lanes.LANES))
    rows[:, : lanes.N_STATE] = pack_states(*starts_of([replay.initial for replay in replays], chunk.sets))
    for each, replay in zip(rows, replays, strict=True):
        each[lanes.CONSTANTS] = chunk.constants(replay.timeline.nominal_interval)
    rows[:, [lanes.DET, lanes.OK]] = 1.0
    rows[:, lanes.RECENT] = -1.0
    return rows


def new_place() -> Array:
    """Where a run begins."""
    return np.zeros(4)


def run_rows(
    replay: Replay,
    chunk: Chunk,
    rows: Array,
    place: Array,
    stop: int,
    record: Array = _NOT_RECORDED,
    innovations: Array = _NO_INNOVATIONS,
) -> None:
    """Run LANES filters over the steps of one replay from ``place`` to ``stop``: see `compiled.run.run_lanes`."""
    arrays = replay.arrays(*switches(chunk.sets[0]))
    run.run_lanes(chunk.sets[0].n_states, *arrays, rows, place, stop, record, innovations)


def switches(p: FilterParameters) -> tuple[bool, bool, bool]:
    """Which measurements beside fixes a parameter set takes: velocity, lateral, standstill."""
    return p.velocity_noise is not None, p.lateral_noise is not None, p.standstill_noise is not None


def flags_of(line: Timeline, velocity: bool, lateral: bool, standstill: bool) -> NDArray[np.int64]:
    """What happens at the end of each step, as the kernel's bits, shape (k,)."""
    flags = run.FIX * line.absorbs + run.HIDDEN * line.hides + run.IMU * line.sampled
    if velocity and line.has_velocity:
        flags = flags + run.VELOCITY * line.absorbs
    if lateral:
        flags = flags + run.LATERAL * _every(line, ~line.cornering & line.sampled, LATERAL_INTERVAL)
    if standstill:
        flags = flags + run.STANDSTILL * _every(line, line.stands & line.sampled, STANDSTILL_INTERVAL)
    return flags.astype(np.int64)


def _every(line: Timeline, wanted: NDArray[np.bool_], interval: float) -> NDArray[np.bool_]:
    """The first wanted step of each interval of time."""
    chosen = np.zeros(len(wanted), dtype=np.bool_)
    at = np.flatnonzero(wanted)
    slots = np.floor((line.end[at] - line.start) / interval + 1e-6)  # as the live filter's `_slot`
    chosen[at[np.unique(slots, return_index=True)[1]]] = True
    return chosen


def start_of(initial: InitialState, parameter_sets: Sequence[FilterParameters]) -> tuple[Array, Array]:
    """Means (LANES, n) and covariances (LANES, n, n) at the start of one drive; see `starts_of`."""
    means, covariances = starts_of([initial], parameter_sets)
    return means[0], covariances[0]


def starts_of(
    initial: Sequence[InitialState], parameter_sets: Sequence[FilterParameters]
) -> tuple[Array, Array]:
    """Means (m, LANES, n) and covariances (m, LANES, n, n) at m starts; a bias is 0, as unsure as its set says."""
    n, m = parameter_sets[0].n_states, len(initial)
    mean, covariance = np.zeros((m, lanes.LANES, n)), np.zeros((m, lanes.LANES, n, n))
    mean[:, :, :5] = np.array([start.mean[:5] for start in initial])[:, np.newaxis]
    covariance[:, :, :5, :5] = np.array([start.covariance[:5, :5] for start in initial])[:, np.newaxis]
    if n == 8:
        std = np.array([p.bias_std for p in _padded(parameter_sets)])[:, [0, 0, 1]]
        covariance[:, :, [5, 6, 7], [5, 6, 7]] = std**2
        for i, start in enumerate(initial):
            if len(start.mean) == 8:
                mean[i], covariance[i] = start.mean, start.covariance
    return mean, covariance


def _padded(parameter_sets: Sequence[FilterParameters]) -> list[FilterParameters]:
    """As many sets as there are lanes: the last one again."""
    return [*parameter_sets, *[parameter_sets[-1]] * (lanes.LANES - len(parameter_sets))]


def pack_constants(parameter_sets: Sequence[FilterParameters], nominal_interval: float) -> Array:
    """The kernel's constants, shape (N_CONSTANTS, LANES), of at most LANES sets.

    ``nominal_interval`` (s) is the drive's: Q is converted where a set refers to another one.
    """
    return np.array([_constants(p, nominal_interval) for p in _padded(parameter_sets)]).T.copy()


def _constants(p: FilterParameters, nominal_interval: float) -> list[float]:
    n = p.n_states
    gamma2 = p.alpha**2 * (n + p.kappa)
    spread = p.alpha**2 * (n + p.kappa - 1) + p.beta
    convert = nominal_interval / (p.nominal_interval or nominal_interval)
    q = [convert * variance for variance in p.process_noise] + [0.0] * (8 - n)
    off = np.inf
    noises = [off if v is None else v for v in (p.velocity_noise, p.lateral_noise, p.standstill_noise)]
    return [
        *(np.sqrt(gamma2), 1 / gamma2, spread, 0.0 if p.kind == "ekf" else 1.0),
        *q,
        *p.measurement_noise,
        *noises,
        STANDSTILL_RATE_NOISE,
        p.rear_axle,
        p.latency,
        off if p.gate is None else p.gate,
        p.forgetting if p.kind == "adaptive-ukf" else 1.0,
        p.forgetting if p.kind == "strong-tracking-ukf" else -1.0,
    ]


def pack_states(mean: Array, covariance: Array) -> Array:
    """State rows (..., N_STATE, LANES) of means (..., LANES, n) and covariances (..., LANES, n, n)."""
    n = mean.shape[-1]
    rows, columns = _upper(n)
    state = np.zeros((*mean.shape[:-2], lanes.N_STATE, lanes.LANES))
    state[..., :n, :] = mean.swapaxes(-1, -2)
    state[..., lanes.P0 : lanes.P0 + len(rows), :] = covariance[..., rows, columns].swapaxes(-1, -2)
    return state


def unpack_states(state: Array, n: int) -> tuple[Array, Array]:
    """Means (..., r, n) and covariances (..., r, n, n) of state rows (..., N_STATE, r)."""
    rows, columns = _upper(n)
    packed = state[..., lanes.P0 : lanes.P0 + len(rows), :].swapaxes(-1, -2)
    covariance = np.empty((*packed.shape[:-1], n, n))
    covariance[..., rows, columns] = packed
    covariance[..., columns, rows] = packed
    return state[..., :n, :].swapaxes(-1, -2).copy(), covariance


@cache
def _upper(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the upper triangle, column by column, as the kernel packs it."""
    columns, rows = np.tril_indices(n)
    return rows, columns


def _sound(rows: Array, n: int) -> NDArray[np.bool_]:
    """Which lanes never failed and end with a positive definite covariance, shape (m, LANES)."""
    final = rows[:, : lanes.N_STATE]
    finite = np.isfinite(final).all(axis=1) & np.isfinite(rows[:, _SUM_ROWS]).all(axis=1)
    return finite & (rows[:, lanes.OK] == 1.0) & definite(unpack_states(final, n)[1])
