"""Run any number of filters over drives, and return the sums from which scores and costs are computed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.events import COMPARED, events_of
from sigmaswarm.drives.tables import Indices, Mask
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.compiled import run
from sigmaswarm.filters.kernel_array import KernelArray, KernelSums, group_tables
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.starts import require_accuracy, require_axes, require_odometer


@dataclass(frozen=True, eq=False)
class Targets:
    """Times at which estimates are compared with a known position and heading.

    ``noise`` (m, 4) contains the weights of the squared errors of position and heading, and the variances of x and y,
    m2, which the NEES adds to P. If no variances are known, the shape of ``noise`` is (0, 4). ``weight`` (m,) is the
    weight of the later estimate in the interpolation to a target's time.
    """

    weight: Array
    x: Array  # (m,), in meters
    y: Array  # (m,), in meters
    theta: Array  # (m,), rad
    counts: Mask  # (m,), True if the heading is compared
    end: NDArray[np.int32]  # (k,), number of targets before the end of each step
    noise: Array = field(default_factory=lambda: run.NO_DEVIATIONS)

    @classmethod
    def none(cls, timeline: Timeline) -> "Targets":
        weight, x, y, theta, counts, noise = run.NO_TARGETS
        return cls(weight, x, y, theta, counts, np.zeros(len(timeline.dt), dtype=np.int32), noise)

    @property
    def columns(self) -> run.TargetColumns:
        weight, x, y, theta = (run.readonly(column) for column in (self.weight, self.x, self.y, self.theta))
        return weight, x, y, theta, self.counts, run.readonly(self.noise)

    def compared(self, line: Timeline) -> Indices:
        """Return the steps that end at an IMU sample with a target in the interval before or after it."""
        samples = np.flatnonzero(line.sampled)
        inside = np.diff(self.end[samples], prepend=0) > 0
        return samples[inside | np.append(inside[1:], False)[: len(inside)]]

    @property
    def n_positions(self) -> int:
        return len(self.weight)

    @cached_property
    def position_weight(self) -> float:
        """Total weight of the squared position errors; the number of errors if all weights are 1."""
        return float(self.noise[:, 0].sum()) if len(self.noise) else float(self.n_positions)

    @cached_property
    def heading_weight(self) -> float:
        return float(self.noise[self.counts, 1].sum()) if len(self.noise) else float(self.counts.sum())


@dataclass(frozen=True, eq=False)
class FilterPass:
    """Inputs of filters for one pass over a drive: start, steps and targets."""

    timeline: Timeline
    initial: InitialState
    targets: Targets
    _arrays: dict[frozenset[str], run.DriveArrays] = field(default_factory=dict)
    readable: set[tuple[ModelName, bool, frozenset[str]]] = field(default_factory=set)

    @cached_property
    def n_hidden(self) -> int:
        return int(self.timeline.hides.sum())

    def arrays(self, used: frozenset[str]) -> run.DriveArrays:
        """Return the drive as kernel arrays, with the flags of the ``used`` measurements (`MEASURED`)."""
        if used not in self._arrays:
            line, targets = self.timeline, self.targets
            flags, wheels = events_of(line, used)
            flags[targets.compared(line)] |= COMPARED
            read = line.steps, line.sample, line.driving, flags, line.fixes, wheels, line.lever
            self._arrays[used] = *read, targets.columns, targets.end
        return self._arrays[used]


def run_passes(passes: Sequence[FilterPass], parameter_sets: Sequence[FilterParameters]) -> KernelSums:
    """Run one filter per parameter set over each pass. The sums of a set do not depend on the other sets."""
    sums = KernelSums.empty(len(passes), len(parameter_sets))
    for indices, table in group_tables(parameter_sets):
        sums.put(slice(None), indices, run_array(passes, KernelArray(table)))
    return sums


def run_array(passes: Sequence[FilterPass], array: KernelArray) -> KernelSums:
    rows = start_passes(passes, array)
    for drive_pass, block in zip(cycle(passes), rows, strict=False):
        run_steps(drive_pass, array, block, run.new_cursor(), len(drive_pass.timeline.dt))
    return array.sums(rows)


def start_passes(passes: Sequence[FilterPass], array: KernelArray) -> Array:
    """Return the rows of an array's filters at the start of each pass, in the format of `KernelArray.start`."""
    return array.start([r.initial for r in passes], [r.timeline.nominal_interval for r in passes])


def run_steps(
    drive_pass: FilterPass,
    array: KernelArray,
    rows: Array,
    cursor: Array,
    stop: int,
    record: Array = run.NO_RECORD,
    innovations: Array = run.NO_INNOVATIONS,
) -> None:
    """Run a block of filters over the steps of a pass from ``cursor`` to ``stop`` (see `compiled.run.run_lanes`)."""
    require_readable(drive_pass, array)
    drive = drive_pass.arrays(array.reads[-1])
    run.run_lanes(array.kernel, drive, rows, cursor, stop, record, innovations)


def require_readable(drive_pass: FilterPass, array: KernelArray) -> None:
    if array.reads in drive_pass.readable:
        return
    model, accuracy, measured = array.reads
    require_axes(drive_pass.timeline.drive, model)
    if accuracy:
        require_accuracy(drive_pass.timeline)
    if "odometer" in measured:
        require_odometer(drive_pass.timeline.drive)
    drive_pass.readable.add(array.reads)


def join_sums(parts: Sequence[KernelSums]) -> KernelSums:
    """Join the sums of different sets over the same passes."""
    numbers, failed = zip(*((part.numbers, part.failed) for part in parts), strict=True)
    return KernelSums(np.concatenate(numbers, axis=-1), np.concatenate(failed, axis=-1))
