"""Parameter sets as columns of a table, and as columns of the kernel's array (constants, starts, sums).

Building one object per set takes as long as running the filters. A kernel call takes only 0.2 ms; Python code for each
drive and block of columns would take longer and keep other threads waiting. Therefore all sets and drives are processed
together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.tables import Indices, Mask
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.layout import (
    CONSTANT_ROWS,
    CONSTANTS,
    MEAN,
    N_KEPT,
    N_STATE,
    Q0,
    SUMS,
    R,
    lanes_for,
    most_lanes,
)
from sigmaswarm.filters.constants import OUTLIERS_SPAN, STANDSTILL_RATE_NOISE
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.models import NOISE_OF, THETA
from sigmaswarm.filters.packing import RESULT_SUMS, pack_states, sound_columns
from sigmaswarm.filters.parameters import FilterParameters, described
from sigmaswarm.filters.starts import measured_by, start_std, starts_of

_ABSENT: dict[str, float] = described("absent")
"""Number that represents None in a column, for each field that may be None."""


@dataclass(frozen=True, eq=False)
class ParameterTable(Sequence[FilterParameters]):
    """Parameter sets with the same model and measurements. Indexing builds a `FilterParameters`.

    ``like`` contains the fields that are equal in all ``size`` = n sets; ``columns`` contains the other fields, (n,) or
    (n, k).
    """

    like: FilterParameters
    columns: dict[str, NDArray[Any]]
    size: int

    @classmethod
    def of(cls, parameter_sets: Sequence[FilterParameters]) -> "ParameterTable":
        if isinstance(parameter_sets, ParameterTable):
            return parameter_sets
        columns = dict[str, NDArray[Any]]()
        for name, first in vars(parameter_sets[0]).items():
            values = [getattr(p, name) for p in parameter_sets]
            if any(value is not first and value != first for value in values):
                columns[name] = np.array([_ABSENT[name] if value is None else value for value in values])
        return cls(parameter_sets[0], columns, len(parameter_sets))

    def field(self, name: str) -> Any:
        """Return a field's values, (n,) or (n, k).

        If all sets have the same value, return this value. None becomes inf or 0.
        """
        if name in self.columns:
            return self.columns[name]
        value = getattr(self.like, name)
        return _ABSENT[name] if value is None else value

    def column(self, name: str) -> Array:
        """Return `field` for each set, (n,) or (n, k)."""
        value = np.asarray(self.field(name), dtype=np.float64)
        return value if name in self.columns else np.repeat(value[np.newaxis], self.size, axis=0)

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, at: int) -> FilterParameters: ...
    @overload
    def __getitem__(self, at: slice) -> "ParameterTable": ...
    def __getitem__(self, at: int | slice) -> "FilterParameters | ParameterTable":
        places = range(self.size)[at]
        part = {name: column[at] for name, column in self.columns.items()}
        if isinstance(places, range):
            return ParameterTable(self.like, part, len(places))
        values = {name: value.tolist() for name, value in part.items()}
        return replace(self.like, **{k: None if v == _ABSENT.get(k) else v for k, v in values.items()})


def group_tables(parameter_sets: Sequence[FilterParameters]) -> list[tuple[Indices, ParameterTable]]:
    """Return a table for each kernel and choice of measurements, and the indices of its sets."""
    if isinstance(parameter_sets, ParameterTable):
        return [(np.arange(len(parameter_sets)), parameter_sets)]
    alike: dict[tuple[str, frozenset[str]], list[int]] = {}
    for i, p in enumerate(parameter_sets):
        alike.setdefault((p.kernel, measured_by(p)), []).append(i)
    return [(np.array(at), ParameterTable.of([parameter_sets[i] for i in at])) for at in alike.values()]


Starts = dict[InitialState, tuple[Array, Array]]
"""Initial state rows (N_STATE, columns) and headings (columns,), rad.

If all sets have the same start, there is only one column.
"""

MAX_STARTS = 20_000  # largest number of columns of starts computed in advance; each takes about 3 kB
MAX_CACHED_STARTS = 1_000  # largest number of starts per call that are cached; they have one column each


@dataclass(frozen=True, eq=False)
class KernelSums:
    """Sums over each pass for each parameter set; ``sums["NIS"]`` has shape (n_passes, n_sets).

    Attributes
    ----------
    numbers : (n_sums, n_passes, n_sets)
        Sums in the order of `layout.SUMS`; NaN if a set failed.
    failed : bool (n_passes, n_sets)
        True if P was not positive definite, if a state or sum was not finite, or if the set is implausible (see
        `KernelArray.plausible`).
    """

    numbers: Array
    failed: Mask

    @classmethod
    def empty(cls, n_passes: int, n_sets: int) -> "KernelSums":
        shape = n_passes, n_sets
        return cls(np.empty((RESULT_SUMS.stop - RESULT_SUMS.start, *shape)), np.empty(shape, dtype=np.bool_))

    def __getitem__(self, name: str) -> Array:
        return self.numbers[SUMS.index(name)]

    @property
    def of_branches(self) -> "KernelSums":
        """The sums with the position errors of the branches (see `passes.FilterPass`)."""
        numbers = self.numbers.copy()
        numbers[SUMS.index("SQ_POSITION")] = self["SQ_BRANCH"]
        return KernelSums(numbers, self.failed)

    def put(self, passes: slice, sets: Indices, part: "KernelSums") -> None:
        self.numbers[:, passes, sets] = part.numbers
        self.failed[passes, sets] = part.failed


class KernelArray:
    """Parameter sets with the same kernel and measurements.

    Each block has ``width`` columns, at most `most_lanes`. Surplus columns are copies of the last set. ``like`` has the
    model and measurements of all ``size`` sets. ``reads`` states what the sets require of a drive: axes of the model,
    stated accuracy of fixes, and measurements (`measured_by`). The constructor raises `InputError` if the model is not
    compiled as this filter type.
    """

    def __init__(self, parameter_sets: Sequence[FilterParameters]) -> None:
        table = ParameterTable.of(parameter_sets)
        self.like, self.size = table.like, len(table)
        filter_types = FILTERS[self.kernel].filter_types
        if self.like.kind not in filter_types:
            raise InputError(
                f"{self.like.model} is not compiled as {self.like.kind}; use kind {' or '.join(filter_types)}, "
                "or run_textbook"
            )
        columns = np.minimum(np.arange(self.blocks * self.width), self.size - 1)
        self._constants = _constants(table)[:, columns]
        self._interval = table.column("nominal_interval")[columns]
        self._start_std = start_std(self.like)[np.newaxis]
        if not {"bias_std", "fix_error"}.isdisjoint(table.columns):
            error = np.sqrt(table.column("fix_error")) * table.column("fix_std")
            self._start_std = np.column_stack([table.column("bias_std"), error])[columns]
        accuracy = bool(self._constants[R.ACCURACY - CONSTANT_ROWS.start].any())
        self.reads = self.like.model, accuracy, measured_by(self.like)
        self._starts: Starts = {}

    @property
    def kernel(self) -> str:
        return self.like.kernel

    @property
    def width(self) -> int:
        return lanes_for(-(-self.size // self.blocks))

    @property
    def blocks(self) -> int:
        return -(-self.size // most_lanes(self.kernel))

    @property
    def plausible(self) -> Mask:
        """Mask (size,) of the sets with Q >= 0 and R > 0.

        In other sets, P may become indefinite long before it is checked.
        """
        own = self._constants[:, : self.size]
        r = own[[R.RX - CONSTANT_ROWS.start, R.RY - CONSTANT_ROWS.start]]
        return (own[_Q].min(axis=0) >= 0) & (r.min(axis=0) > 0)

    def constants(self, nominal_interval: float) -> Array:
        """Return the kernel's constants, (N_CONSTANTS, columns), for a drive with this nominal IMU interval, s."""
        constants, own = self._constants.copy(), self._interval
        constants[_Q] *= nominal_interval / np.where(own > 0.0, own, nominal_interval)
        # In nominal steps, minus a margin for the rounding of Unix time.
        constants[R.PATIENCE - CONSTANT_ROWS.start] = (OUTLIERS_SPAN - 1e-6) / nominal_interval
        constants[R.FIX_ERROR_RATE - CONSTANT_ROWS.start] *= nominal_interval
        return constants

    def compute_starts(self, initial: Sequence[InitialState]) -> None:
        """Compute the starts in advance, unless they would need too much memory."""
        unknown = tuple(dict.fromkeys(initial))
        if len(unknown) * len(self._start_std) <= MAX_STARTS:
            self._starts = self._starts_at(unknown, self._start_std)

    def start(self, initial: Sequence[InitialState], nominal_intervals: Sequence[float]) -> Array:
        """Return the rows of the filters at m starts, (blocks * m, N_KEPT, width). Nominal IMU intervals are in s."""
        blocks, m, starts = self.blocks, len(initial), self._starts
        if not all(start in starts for start in initial):
            starts = self._starts_at(tuple(dict.fromkeys(initial)), self._start_std)
        rows = np.empty((blocks, m, N_KEPT, self.width))
        rows[:] = _INITIAL_ROWS
        for k, (start, interval) in enumerate(zip(initial, nominal_intervals, strict=True)):
            state, heading = starts[start]
            rows[:, k, CONSTANT_ROWS] = _in_blocks(self.constants(interval), blocks)
            rows[:, k, :N_STATE] = _in_blocks(state, blocks)
            rows[:, k, R.HEADING] = _in_blocks(heading[np.newaxis], blocks)[:, 0]
        return rows.reshape(-1, N_KEPT, self.width)

    def _starts_at(self, initial: tuple[InitialState, ...], std: Array) -> Starts:
        if len(std) == 1 and len(initial) <= MAX_CACHED_STARTS:
            return _shared_starts(initial, self.kernel, tuple(std[0].tolist()))
        return _starts_of(initial, self.kernel, std)

    def sums(self, rows: Array) -> KernelSums:
        """Return the sums of the sets from the final rows of m passes that began with the rows of `start`."""
        is_sound, sums = sound_columns(rows, self.kernel), rows[:, RESULT_SUMS].swapaxes(0, 1)
        if self.blocks > 1:
            is_sound, sums = _side_by_side(is_sound, self.blocks), _side_by_side(sums, self.blocks)
        sound = is_sound[:, : self.size] & self.plausible
        return KernelSums(np.where(sound, sums[..., : self.size], np.nan), ~sound)


_Q = slice(Q0 - CONSTANT_ROWS.start, Q0 - CONSTANT_ROWS.start + len(MEAN))
_INITIAL_ROWS = np.zeros((N_KEPT, 1))  # rows of a filter before its first step
_INITIAL_ROWS[[R.DET, R.TAIL, R.OK, R.QUICK, R.SLOW, R.TIMES_R, R.TIMES_Q]] = 1.0
_INITIAL_ROWS[R.RECENT] = -1.0


def _starts_of(initial: tuple[InitialState, ...], model: str, std: Array) -> Starts:
    mean, covariance = starts_of(initial, FILTERS[model], std)
    packed = zip(pack_states(mean, covariance, model), mean[..., THETA], strict=True)
    return dict(zip(initial, packed, strict=True))


@lru_cache(4)
def _shared_starts(initial: tuple[InitialState, ...], model: str, std: tuple[float, ...]) -> Starts:
    """Return the starts of sets with equal `start_std`.

    They are cached, since all generations of a search have the same starts.
    """
    return _starts_of(initial, model, np.array([std]))


def _in_blocks(rows: Array, blocks: int) -> Array:
    """Reshape rows (r, columns) to (blocks, r, width), or a single column for all sets to (1, r, 1)."""
    return rows.reshape(len(rows), blocks if rows.shape[1] > 1 else 1, -1).swapaxes(0, 1)


def _side_by_side(values: NDArray[Any], blocks: int) -> NDArray[Any]:
    """Reshape the values of each block, (..., blocks * m, width), to (..., m, columns)."""
    *more, rows, width = values.shape
    by_block = values.reshape(*more, blocks, rows // blocks, width)
    return by_block.swapaxes(-3, -2).reshape(*more, rows // blocks, blocks * width)


def _constants(table: ParameterTable) -> Array:
    """Return the kernel's constants, (N_CONSTANTS, n), with Q per `nominal_interval` of each set, and PATIENCE 0."""
    constants = np.zeros((len(CONSTANTS), len(table)))
    for row, value in _values(table.field, table.like.kernel).items():
        constants[row - CONSTANT_ROWS.start] = value
    return constants


def _values(of: Callable[[str], Any], model: str) -> dict[int, Any]:
    kind, forgetting = of("kind"), of("forgetting")
    q = np.transpose(of("process_noise"))
    alpha2, n_kappa = np.square(of("alpha")), len(FILTERS[model].states) + np.asarray(of("kappa"))
    gamma2, second = alpha2 * n_kappa, np.where(kind == "ekf", 0.0, 1.0)
    rx, ry = np.transpose(of("measurement_noise"))
    width_ratio, width_trend = np.transpose(of("fuzzy_widths"))
    gain_r, gain_q = np.transpose(of("fuzzy_gains"))
    r_gyro, r_accel, *r_left = np.transpose(of("imu_noise"))
    gyro_gate, accel_gate = np.transpose(of("imu_gate"))
    measures = FILTERS[model].measures_imu
    return {
        R.R_RATE: r_gyro if measures else STANDSTILL_RATE_NOISE,
        R.QUARTER_GAMMA: second * np.sqrt(gamma2) / 4,
        R.SHORTENS: -second * 8 / gamma2,
        R.SPREAD: alpha2 * (n_kappa - 1) + of("beta"),
        R.SECOND: second,
        R.FORGETTING: np.where(kind == "adaptive-ukf", forgetting, 1.0),
        R.FADING: np.where(kind == "strong-tracking-ukf", forgetting, -1.0),
        R.FUZZY: np.where(kind == "fuzzy-ukf", forgetting, -1.0),
        **{Q0 + i: variance for i, variance in enumerate(q)},
        R.RX: rx,
        R.RY: ry,
        R.WIDTH_RATIO: width_ratio,
        R.WIDTH_TREND: width_trend,
        R.GAIN_R: gain_r,
        R.GAIN_Q: gain_q,
        **{getattr(R, f"R_{name.upper()}"): of(noise) for name, noise in NOISE_OF.items()},
        **({R.R_VELOCITY: r_accel} if measures else {}),
        **({R.R_STANDSTILL: r_left[0]} if r_left else {}),
        R.ODOMETER_SCALE: 1 / np.asarray(of("odometer_scale")),
        R.ODOMETER_LATENCY: of("odometer_latency"),
        R.REAR_AXLE: gyro_gate if measures else of("rear_axle"),
        R.TIRE_SLIP: accel_gate if measures else of("tire_slip"),
        R.LATENCY: of("latency"),
        R.GATE: of("gate"),
        R.ACCURACY: of("accuracy_scale"),
        R.DOF: of("robust_dof"),
        R.FIX_ERROR: of("fix_error"),
        R.FIX_ERROR_RATE: 1 / np.asarray(of("fix_error_time")),  # per second
        R.FIX_VAR: np.square(of("fix_std")),
    }
