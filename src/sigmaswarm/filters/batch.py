"""Many parameter sets over one drive in one call: packs records into the compiled kernel's arrays and back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters import kernels as k
from sigmaswarm.filters.parameters import FilterParameters

Array = NDArray[np.float64]
_UPPER = np.triu_indices(5)


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

    @property
    def n_headings(self) -> int:
        """How many headings are compared."""
        return int(self.rows[:, k.SCORES_HEADING].sum())


@dataclass(frozen=True, eq=False)
class Replay:
    """One pass over a drive, ready for any number of filters: where they start, step, and are compared."""

    timeline: Timeline
    initial: InitialState
    targets: Targets


@dataclass(frozen=True, eq=False)
class Sums:
    """What a replay adds up for each parameter set; every array has shape (n_sets,).

    Attributes
    ----------
    squared_position : m2, over targets
    squared_heading : rad2, over targets whose heading counts
    squared_fix : m2, residuals of the fixes after they were absorbed
    nis : sum of nu^T S^-1 nu over the fixes
    log_determinant : sum of ln det S over the fixes
    failed : bool: the covariance lost its definiteness, or something became NaN
    """

    squared_position: Array
    squared_heading: Array
    squared_fix: Array
    nis: Array
    log_determinant: Array
    failed: NDArray[np.bool_]


def run_replay(replay: Replay, parameter_sets: Sequence[FilterParameters]) -> Sums:
    """Run one filter per parameter set over a replay. Results do not depend on a set's place or company."""
    n = len(parameter_sets)
    constants = pack_constants(parameter_sets, replay.timeline.nominal_interval)
    initial = pack_states(replay.initial.mean, replay.initial.covariance)
    arrays = _arrays(replay)
    sums = np.empty((k.N_SUMS, constants.shape[1]))
    final, record = np.empty((k.N_STATE, k.LANES)), np.empty((0, k.N_STATE + 1, 0))
    for start in range(0, n, k.LANES):
        lanes = slice(start, start + k.LANES)
        out = np.empty((k.N_SUMS, k.LANES))
        k.run_lanes(*arrays, initial, np.ascontiguousarray(constants[:, lanes]), out, final, record)
        sums[:, lanes] = out
    failed = (sums[k.OK, :n] == 0) | ~np.isfinite(sums[:, :n]).all(axis=0)
    rows = (k.SQ_POSITION, k.SQ_HEADING, k.SQ_FIX, k.NIS, k.LOG_DET)
    return Sums(*(np.where(failed, np.nan, sums[row, :n]) for row in rows), failed=failed)


def record_replay(replay: Replay, parameters: FilterParameters) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The whole trajectory of one filter: means (n, 5), covariances (n, 5, 5), and where it is sound (n,)."""
    constants = pack_constants([parameters], replay.timeline.nominal_interval)
    initial = pack_states(replay.initial.mean, replay.initial.covariance)
    record = np.empty((len(replay.timeline.imu_time), k.N_STATE + 1, 1))
    sums, final = np.empty((k.N_SUMS, k.LANES)), np.empty((k.N_STATE, k.LANES))
    k.run_lanes(*_arrays(replay), initial, constants, sums, final, record)
    mean, covariance = unpack_states(record[:, : k.N_STATE, 0].T)
    sound = (record[:, k.N_STATE, 0] == 1.0) & np.isfinite(record[:, :, 0]).all(axis=1)
    return mean, covariance, sound & _definite(covariance)


def _definite(covariance: Array) -> NDArray[np.bool_]:
    """Which of the covariances (n, 5, 5) are positive definite: all pivots of an elimination are positive."""
    rest, sound = covariance.copy(), np.ones(len(covariance), dtype=np.bool_)
    with np.errstate(all="ignore"):
        for _ in range(covariance.shape[1]):
            pivot = rest[:, 0, 0]
            sound &= pivot > 0
            rest = rest[:, 1:, 1:] - rest[:, 1:, :1] * rest[:, :1, 1:] / pivot[:, None, None]
    return sound


def _arrays(replay: Replay) -> tuple[Array, NDArray[np.int64], Array, Array, NDArray[np.int64]]:
    """Steps, flags, fixes, targets and target_end, as the kernel takes them."""
    t = replay.timeline
    steps = np.column_stack([t.dt, t.ax, t.ay, t.gz, t.q_scale])
    flags = k.FIX * t.absorbs.astype(np.int64) + k.IMU * t.sampled.astype(np.int64)
    return steps, flags, t.fixes, replay.targets.rows, replay.targets.end


def pack_constants(parameter_sets: Sequence[FilterParameters], nominal_interval: float) -> Array:
    """The kernel's constants, shape (N_CONSTANTS, lanes), padded with the last set to whole chunks of lanes.

    ``nominal_interval`` (s) is the drive's: Q is converted where a set refers to another one.
    """
    columns = []
    for p in parameter_sets:
        gamma2 = p.alpha**2 * (p.n_states + p.kappa)
        spread = p.alpha**2 * (p.n_states + p.kappa - 1) + p.beta
        convert = nominal_interval / (p.nominal_interval or nominal_interval)
        q = [convert * variance for variance in p.process_noise]
        columns.append([np.sqrt(gamma2), 1 / gamma2, spread, *q, *p.measurement_noise])
    padding = -len(columns) % k.LANES
    return np.ascontiguousarray(np.array(columns + columns[-1:] * padding).T)


def pack_states(mean: Array, covariance: Array) -> Array:
    """The kernel's state rows, shape (N_STATE, LANES), of one state for all lanes or of one state per lane.

    ``mean`` is (5,) or (LANES, 5), ``covariance`` (5, 5) or (LANES, 5, 5).
    """
    state = np.empty((k.N_STATE, k.LANES))
    state[:5] = np.atleast_2d(mean).T
    state[5:] = covariance.reshape(-1, 5, 5)[:, *_UPPER].T
    return state


def unpack_states(rows: Array) -> tuple[Array, Array]:
    """Means (n, 5) and covariances (n, 5, 5) of state rows (N_STATE, n)."""
    covariance = np.empty((rows.shape[1], 5, 5))
    covariance[:, *_UPPER] = rows[5:].T
    covariance[:, *_UPPER[::-1]] = rows[5:].T
    return rows[:5].T.copy(), covariance
