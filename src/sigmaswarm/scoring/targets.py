"""Passes over a drive for scoring: the timeline, and the truth along the drive or at the ends of outages."""

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive, Gps, Truth
from sigmaswarm.drives.gaps import is_known
from sigmaswarm.drives.outages import balanced_windows, hidden_fixes, random_windows, snap_ends
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.passes import FilterPass, Targets
from sigmaswarm.scoring.score import MIN_HEADING_SPEED, heading_weights, weights_at

OUTAGE_LENGTH = 5.0  # s, medium outages
LONG_OUTAGE_LENGTH = 30.0  # s; shows errors of the estimated biases
SHORT_OUTAGE_LENGTH = 1.0  # s, about the time to the next fix
FORECAST_LENGTHS = (SHORT_OUTAGE_LENGTH, OUTAGE_LENGTH, LONG_OUTAGE_LENGTH)
Seed = int | tuple[int, ...]
TARGET_OUTAGES = 200  # outages per drive; with this number the drift is accurate to about 10%
MAX_PLACEMENTS = 8  # largest number of placements of outages; more would hide the same fixes again
OUTAGE_FIRST_AFTER = 10.0  # s, shortest time from the start of the filter to the first outage


def tracking_pass(ready: PreparedDrive) -> FilterPass:
    """Create a pass with all fixes, in which estimates are compared with the truth, if any."""
    timeline = ready.timeline()
    return FilterPass(timeline, ready.initial, _truth_targets(ready.drive.truth, timeline))


def outage_pass(ready: PreparedDrive, *, length: float = OUTAGE_LENGTH, seed: Seed = 0) -> FilterPass:
    """Create a pass with random outages.

    Errors at the ends of outages are relative to truth or, without truth, to the fixes.
    """
    windows = outage_windows(ready.drive, ready.initial, length=length, seed=seed)
    timeline = ready.timeline(hidden_fixes(ready.drive.gps.time, windows), removed=True)
    ends, reference = windows[:, 1], drift_reference(ready)
    x, y = np.interp(ends, reference.time, reference.x), np.interp(ends, reference.time, reference.y)
    no_headings = np.zeros_like(ends), np.zeros(len(ends), dtype=np.bool_)
    weights = drift_weights(ready, ends)
    noise = np.empty((0, 4)) if weights is None else np.column_stack([weights, np.zeros((len(ends), 3))])
    targets = Targets(np.ones_like(ends), x, y, *no_headings, _end(timeline, ends), noise)
    return FilterPass(timeline, ready.initial, targets, windows)


def drift_reference(ready: PreparedDrive) -> Gps | Truth:
    """Return the truth or, without truth, the fixes that are not stale."""
    drive = ready.drive
    return drive.gps.select(~ready.stale) if drive.truth is None else drive.truth


def drift_weights(ready: PreparedDrive, ends: Array) -> Array | None:
    """Return the weights of the errors at the ends of outages, shape (k,); None if all are 1."""
    truth = ready.drive.truth
    return None if truth is None else weights_at(truth, ends)


def forecast_pass(ready: PreparedDrive, *, seed: int) -> FilterPass:
    """Create a pass in which fixes are hidden in random windows of 3 to 5 s."""
    windows = forecast_windows(ready.drive, ready.initial, seed=seed)
    timeline = ready.timeline(hidden_fixes(ready.drive.gps.time, windows))
    return FilterPass(timeline, ready.initial, Targets.none(timeline), windows)


def forecast_windows(drive: Drive, initial: InitialState, *, seed: int) -> Array:
    """Return windows of 3 to 5 s over the whole drive, s, shape (k, 2)."""
    return balanced_windows(initial.time, float(drive.imu.time[-1]), np.random.default_rng(seed))


def placements(drive: Drive, initial: InitialState, *, length: float, seed: int) -> list[Seed]:
    """Return seeds for several random placements of outages of ``length`` s, since the drift depends on their times.

    There are 2 to `MAX_PLACEMENTS` seeds, or none if the drive is too short. The first seed is ``seed`` itself.
    """
    fitting = len(outage_windows(drive, initial, length=length, seed=seed))
    wanted = min(max(-(-TARGET_OUTAGES // fitting), 2), MAX_PLACEMENTS) if fitting else 0
    return [seed, *((seed, i) for i in range(1, wanted))][:wanted]


def outage_windows(drive: Drive, initial: InitialState, *, length: float, seed: Seed) -> Array:
    """Return outage windows, shape (k, 2), s. Each lasts exactly ``length`` s and ends at an IMU sample.

    If there is truth, no window ends in a gap of truth.
    """
    reference = (drive.gps if drive.truth is None else drive.truth).time
    # No window ends before the first reference.
    earliest = float(reference[0]) - OUTAGE_FIRST_AFTER - length
    last = float(min(drive.imu.time[-1], reference[-1]))
    start, rng = max(initial.time, earliest), np.random.default_rng(seed)
    windows = random_windows(start, last, rng, length=length, first_after=OUTAGE_FIRST_AFTER)
    windows = snap_ends(windows, drive.imu.time[drive.imu.time <= last])
    return windows if drive.truth is None else windows[is_known(drive.truth, windows[:, 1])]


def _truth_targets(truth: Truth | None, timeline: Timeline) -> Targets:
    if truth is None:
        return Targets.none(timeline)
    rows = slice(
        int(np.searchsorted(truth.time, timeline.start, "left")),
        int(np.searchsorted(truth.time, timeline.imu_time[-1], "right")),
    )
    truth = truth.select(rows)  # a view
    nodes = np.concatenate([[timeline.start], timeline.imu_time])
    later = np.maximum(np.searchsorted(nodes, truth.time, side="left"), 1)
    weight = (truth.time - nodes[later - 1]) / (nodes[later] - nodes[later - 1])
    counts = np.hypot(truth.vx, truth.vy) > MIN_HEADING_SPEED
    noise, position, heading = np.empty((0, 4)), weights_at(truth, truth.time), heading_weights(truth)
    if position is not None and (std := truth.std) is not None:
        heading = np.ones(len(truth)) if heading is None else heading
        noise = np.column_stack([position, heading, *np.square(std)])
    return Targets(weight, truth.x, truth.y, truth.theta, counts, _end(timeline, truth.time), noise)


def _end(timeline: Timeline, times: Array) -> NDArray[np.int32]:
    """Return the number of target times up to the end of each step of the timeline."""
    done = np.searchsorted(times, timeline.imu_time, side="right")
    return np.concatenate([[0], done]).astype(np.int32)[np.cumsum(timeline.sampled, dtype=np.int32)]
