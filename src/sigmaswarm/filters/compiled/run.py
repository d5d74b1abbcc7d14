"""The compiled run: LANES filters over one time line, with scores along the way."""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import hashlib
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.compilation import cached
from sigmaswarm.drives import frozen, gaps, standstill, timeline
from sigmaswarm.filters import models, schedule, student
from sigmaswarm.filters.compiled.lanes import LANES, OPTIONS, kernel
from sigmaswarm.filters.compiled.layout import N_KEPT, N_ROWS, N_STATE, R
from sigmaswarm.filters.compiled.rows import new_rows
from sigmaswarm.filters.compiled.step import step5, step8
from sigmaswarm.filters.schedule import FIX, HIDDEN, IMU

Array = NDArray[np.float64]

# Columns of a step.
DT, AX, AY, GZ, Q_SCALE, GAP = range(6)

# Columns of a target: a moment of truth inside an IMU interval.
WEIGHT, TRUE_X, TRUE_Y, TRUE_THETA, SCORES_HEADING = range(5)

# Where a run goes on that is made in pieces: the next step, fix and target, and Q's scale since the last fix.
NEXT_STEP, NEXT_FIX, NEXT_TARGET, SINCE = range(4)
NO_RECORD, NO_INNOVATIONS = np.empty((0, N_STATE + 1, 0)), np.empty((0, 5))
"""For a run that records nothing."""


def new_place() -> Array:
    """Where a run begins."""
    return np.zeros(4)


_TWO_PI = 2 * math.pi
_DETERMINANTS_PER_LOG = 8  # their product stays far inside the range of a double


@kernel
def _take_logarithm(w):
    """Move the products of the last fixes into the sums of their logarithms (a slow call: once in a while)."""
    for l in range(LANES):
        w[R.LOG_DET, l] += math.log(w[R.DET, l])
        w[R.LOG_TAIL, l] += math.log(w[R.TAIL, l])
        w[R.DET, l], w[R.TAIL, l] = 1.0, 1.0


@kernel
def _score(w, weight, true_x, true_y, true_theta, scores_heading):
    """Add the squared errors at a moment of truth, and the position's NEES.

    The estimate is linear between two IMU samples; the covariance is that at the later one.
    """
    for l in range(LANES):
        x = w[R.BEFORE_X, l] + weight * (w[R.X, l] - w[R.BEFORE_X, l]) - true_x
        y = w[R.BEFORE_Y, l] + weight * (w[R.Y, l] - w[R.BEFORE_Y, l]) - true_y
        turn = w[R.T, l] - w[R.BEFORE_T, l]
        turn -= _TWO_PI * np.floor(turn / _TWO_PI + 0.5)
        wrong = w[R.BEFORE_T, l] + weight * turn - true_theta
        wrong -= _TWO_PI * np.floor(wrong / _TWO_PI + 0.5)
        w[R.SQ_POSITION, l] += x * x + y * y
        w[R.SQ_HEADING, l] += scores_heading * wrong * wrong
        xx, xy, yy = w[R.XX, l], w[R.XY, l], w[R.YY, l]
        w[R.NEES, l] += (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)


def _run(w, steps, flags, fixes, lever, targets, target_end, place, stop, record, innovations, *, step):
    """The steps from a place to a stop; w holds what the filters are and remember, before and after."""
    n_fixes = int(place[NEXT_FIX])
    n_targets = int(place[NEXT_TARGET])
    n_recorded = 0
    since = place[SINCE]
    interval_starts = True
    for s in range(int(place[NEXT_STEP]), stop):
        if interval_starts:
            for l in range(LANES):
                w[R.BEFORE_X, l] = w[R.X, l]
                w[R.BEFORE_Y, l] = w[R.Y, l]
                w[R.BEFORE_T, l] = w[R.T, l]
        u = steps[s]
        happens = flags[s]
        since += u[Q_SCALE]
        zx, zy, zu, zv, var_x, var_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if happens & (FIX | HIDDEN):
            z = fixes[n_fixes]
            zx, zy, zu, zv, var_x, var_y = z[0], z[1], z[2], z[3], z[4], z[5]
        step(
            w, u[DT], u[AX], u[AY], u[GZ], u[Q_SCALE], u[GAP], happens,
            zx, zy, zu, zv, var_x, var_y, lever[0], lever[1], since,
        )  # fmt: skip
        if happens & FIX:
            since = 0.0
        if happens & (FIX | HIDDEN):
            if innovations.shape[0] > 0:
                for r in range(5):
                    innovations[n_fixes, r] = w[(R.NU1, R.NU2, R.V11, R.V12, R.V22)[r], 0]
            n_fixes += 1
            if n_fixes % _DETERMINANTS_PER_LOG == 0:
                _take_logarithm(w)
        interval_starts = (happens & IMU) != 0
        while n_targets < target_end[s]:
            t = targets[n_targets]
            _score(w, t[WEIGHT], t[TRUE_X], t[TRUE_Y], t[TRUE_THETA], t[SCORES_HEADING])
            n_targets += 1
        if interval_starts and record.shape[0] > 0:
            for l in range(record.shape[2]):
                for r in range(N_STATE):
                    record[n_recorded, r, l] = w[r, l]
                record[n_recorded, N_STATE, l] = w[R.OK, l]
            n_recorded += 1
    if stop == steps.shape[0]:
        _take_logarithm(w)
    place[NEXT_STEP], place[NEXT_FIX], place[NEXT_TARGET], place[SINCE] = stop, n_fixes, n_targets, since


_run5 = kernel(_run, step=step5)
_run8 = kernel(_run, step=step8)


@kernel
def _load(w, rows):
    for l in range(LANES):
        for r in range(N_ROWS):
            w[r, l] = 0.0
        for r in range(N_KEPT):
            w[r, l] = rows[r, l]


@kernel
def _store(w, rows):
    for l in range(LANES):
        for r in range(N_KEPT):
            rows[r, l] = w[r, l]


def cached_by_sources(make, **options):
    """Compile the kernel that ``make(sources)`` gives, cached under a key that holds a hash of all kernels' sources.

    Numba keeps machine code in a cache, and would not notice that a function in another file has changed; but what a
    function closes over is part of its key.
    """
    elsewhere = frozen, gaps, standstill, timeline, models, schedule, student  # what kernels take from there
    files = [
        *sorted(Path(__file__).parent.glob("*.py")),
        *(Path(str(module.__file__)) for module in elsewhere),
    ]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    return cached(make(digest), **(OPTIONS | options))


@cached_by_sources
def _run_planar5(sources):
    def run_planar5(steps, flags, fixes, lever, targets, target_end, rows, place, stop, record, innovations):
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        _load(w, rows)
        _run5(w, steps, flags, fixes, lever, targets, target_end, place, stop, record, innovations)
        _store(w, rows)

    return run_planar5


@cached_by_sources
def _run_planar8(sources):
    def run_planar8(steps, flags, fixes, lever, targets, target_end, rows, place, stop, record, innovations):
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        _load(w, rows)
        _run8(w, steps, flags, fixes, lever, targets, target_end, place, stop, record, innovations)
        _store(w, rows)

    return run_planar8


KERNELS = {"planar5": _run_planar5, "planar8": _run_planar8}
"""By model."""


def run_lanes(
    model: str,
    steps: Array,
    flags: NDArray[np.int64],
    fixes: Array,
    lever: Array,
    targets: Array,
    target_end: NDArray[np.int64],
    rows: Array,
    place: Array,
    stop: int,
    record: Array,
    innovations: Array,
) -> None:
    """Run LANES filters over some steps of one time line, from where the last call has left them.

    Runs in pieces give the bits of the whole run, if each piece but the last stops after a step that has IMU.

    Parameters
    ----------
    model : its name
    steps : (k, 6) dt (s), ax, ay (m/s2), gz (rad/s), the scale of Q, and the gap (s) that it is a part of, of each step
    flags : (k,) bits of each step: see `schedule`
    fixes : (f, 6) m east, north, m/s east, north, m2 east, north as the receiver states it, in the order in which
        steps absorb them
    lever : (2,) m forward and left from the IMU to the antenna
    targets : (m, 5) see WEIGHT ... SCORES_HEADING
    target_end : (k,) how many targets lie before the end of each step (constant where flags lack IMU)
    rows : (N_KEPT, LANES), changed: state, constants and sums of each lane, and what it remembers
    place : (4,), changed: see NEXT_STEP ... SINCE
    stop : the step before which to stop; at k, sums are complete
    record : (r, N_STATE + 1, m), written from its start: state and OK flag of the first m lanes at each IMU sample of
        these steps; r = 0: none
    innovations : (f, 5), written: nu (m) and S (m2; xx, xy, yy) of the first lane at each fix of these steps, before it
        is absorbed; of no rows: none
    """
    arrays = steps, flags, fixes, lever, targets, target_end, rows, place, stop
    KERNELS[model](*arrays, record, innovations)
