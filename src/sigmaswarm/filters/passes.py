"""Run any number of filters over drives, and return the sums from which scores and costs are computed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.events import COMPARED, FIX, HIDDEN, ODOMETER, events_of
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
    """Inputs of filters for one pass over a drive: start, steps and targets.

    ``windows``: times in which fixes are hidden, (k, 2) s. ``branches``: passes over the same drive in which fixes are
    hidden in windows. Filters run over each window of a branch from their state before it, in which all fixes were
    used, and then return to this state. The sums of the pass include SQ_BRANCH, SQ_FORECAST and FORECAST_T of its
    branches; its other sums do not depend on branches.
    """

    timeline: Timeline
    initial: InitialState
    targets: Targets
    windows: Array = field(default_factory=lambda: np.empty((0, 2)))
    branches: "tuple[FilterPass, ...]" = ()
    _arrays: dict[frozenset[str], run.DriveArrays] = field(default_factory=dict, init=False)
    readable: set[tuple[ModelName, bool, frozenset[str]]] = field(default_factory=set, init=False)

    @cached_property
    def n_hidden(self) -> int:
        return int(self.timeline.hides.sum())

    @cached_property
    def n_steps(self) -> int:
        """Number of steps, including those of the branches."""
        return sum(piece.last - piece.first for piece in self._pieces)

    def arrays(self, used: frozenset[str]) -> run.DriveArrays:
        """Return the drive as kernel arrays, with the flags of the ``used`` measurements (`MEASURED`)."""
        if used not in self._arrays:
            own = self._arrays_of_pass(used)
            if self.branches:
                parts = [own, *(branch._arrays_of_pass(used) for branch in self.branches)]
                own = _joined(parts, self._pieces)
            self._arrays[used] = own
        return self._arrays[used]

    def _arrays_of_pass(self, used: frozenset[str]) -> run.DriveArrays:
        line, targets = self.timeline, self.targets
        flags, wheels = events_of(line, used)
        flags[targets.compared(line)] |= COMPARED
        read = line.steps, line.sample, line.driving, flags, line.fixes, wheels, line.lever
        return *read, targets.columns, targets.end

    @cached_property
    def _pieces(self) -> "list[_Piece]":
        """The pieces of the pass and of its branches, in the order in which filters run over them."""
        windows = sorted(
            (
                (*window, number)
                for number, branch in enumerate(self.branches, 1)
                for window in _windows_of(branch, self.timeline)
            ),
            key=lambda window: window[0],
        )
        pieces, done = list[_Piece](), 0
        for at, first, last, number in windows:
            if at > done:
                pieces.append(_Piece(0, done, at))
                done = at
            pieces.append(_Piece(number, first, last))
        return [*pieces, _Piece(0, done, len(self.timeline.end))]


STEP, OF_FIX, WHEEL, TARGET = range(4)
"""Kinds of rows of a pass: one row per step, fix, wheel speed or target."""


class _Piece(NamedTuple):
    """The steps from ``first`` to before ``last`` of a pass (0) or of its branch ``number``."""

    number: int
    first: int
    last: int


def _windows_of(branch: FilterPass, line: Timeline) -> list[tuple[int, int, int]]:
    """Return for each window the step of ``line`` before which the branch begins, and its own first and last step.

    A branch begins after the last IMU sample before the first hidden fix (or, without hidden fixes, before the end of
    the window). It ends with the last hidden fix or target. Windows in one gap of the IMU have one branch.
    """
    own, time = branch.timeline, line.imu_time
    samples, own_samples = np.flatnonzero(line.sampled), np.flatnonzero(own.sampled)
    scored = np.flatnonzero(own.hides | (np.diff(branch.targets.end, prepend=0) > 0))
    ends, found = own.end[scored], list[tuple[int, int, int]]()
    for start, end in branch.windows:
        k = int(np.searchsorted(line.fix_time, start, side="left"))
        begin = line.fix_time[k] if k < len(line.fix_time) and line.fix_time[k] <= end else end
        before = int(np.searchsorted(time, begin, side="left"))
        until = time[min(int(np.searchsorted(time, end, side="left")), len(time) - 1)]
        last = int(np.searchsorted(ends, until, side="right"))
        at, first = (int(s[before - 1]) + 1 if before else 0 for s in (samples, own_samples))
        if not last or scored[last - 1] < first:
            continue
        stop = int(scored[last - 1]) + 1
        if found and first < found[-1][2]:
            at, first, earlier = found.pop()
            stop = max(stop, earlier)
        found.append((at, first, stop))
    return found


def _joined(parts: Sequence[run.DriveArrays], pieces: Sequence[_Piece]) -> run.DriveArrays:
    """Join the arrays of a pass and of its branches, piece by piece."""
    steps, samples, (driving, *_), flags, fixes, wheels, (lever, *_), targets, ends = zip(*parts, strict=True)
    numbers = list[list[NDArray[np.int32]]]()  # of fixes, wheel speeds and targets before each step
    for bits, end in zip(flags, ends, strict=True):
        counts = (np.cumsum(which != 0, dtype=np.int32) for which in (bits & (FIX | HIDDEN), bits & ODOMETER))
        numbers.append([np.append(np.int32(0), count) for count in (*counts, end)])
    rows = [
        [slice(first, last), *(slice(int(n[first]), int(n[last])) for n in numbers[number])]
        for number, first, last in pieces
    ]

    def joined(arrays: Sequence[NDArray[Any]], kind: int) -> NDArray[Any]:
        return np.concatenate([arrays[p.number][at[kind]] for p, at in zip(pieces, rows, strict=True)])

    bits = joined(flags, STEP)
    begins = np.cumsum([0, *(piece.last - piece.first for piece in pieces)])
    for begin, earlier, piece in zip(begins, (None, *pieces), pieces, strict=False):
        bits[begin] |= run.RETURN if earlier and earlier.number else 0
        bits[begin] |= run.BRANCH if piece.number else 0
    weight, x, y, theta, counts, noise = (joined(column, TARGET) for column in zip(*targets, strict=True))
    weight, x, y, theta, noise = (run.readonly(column) for column in (weight, x, y, theta, noise))
    end = np.cumsum(joined([np.diff(end, prepend=end[:1] * 0) for end in ends], STEP), dtype=np.int32)
    read = joined(steps, STEP), joined(samples, STEP), driving, bits
    of_fixes = joined(fixes, OF_FIX), joined(wheels, WHEEL)
    return *read, *of_fixes, lever, (weight, x, y, theta, counts, noise), end


def run_passes(passes: Sequence[FilterPass], parameter_sets: Sequence[FilterParameters]) -> KernelSums:
    """Run one filter per parameter set over each pass. The sums of a set do not depend on the other sets."""
    sums = KernelSums.empty(len(passes), len(parameter_sets))
    for indices, table in group_tables(parameter_sets):
        sums.put(slice(None), indices, run_array(passes, KernelArray(table)))
    return sums


def run_array(passes: Sequence[FilterPass], array: KernelArray) -> KernelSums:
    rows = start_passes(passes, array)
    for drive_pass, block in zip(cycle(passes), rows, strict=False):
        run_steps(drive_pass, array, block, run.new_cursor(), drive_pass.n_steps)
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
