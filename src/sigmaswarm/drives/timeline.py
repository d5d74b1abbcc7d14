"""The merged timeline: the steps of a filter, and the measurements at their ends.

The IMU sample at t_k drives the filter from t_(k-1) to t_k. A fix between these times splits the step into two steps,
both driven by this sample, and updates the filter at the time of the fix. The second of two fixes with equal times,
from two receivers, has a step of length 0. Process noise is the variance per nominal interval (the median) and is
scaled by dt / nominal.

In a gap of the IMU, the input is the mean of the samples before and after it (`drives.gaps`). Stale fixes are left out
(`drives.stale_fixes`). ``as_recorded`` turns off the rules for gaps and stale fixes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import Alignments
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gaps import gaps_before
from sigmaswarm.drives.stale_fixes import STALE
from sigmaswarm.drives.standstill import CalmSamples, detect_standstills, find_calm
from sigmaswarm.drives.tables import Gps, Indices, Mask, headings_of

DT, Q_SCALE, GAP, AX, AY, GZ, AZ, GX, GY = range(9)
"""Columns of a step: length, scale of Q, gap, and the IMU's axes; az, gx and gy only for an IMU with six axes."""
N_STEP, FIRST_AXIS = 9, AX
AXES = ("ax", "ay", "gz", "az", "gx", "gy")  # in the order of a step; every IMU has the first three
FIX_X, FIX_Y, FIX_VX, FIX_VY, FIX_VAR_X, FIX_VAR_Y, FIX_THETA, FIX_VAR_THETA = range(8)  # columns of a fix


@dataclass(frozen=True, eq=False)
class Timeline:
    """The steps of a filter over one drive."""

    start: float  # s, time of the initial state
    end: Array  # (k,) s, end of each step
    steps: Array  # (k, 3), columns DT, Q_SCALE and GAP: see `dt`, `q_scale` and `gap`
    sample: NDArray[np.int32]  # (k,), index of the IMU sample that drives each step
    # (n, 3) or (n, 6), inputs of the steps up to each IMU sample, in the order of `AXES`, m/s2 and rad/s; the timelines
    # of a drive share this array
    driving: Array
    updates: Mask  # (k,), True if a fix updates the filter at the step's end
    hides: Mask  # (k,), True if a fix at the step's end is hidden from the filter, which predicts it
    sampled: Mask  # (k,), True if the step ends at the time of an IMU sample
    # (f, 8), columns FIX_X to FIX_VAR_THETA, in the order of the steps, including hidden fixes: position, m; velocity,
    # m/s (0 if unknown); stated variance, m2 (0 if not stated); heading, rad, and its stated variance, rad2 (0 if not
    # stated, infinite if the fix has no heading)
    fixes: Array
    drive: Drive  # without the hidden fixes
    kinds: (
        Array  # (g,), kind of each fix of ``drive``: see `drives.stale_fixes`; all `NEW` with ``as_recorded``
    )
    like: "Timeline | None" = None  # a timeline of the same IMU samples with all fixes

    @cached_property
    def imu_time(self) -> Array:
        """Times of the IMU samples after the start of the filter, (n,) s."""
        time = self.drive.imu.time
        return time[np.searchsorted(time, self.start, side="right") :]

    @cached_property
    def nominal_interval(self) -> float:
        return self.like.nominal_interval if self.like else self.drive.nominal_interval

    @cached_property
    def lever(self) -> Array:
        """Vector from the IMU to the antenna, (3,) m forward, left and up."""
        return np.array([*self.drive.lever_arm, self.drive.antenna_height])

    @cached_property
    def fix_time(self) -> Array:
        """Time of each fix, (f,) s."""
        return self.end[self.updates | self.hides]

    @property
    def has_velocity(self) -> bool:
        return self.drive.gps.velocity is not None

    @property
    def states_accuracy(self) -> bool:
        """True if the receiver states the accuracy of each fix."""
        return self.drive.gps.std is not None and bool((self.fixes[:, FIX_VAR_X : FIX_VAR_Y + 1] > 0.0).all())

    @property
    def dt(self) -> Array:
        """Length of each step, (k,) s."""
        return self.steps[:, DT]

    @property
    def q_scale(self) -> Array:
        """Length of each step in nominal intervals, (k,)."""
        return self.steps[:, Q_SCALE]

    @property
    def gap(self) -> Array:
        """Length of the IMU gap that contains each step, (k,) s; 0 outside of gaps."""
        return self.steps[:, GAP]

    @cached_property
    def ax(self) -> Array:
        return self.driving[self.sample, AX - FIRST_AXIS]

    @cached_property
    def ay(self) -> Array:
        return self.driving[self.sample, AY - FIRST_AXIS]

    @cached_property
    def gz(self) -> Array:
        return self.driving[self.sample, GZ - FIRST_AXIS]

    def imu(self, axes: Sequence[str]) -> Array:
        """Return the inputs of each step, (k, len(axes)) m/s2 and rad/s."""
        return self.driving[:, [AXES.index(axis) for axis in axes]][self.sample]

    @cached_property
    def stands(self) -> Mask:
        """True if the car is stationary at the step's end, (k,)."""
        return detect_standstills(self.drive, self.kinds, self._calm)[self.sample]

    @cached_property
    def _calm(self) -> CalmSamples:
        return self.like._calm if self.like else find_calm(self.drive.imu)

    @cached_property
    def alignments(self) -> Alignments:
        return Alignments(self.drive, usable=self.kinds < STALE)

    def hiding(self, hidden: Mask) -> "Timeline":
        """Return this timeline with fixes hidden where ``hidden`` (g,) is True. The two timelines share arrays."""
        hides = np.zeros(len(self.end), dtype=np.bool_)
        hides[self.updates] = hidden[_usable(self.drive, self.start, self.kinds)]
        seen = replace(self.drive, gps=self.drive.gps.select(~hidden))
        kinds = self.kinds[~hidden]
        return replace(self, updates=self.updates & ~hides, hides=hides, drive=seen, kinds=kinds, like=self)


def build_timeline(
    drive: Drive, start: float, kinds: Array, *, as_recorded: bool, like: Timeline | None = None
) -> Timeline:
    """Merge IMU samples and fixes after ``start`` (s). Fixes after the last IMU sample are left out.

    ``kinds`` (g,) are the kinds of the fixes. With ``as_recorded``, IMU gaps are ordinary steps. ``like`` is a timeline
    of the same IMU samples with all fixes, to save time and memory.
    """
    imu, first = drive.imu, int(np.searchsorted(drive.imu.time, start, side="right"))
    fixes = drive.gps.select(_usable(drive, start, kinds))
    at = np.searchsorted(imu.time, fixes.time, side="left")  # the first sample at or after each fix
    # The last fix at the time of a sample updates the filter at the end of the sample's step; others need a step.
    shared = (imu.time[at] == fixes.time) & np.append(fixes.time[1:] != fixes.time[:-1], True)[: len(at)]
    alone = at[~shared] - first
    ends = np.insert(imu.time[first:], alone, fixes.time[~shared])
    sample = np.insert(np.arange(first, len(imu)), alone, at[~shared])
    sampled = np.insert(np.ones(len(imu) - first, dtype=np.bool_), alone, False)
    updates = ~sampled
    updates[np.flatnonzero(sampled)[at[shared] - first]] = True
    gaps = np.zeros(len(imu)) if as_recorded else gaps_before(imu.time)
    steps = np.empty((len(ends), FIRST_AXIS))  # filled by column, to save memory
    steps[:, DT] = np.diff(ends, prepend=start)
    steps[:, Q_SCALE] = steps[:, DT] / (like or drive).nominal_interval
    steps[:, GAP] = gaps[sample]
    driving = like.driving if like else _driving(drive, np.flatnonzero(gaps))
    hides, columns = np.zeros(len(ends), dtype=np.bool_), _columns(fixes)
    sample = sample.astype(np.int32)
    return Timeline(start, ends, steps, sample, driving, updates, hides, sampled, columns, drive, kinds, like)


def _usable(drive: Drive, start: float, kinds: Array) -> Mask:
    time = drive.gps.time
    return (time > start) & (time <= drive.imu.time[-1]) & (kinds < STALE)


def _driving(drive: Drive, gap_ends: Indices) -> Array:
    """Return the inputs up to each IMU sample: the sample, or the mean of the samples before and after a gap."""
    columns = [getattr(drive.imu, axis) for axis in AXES]
    columns = columns[:3] if any(column is None for column in columns) else columns
    driving = np.column_stack(columns)
    driving[gap_ends] = 0.5 * (driving[gap_ends - 1] + driving[gap_ends])
    return driving


def _columns(gps: Gps) -> Array:
    nothing = np.zeros((2, len(gps)))
    motion = nothing if gps.velocity is None else gps.velocity
    variance = nothing if gps.std is None else np.square(gps.std)
    if not np.isfinite(variance).all():
        variance = nothing
    return np.column_stack([gps.x, gps.y, *motion, *variance, *headings_of(gps)])
