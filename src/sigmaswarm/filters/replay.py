"""Replays of drives, and any number of filters over them: what each filter adds up."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled import run
from sigmaswarm.filters.groups import Chunk, Packed, pack, start_rows, unpack_sums
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import (
    COMPARED,
    Switches,
    flags_of,
    require_accuracy,
    require_axes,
    require_odometer,
)

NO_SPEEDS = np.empty((0, 3))
"""Of a filter that does not look at the wheels."""


@dataclass(frozen=True, eq=False)
class Targets:
    """Moments at which estimates are compared with a known position and heading.

    Attributes
    ----------
    weight : (m,)
        Of the later of the two estimates around the moment.
    x, y : (m,) m
    theta : (m,) rad
    counts : (m,) bool
        Where the heading is compared.
    end : (k,) int32
        How many targets lie before the end of each step of the time line.
    doubts : (m, 4), or (0, 4) where what is known is exact
        What the squared errors of position and heading count, and the variances of x and y, m2, beside P in the NEES.
    """

    weight: Array
    x: Array
    y: Array
    theta: Array
    counts: NDArray[np.bool_]
    end: NDArray[np.int32]
    doubts: Array = field(default_factory=lambda: run.NO_DOUBTS)

    @classmethod
    def none(cls, timeline: Timeline) -> "Targets":
        """Nothing to compare with."""
        weight, x, y, theta, counts, doubts = run.NO_TARGETS
        return cls(weight, x, y, theta, counts, np.zeros(len(timeline.dt), dtype=np.int32), doubts)

    @property
    def columns(self) -> run.TargetColumns:
        """What the kernel reads of the moments."""
        weight, x, y, theta = (run.kept(column) for column in (self.weight, self.x, self.y, self.theta))
        return weight, x, y, theta, self.counts, run.kept(self.doubts)

    def compared(self, line: Timeline) -> NDArray[np.intp]:
        """The steps that end at an IMU sample with a comparison in the interval before or behind it."""
        samples = np.flatnonzero(line.sampled)
        inside = np.diff(self.end[samples], prepend=0) > 0
        return samples[inside | np.append(inside[1:], False)[: len(inside)]]

    @property
    def n_positions(self) -> int:
        """How many positions are compared."""
        return len(self.weight)

    @cached_property
    def position_weight(self) -> float:
        """What the squared errors of position count together: as many as they are where truth is exact."""
        return float(self.doubts[:, 0].sum()) if len(self.doubts) else float(self.n_positions)

    @cached_property
    def heading_weight(self) -> float:
        """The same of heading."""
        return float(self.doubts[self.counts, 1].sum()) if len(self.doubts) else float(self.counts.sum())


@dataclass(frozen=True, eq=False)
class Replay:
    """One pass over a drive, ready for any number of filters: where they start, step, and are compared."""

    timeline: Timeline
    initial: InitialState
    targets: Targets
    _arrays: dict[Switches, "DriveArrays"] = field(default_factory=dict)  # pyright: ignore[reportUnknownVariableType]
    readable: set[tuple[ModelName, bool, Switches]] = field(default_factory=set)  # pyright: ignore[reportUnknownVariableType]

    @cached_property
    def n_hidden(self) -> int:
        """How many fixes are hidden from the filter."""
        return int(self.timeline.hides.sum())

    def arrays(
        self, velocity: bool, lateral: bool, standstill: bool, odometer: bool = False
    ) -> "DriveArrays":
        """What the kernel reads of the drive, in its order; the flags depend on what a filter takes beside fixes."""
        taken = velocity, lateral, standstill, odometer
        if taken not in self._arrays:
            line, targets = self.timeline, self.targets
            flags = flags_of(line, *taken)
            flags[targets.compared(line)] |= COMPARED
            speeds = line.wheels.rows if odometer and line.wheels else NO_SPEEDS
            read = line.steps, line.sample, line.driving, flags, line.fixes, speeds, line.lever
            self._arrays[taken] = *read, targets.columns, targets.end
        return self._arrays[taken]


DriveArrays = tuple[
    *tuple[Array, NDArray[np.int32], Array, NDArray[np.uint8]],
    *tuple[Array, Array, Array, run.TargetColumns, NDArray[np.int32]],
]
"""steps, samples, driving, flags, fixes, speeds, lever, targets and their ends: see `compiled.run.run_lanes`."""


@dataclass(frozen=True, eq=False)
class Sums:
    """What replays add up for each parameter set; every array has shape (n_replays, n_sets).

    Attributes
    ----------
    squared_position : m2, over targets, each times what it counts
    squared_heading : rad2, over targets whose heading counts, likewise
    nees : sum of e^T P^-1 e of the position over targets; P with the variances of what is known
    squared_fix : m2, residuals of the fixes after they were absorbed
    squared_forecast : m2, innovations of the hidden fixes
    nis : sum of nu^T S^-1 nu over the fixes, hidden ones included
    log_tail : sum of ln(1 + NIS / c) over the fixes, hidden ones included, with c of `innovation-t`
    forecast_t : sum of ln det S / 2 + (v + 2) / 2 ln(1 + NIS / c) over the hidden fixes, with v and c of `forecast-t`
    log_determinant : sum of ln det S over the fixes, hidden ones included
    failed : bool: the covariance lost its definiteness, or something became NaN
    """

    squared_position: Array
    squared_heading: Array
    nees: Array
    squared_fix: Array
    squared_forecast: Array
    nis: Array
    log_tail: Array
    forecast_t: Array
    log_determinant: Array
    failed: NDArray[np.bool_]


def run_replays(replays: Sequence[Replay], parameter_sets: Sequence[FilterParameters]) -> Sums:
    """Run one filter per parameter set over each replay. Results do not depend on a set's place or company."""
    return run_packed(replays, pack(parameter_sets))


def run_packed(replays: Sequence[Replay], packed: Packed) -> Sums:
    """The same of packed sets."""
    parts = joined([_run_chunk(replays, chunk) for _, chunk in packed], axis=1)
    if len(packed) == 1:
        return parts
    order = np.argsort(np.concatenate([places for places, _ in packed]))
    return Sums(**{name: column[:, order] for name, column in vars(parts).items()})


def _run_chunk(replays: Sequence[Replay], chunk: Chunk) -> Sums:
    rows = start_replays(replays, chunk)
    for replay, block in zip(cycle(replays), rows, strict=False):
        run_steps(replay, chunk, block, run.new_place(), len(replay.timeline.dt))
    columns, failed = unpack_sums(rows, chunk)
    return Sums(*columns, failed=failed)


def start_replays(replays: Sequence[Replay], chunk: Chunk) -> Array:
    """All that a chunk's filters are at the start of each of m replays, as `start_rows`."""
    intervals = [replay.timeline.nominal_interval for replay in replays]
    return start_rows([replay.initial for replay in replays], intervals, chunk)


def run_steps(
    replay: Replay,
    chunk: Chunk,
    rows: Array,
    place: Array,
    stop: int,
    record: Array = run.NO_RECORD,
    innovations: Array = run.NO_INNOVATIONS,
) -> None:
    """Run a chunk's filters over the steps of one replay from ``place`` to ``stop``: see `compiled.run.run_lanes`."""
    require_readable(replay, chunk)
    arrays = replay.arrays(*chunk.group.reads[-1])
    run.run_lanes(chunk.model, *arrays, rows, place, stop, record, innovations)


def require_readable(replay: Replay, chunk: Chunk) -> None:
    """Raise `InputError` where a drive lacks what filters read of it."""
    if chunk.group.reads in replay.readable:
        return
    model, accuracy, (*_, odometer) = chunk.group.reads
    require_axes(replay.timeline.drive, model)
    if accuracy:
        require_accuracy(replay.timeline)
    if odometer:
        require_odometer(replay.timeline.drive)
    replay.readable.add(chunk.group.reads)


def joined(parts: Sequence[Sums], axis: int) -> Sums:
    """Sums of more replays (axis 0) or more sets (axis 1)."""
    if len(parts) == 1:
        return parts[0]
    return Sums(**{name: np.concatenate([getattr(s, name) for s in parts], axis) for name in vars(parts[0])})
